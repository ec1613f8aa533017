r"""The sail on a bearing about the tail's own axis (design section 5, "Sail"; thesis 5.2).

The sail is a half cylinder, hollow towards the wind, with a backing board behind it that turns it
there like a rudder. In the sail frame S the z axis is the bearing, root to tip. The hollow opens to
+y; "behind" is -y, where the board is. Seen along z at angle 0, with the wind towards -y:

      wind | | | |
           v v v v
         |         |  +y
         |    o    |  bearing, then behind it:
          \_     _/   shell, middle of its depth at y = -e
             | |
             | |      board, middle at y = -(e + width/4 + board/2)

Three flat plates stand for it: the shell's opening (normal y), the shell's outline from the side
(half as deep as the opening is wide) and the board (both normal x). The first pushes through the
bearing; the moment of the two others about it is

    -1/2 rho C |v|^2 sin(delta) S,   S = sum of side area x distance behind the bearing,

delta the angle between wind and -y. So the sail is stable facing the wind with S > 0, and turns
away from it with S < 0, as with the bearing of the first sail of the thesis, too far behind. For
small angles in a wind U

    omega_n^2 = 1/2 rho C U^2 S / I,    zeta = 1/2 rho C U S2 / (2 I omega_n), S2 with the distance
    squared,

plus the damping of the bearing. The damping is no law of its own: the plates feel the sail's own
rate. Valid as far as plates are: how drag changes with delta is known from Fig. 5.11 in words only,
a real centre of pressure moves with delta, and the shell does not shade the board here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from aerodima.workbench.aero.section_laws import (
    CrossedPlatesLaw,
    NormalForceLaw,
    SectionLaw,
    add_cross,
    rotated,
)
from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.core.array_types import Vector3
from aerodima.workbench.core.elementwise import rotation_rows
from aerodima.workbench.scenario.tail_parameters import SHELL_DEPTH


@dataclass(frozen=True)
class FreeSail:
    """A half cylinder with a backing board on a bearing about the tail axis.

    Attributes:
        length, width: size of the opening along the tail and across it, m.
        centre_of_pressure: distance e of the shell's side force behind the bearing, m; a quarter of
            the width with the bearing in the plane of the opening, negative with the bearing behind
            that force.
        board_width: width of the backing board along the wind, m.
        start: distance of the sail's near end from the origin of its mount along the axis, m.
        law: law of the opening; the normal of a `TwoSidedLaw` leaves its round side, -y.
        side_coefficient: C_N of shell and board across the wind.
        number: number of sections.
        shell_share: depth of the shell over its width; 0 for a flat sail.
    """

    length: float
    width: float
    centre_of_pressure: float
    board_width: float
    start: float = 0.0
    law: SectionLaw = NormalForceLaw(2.0)  # noqa: RUF009 (frozen)
    side_coefficient: float = 2.0
    number: int = 5
    shell_share: float = SHELL_DEPTH

    @property
    def shell_law(self) -> CrossedPlatesLaw:
        """Law of the shell: its opening along the normal, and its outline across that."""
        return CrossedPlatesLaw(self.law, NormalForceLaw(self.shell_share * self.side_coefficient))

    @property
    def shell_layout(self) -> SectionLayout:
        """Sections of the shell in the sail frame."""
        return self._strip(self.width, self.centre_of_pressure, (0.0, -1.0, 0.0))

    @property
    def board_layout(self) -> SectionLayout:
        """Sections of the backing board in the sail frame."""
        return self._strip(self.board_width, self.board_place, (1.0, 0.0, 0.0))

    @property
    def board_place(self) -> float:
        """Distance of the board's middle behind the bearing, m: it begins where the shell ends."""
        return self.centre_of_pressure + self.shell_share * self.width / 2 + self.board_width / 2

    def _strip(self, width: float, behind: float, normal: Vector3) -> SectionLayout:
        return SectionLayout.strip(
            start=self.start,
            length=self.length,
            width=width,
            number=self.number,
            p_BoRo_B=(0.0, -behind, 0.0),
            normal_B=normal,
        )


class SailMotion(NamedTuple):
    """Orientation and motion of the body `tail_sail`.

    Attributes:
        R_WS: rows of its orientation.
        w_WS: angular velocity in W, rad/s.
        v_WSo: velocity of its origin, where the joint axes cross, in W, m/s.
        p_BoSo_W: position of that origin from the chassis' own, in W, m.
        axes_W: axes of pitch, roll and sail joint in W.
    """

    R_WS: tuple[Vector3, Vector3, Vector3]
    w_WS: Vector3
    v_WSo: Vector3
    p_BoSo_W: Vector3
    axes_W: tuple[Vector3, Vector3, Vector3]


def sail_motion(
    quaternion: Sequence[float],
    velocity: Sequence[float],
    angles: Sequence[float],
    rates: Sequence[float],
    p_BoSo_B: Sequence[float],
) -> SailMotion:
    """Computes orientation and motion of the sail.

    Args:
        quaternion: orientation w, x, y, z of the chassis in W, of any length.
        velocity: angular velocity (3), rad/s, and velocity of the origin (3), m/s, of the chassis
            in W.
        angles, rates: angles and rates of pitch, roll and sail joint, rad and rad/s.
        p_BoSo_B: crossing point of the joint axes in the chassis frame, m.
    """
    rows = rotation_rows(quaternion)
    x_B, y_B, z_B = zip(*rows, strict=True)
    pitch, roll, turn = angles
    # Hub H turns about y of the chassis, rod R about x of the hub, sail S about z of the rod.
    middle, x_H = _turned(z_B, x_B, pitch)
    y_R, a = _turned(y_B, middle, roll)
    x_S, y_S = _turned(x_H, y_R, turn)
    axes_W = (y_B, x_H, a)
    p_BoSo_W = rotated(rows, p_BoSo_B)
    w_WB = velocity[:3]
    p_rate, r_rate, t_rate = rates
    w_WS: Any = tuple(
        w + p_rate * p + r_rate * r + t_rate * t for w, p, r, t in zip(w_WB, *axes_W, strict=True)
    )
    v_WSo = add_cross(velocity[3:], w_WB, p_BoSo_W)
    R_WS: Any = tuple(zip(x_S, y_S, a, strict=True))
    return SailMotion(R_WS, w_WS, v_WSo, p_BoSo_W, axes_W)


def _turned(one: Vector3, other: Vector3, angle: float) -> tuple[Vector3, Vector3]:
    """Turns two unit vectors in their plane by an angle, rad, the first one towards the second."""
    c = math.cos(angle)
    s = math.sin(angle)
    one_x, one_y, one_z = one
    x, y, z = other
    ahead = (one_x * c + x * s, one_y * c + y * s, one_z * c + z * s)
    return ahead, (x * c - one_x * s, y * c - one_y * s, z * c - one_z * s)


def generalised_force(
    motion: SailMotion, force: Sequence[float], moment: Sequence[float]
) -> tuple[float, ...]:
    """Turns a wrench on the sail into forces on the coordinates of chassis and joints.

    Args:
        motion: motion of the sail.
        force: force on the sail in W, N.
        moment: moment about the sail's origin in W, N m.

    Returns:
        Moment on the chassis about its origin (3) in W, N m; force on it (3) in W, N; torque about
        the axes of pitch, roll and sail (3), N m.
    """
    return *add_cross(moment, motion.p_BoSo_W, force), *force, *rotated(motion.axes_W, moment)
