"""The force on lines of flat plates whose coefficients are numbers, for floats and for AutoDiffXd alike.

A function of numbers alone: `aero.laws` and the fused step of a station (`stations/step_drives.py`) share it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

Scalar = Any  # float or AutoDiffXd
Vector = Sequence[Any]

# Below this squared speed (m2/s2) a section feels nothing: both laws are quadratic, so value and gradient are zero
# there.
STILL = 1e-60


class Plates(NamedTuple):
    """C_N of flat sections that are numbers: of the plate whose normal is n, and of one across it with normal n x a.

    Attributes:
        along_normal: when the air blows along +n.
        against_normal: when it blows along -n.
        side: of the plate across; 0 where there is none.
    """

    along_normal: float
    against_normal: float
    side: float = 0.0


def plates_force(
    u: Vector,
    k: Vector,
    a: Vector,
    n: Vector,
    distances: Sequence[Scalar],
    areas: Sequence[Scalar],
    density: float,
    plates: Plates,
) -> tuple[Scalar, ...]:
    """Force and moment of `plate_force` on both plates."""
    along, against, side = plates
    fx, fy, fz, mx, my, mz = plate_force(u, k, a, n, distances, areas, density, along, against)
    if side == 0.0:
        return (fx, fy, fz, mx, my, mz)
    (ax, ay, az), (nx, ny, nz) = a, n
    chord = (ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax)
    gx, gy, gz, kx, ky, kz = plate_force(u, k, a, chord, distances, areas, density, side, side)
    return (fx + gx, fy + gy, fz + gz, mx + kx, my + ky, mz + kz)


def plate_force(
    u: Vector,
    k: Vector,
    a: Vector,
    n: Vector,
    distances: Sequence[Scalar],
    areas: Sequence[Scalar],
    density: float,
    along: float,
    against: float,
) -> tuple[Scalar, ...]:
    """F = 1/2 rho A C_N |v_p| v_n n for every section; see `SectionLaw.line_force`.

    Args:
        u, k, a, n, distances, areas, density: as there.
        along, against: C_N when the air blows along +n, and along -n.
    """
    ax, ay, az = a
    nx, ny, nz = n
    ux, uy, uz = u
    kx, ky, kz = k
    cx, cy, cz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax  # chord direction n x a
    u_n, k_n = ux * nx + uy * ny + uz * nz, kx * nx + ky * ny + kz * nz
    u_c, k_c = ux * cx + uy * cy + uz * cz, kx * cx + ky * cy + kz * cz
    scale = 0.5 * density
    if along == against:
        scale, along, against = scale * along, 1.0, 1.0
    total = moment = 0.0
    for i in range(len(distances)):
        s = distances[i]
        v_n, v_c = u_n + s * k_n, u_c + s * k_c
        squared = v_n * v_n + v_c * v_c
        if squared > STILL:
            f = areas[i] * (along if v_n > 0.0 else against) * squared**0.5 * v_n
            total += f
            moment += s * f
    total, moment = scale * total, scale * moment
    # The moment s a x (f n) lies along a x n = -c.
    return (total * nx, total * ny, total * nz, -moment * cx, -moment * cy, -moment * cz)
