"""Motion of the sail in closed form, from the car's own coordinates, and its wrench as forces on these.

The chain is chassis, pitch, roll, sail turn, about axes that cross in one point (models/tail/tail.sdf): y of the
chassis, x of the hub, z of the rod.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

Vector = tuple[float, float, float]


def rotation_rows(quaternion: Any) -> tuple[Any, Any, Any]:
    """Rows (3) of the rotation matrix of a quaternion w, x, y, z of any length; of arrays (n) each entry is one (n)."""
    w, x, y, z = quaternion
    scale = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)),
        (scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x)),
        (scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y)),
    )


class SailMotion(NamedTuple):
    """How the body `tail_sail` is turned and moves.

    Attributes:
        R_WS: rows of its orientation.
        w_WS: its angular velocity in W, rad/s.
        v_WSo: velocity of its origin, where the joint axes cross, in W, m/s.
        p_BoSo_W: that origin from the chassis' own, m.
        axes_W: of pitch, roll and sail joint.
    """

    R_WS: tuple[Vector, Vector, Vector]
    w_WS: Vector
    v_WSo: Vector
    p_BoSo_W: Vector
    axes_W: tuple[Vector, Vector, Vector]


def sail_motion(
    quaternion: Sequence[float],
    velocity: Sequence[float],
    angles: Sequence[float],
    rates: Sequence[float],
    p_BoSo_B: Sequence[float],
) -> SailMotion:
    """Where the sail is turned to and how it moves.

    Args:
        quaternion: w, x, y, z of the chassis in W, of any length.
        velocity: angular velocity (3), rad/s, and velocity of the origin (3), m/s, of the chassis in W.
        angles: of pitch, roll and sail joint, rad.
        rates: of the same, rad/s.
        p_BoSo_B: where the joint axes cross, in the chassis frame, m.
    """
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rotation_rows(quaternion)
    pitch, roll, turn = angles
    c, s = math.cos(pitch), math.sin(pitch)
    # Hub: x and z of the chassis turned about its y.
    hx, hy, hz = r00 * c - r02 * s, r10 * c - r12 * s, r20 * c - r22 * s
    ux, uy, uz = r00 * s + r02 * c, r10 * s + r12 * c, r20 * s + r22 * c
    c, s = math.cos(roll), math.sin(roll)
    # Rod: y and z of the hub turned about its x.
    lx, ly, lz = r01 * c + ux * s, r11 * c + uy * s, r21 * c + uz * s
    ax, ay, az = ux * c - r01 * s, uy * c - r11 * s, uz * c - r21 * s
    x_S, y_S = (hx, hy, hz), (lx, ly, lz)
    if turn != 0.0:
        c, s = math.cos(turn), math.sin(turn)
        x_S = (hx * c + lx * s, hy * c + ly * s, hz * c + lz * s)
        y_S = (lx * c - hx * s, ly * c - hy * s, lz * c - hz * s)
    px, py, pz = p_BoSo_B
    dx, dy, dz = r00 * px + r01 * py + r02 * pz, r10 * px + r11 * py + r12 * pz, r20 * px + r21 * py + r22 * pz
    wx, wy, wz, vx, vy, vz = velocity
    p_rate, r_rate, t_rate = rates
    return SailMotion(
        ((x_S[0], y_S[0], ax), (x_S[1], y_S[1], ay), (x_S[2], y_S[2], az)),
        (
            wx + p_rate * r01 + r_rate * hx + t_rate * ax,
            wy + p_rate * r11 + r_rate * hy + t_rate * ay,
            wz + p_rate * r21 + r_rate * hz + t_rate * az,
        ),
        (vx + wy * dz - wz * dy, vy + wz * dx - wx * dz, vz + wx * dy - wy * dx),
        (dx, dy, dz),
        ((r01, r11, r21), (hx, hy, hz), (ax, ay, az)),
    )


def generalised_force(motion: SailMotion, force: Sequence[float], moment: Sequence[float]) -> tuple[float, ...]:
    """A wrench on the sail as forces on the coordinates of chassis and joints.

    Args:
        motion: of the sail.
        force: in W, N.
        moment: about the sail's origin in W, N m.

    Returns:
        Moment on the chassis about its origin (3) in W, N m; force on it (3) in W, N; torque about the axes of pitch,
        roll and sail (3), N m.
    """
    fx, fy, fz = force
    mx, my, mz = moment
    dx, dy, dz = motion.p_BoSo_W
    (px, py, pz), (rx, ry, rz), (sx, sy, sz) = motion.axes_W
    return (
        mx + dy * fz - dz * fy,
        my + dz * fx - dx * fz,
        mz + dx * fy - dy * fx,
        fx,
        fy,
        fz,
        px * mx + py * my + pz * mz,
        rx * mx + ry * my + rz * mz,
        sx * mx + sy * my + sz * mz,
    )
