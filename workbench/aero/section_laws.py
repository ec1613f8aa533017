"""The force laws of a section (design section 5), for floats and for AutoDiffXd alike.

All work on a line of sections: section i at distance s_i along the axis a sees the relative
velocity v_i = v_air - v_section = u + s_i k, with u that of the root and k = -(omega x a). Hence k
is perpendicular to a, and the spanwise part v_i . a is the same for all sections. Vectors are
sequences of three scalars in the world frame.
"""

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydrake.math import arctan2

from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.ranges import check_range

check_from_zero = partial(check_range, low=0.0, high=math.inf, error=ModelError)
check_above_zero = partial(check_from_zero, above_low=True)
"""Both refuse a number that is not finite or too small, by `check_range`."""

Scalar = Any  # float or AutoDiffXd
Vector = Any  # three scalars in a row
LineForce = tuple[Scalar, ...]  # force and moment, three scalars each
Scalars = Sequence[Scalar]  # one per section
Triple = tuple[Scalar, Scalar, Scalar]

# Below this squared speed (m2/s2) a section feels nothing: both laws are quadratic, so value and
# gradient are zero there.
STILL = 1e-60

ROBOT_LIMIT = 15.0
"""Highest relative speed of the robot-tail tables, m/s (Table 11.7)."""

CHEETAH_LIMIT = 10.0
"""Relative speed up to which the quasi-steady model was shown to hold for the cheetah tails, m/s
(section 4.9)."""


class LineMotion(NamedTuple):
    """Motion of a line of sections against the air, vectors (3) in W; see `SectionLayout.motion`.

    Attributes:
        u: relative velocity of the air at the root, m/s.
        k: change of that velocity along the line, 1/s: it is u + s k at distance s.
        a: axis of the line, from root to tip.
        n: normal of the sections.
    """

    u: Vector
    k: Vector
    a: Vector
    n: Vector

    def velocity(self, distance: Scalar) -> Triple:
        """Returns the relative velocity (3) of the air at a distance (m) from the root, m/s."""
        u, k, _, _ = self
        return u[0] + distance * k[0], u[1] + distance * k[1], u[2] + distance * k[2]


def dot(a: Vector, b: Vector) -> Scalar:
    """Returns the dot product of two vectors of three scalars."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Triple:
    """Returns the cross product of two vectors of three scalars."""
    a_x, a_y, a_z = a
    b_x, b_y, b_z = b
    return a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x


def add_cross(v: Scalars, a: Scalars, b: Scalars) -> Triple:
    """Returns v + a x b, such as a velocity plus w x p, or a moment about another point."""
    v_x, v_y, v_z = v
    a_x, a_y, a_z = a
    b_x, b_y, b_z = b
    return (
        v_x + a_y * b_z - a_z * b_y,
        v_y + a_z * b_x - a_x * b_z,
        v_z + a_x * b_y - a_y * b_x,
    )


def rotated(rows: Sequence[Vector], vector: Vector) -> Triple:
    """Rotates a vector by a matrix of three rows, of which the first three numbers count."""
    x, y, z = vector
    first, second, third = rows
    return (
        first[0] * x + first[1] * y + first[2] * z,
        second[0] * x + second[1] * y + second[2] * z,
        third[0] * x + third[1] * y + third[2] * z,
    )


class SectionLaw(ABC):
    """Force law of a section, as `TailForce` asks for it.

    Attributes:
        knows_normal: whether the force depends on the normal n, so that the air can turn a sail
            about its axis.
    """

    knows_normal: ClassVar[bool] = True

    @abstractmethod
    def line_force(
        self, line: LineMotion, distances: Scalars, areas: Scalars, density: float
    ) -> LineForce:
        """Returns the force on the line and its moment about the root: (F_x, F_y, F_z, M_x, M_y,
        M_z), W frame, N and N m.
        """

    def section_force(
        self, v: Vector, a: Vector, n: Vector, area: Scalar, density: float
    ) -> LineForce:
        """Returns the force on one section at relative velocity v: (F_x, F_y, F_z), W frame, N."""
        return self.line_force(LineMotion(v, (0.0, 0.0, 0.0), a, n), (0.0,), (area,), density)[:3]

    @abstractmethod
    def covers(self, speed: float, angle: float) -> bool:
        """Tells whether a speed (m/s) and an angle of attack (rad) lie inside the measured range
        of the coefficients.
        """


def length(v: Vector) -> Scalar:
    """Returns |v|, with a zero gradient at v = 0."""
    squared = dot(v, v)
    if squared > STILL:
        return squared**0.5
    return 0.0 * squared


def angle_of_attack(v: Vector, a: Vector) -> Scalar:
    """Returns gamma = asin(v . a / |v|), rad: 0 is broadside, positive when the air flows towards
    the tip; 0 in still air.

    It is computed with atan2 (ERRATA E27 shows where the thesis form fails).
    """
    return polar_angle(dot(v, a), length(cross(v, a)))


def polar_angle(y: Scalar, x: Scalar) -> Scalar:
    """Returns the angle of the vector (x, y), rad; 0 for the zero vector."""
    if isinstance(y, float):
        return math.atan2(y, x)
    if float_of(y) == 0.0 and float_of(x) == 0.0:
        return 0.0 * y
    return arctan2(y, x)


def wind_direction(line: LineMotion, distances: Scalars, areas: Scalars) -> Scalar:
    """Returns the angle (rad) about the axis a from the normal n to where the air moves across the
    axis; 0 in still air.

    The air moves in the direction of the sum of area |v_p| v_p over the sections, with v_p their
    relative velocity across the axis.
    """
    u, k, a, n = line
    b = cross(a, n)
    u_n = dot(u, n)
    k_n = dot(k, n)
    u_b = dot(u, b)
    k_b = dot(k, b)
    along_normal = across = 0.0 * u_n + 0.0  # never -0.0, for which atan2 gives half a turn
    for s, area in zip(distances, areas, strict=True):
        v_n = u_n + s * k_n
        v_b = u_b + s * k_b
        squared = v_n * v_n + v_b * v_b
        if squared > STILL:
            weight = area * squared**0.5
            along_normal = along_normal + weight * v_n
            across = across + weight * v_b
    return polar_angle(across, along_normal)


def float_of(value: Scalar) -> float:
    """Returns the number behind a float or an AutoDiffXd."""
    if isinstance(value, float):
        return value
    return float(value.value())


def plate_force(
    line: LineMotion,
    distances: Scalars,
    areas: Scalars,
    density: Scalar,
    along: float,
    against: float,
) -> LineForce:
    """Returns force and moment of F = 1/2 rho A C_N |v_p| v_n n summed over all sections; see
    `SectionLaw.line_force`.

    With one C_N for both sides all numbers may be arrays of one shape, for many cars at once.

    Args:
        line, distances, areas, density: as for `SectionLaw.line_force`.
        along, against: C_N when the air blows along +n, and along -n.
    """
    u, k, a, n = line
    c = cross(n, a)  # direction of the chord
    u_n = dot(u, n)
    k_n = dot(k, n)
    u_c = dot(u, c)
    k_c = dot(k, c)
    scale = 0.5 * density
    even = along == against
    many = isinstance(u_n, np.ndarray)
    if even:
        scale = scale * along
        along = 1.0
    total = moment = 0.0
    for i in range(len(distances)):
        s = distances[i]
        v_n = u_n + s * k_n
        v_c = u_c + s * k_c
        squared = v_n * v_n + v_c * v_c
        if many or squared > STILL:
            if many:
                speed = (squared + STILL) ** 0.5
            else:
                speed = squared**0.5
            f = areas[i] * (along if even or v_n > 0.0 else against) * speed * v_n
            total += f
            moment += s * f
    total = scale * total
    # The moment s a x (f n) lies along a x n = -c.
    moment = -(scale * moment)
    return total * n[0], total * n[1], total * n[2], moment * c[0], moment * c[1], moment * c[2]


def require_increasing(name: str, values: Sequence[float], where: str) -> None:
    """Refuses a grid of fewer than two points, NaN, negative values or no strict increase."""
    for i, value in enumerate(values):
        check_from_zero(f"{where}: {name}[{i}]", value, unit="1")
    if len(values) < 2:
        raise ModelError(f"{where}: {name} has {len(values)} points, but a table needs at least 2")
    for i, (left, right) in enumerate(pairwise(values)):
        if right <= left:
            raise ModelError(
                f"{where}: {name} must increase strictly, but {name}[{i + 1}] = {right} follows "
                f"{left}"
            )


@dataclass(frozen=True)
class SpeedTable:
    """A coefficient over |v_rel|, linear between the points and constant beyond them (thesis Fig.
    6.15).

    Attributes:
        speeds: speeds of the points, strictly increasing (n), m/s.
        values: coefficients at these speeds (n).
        where: name of the file or table, for messages.
    """

    speeds: tuple[float, ...]
    values: tuple[float, ...]
    where: str = "speed table"

    def __post_init__(self) -> None:
        require_increasing("speeds", self.speeds, self.where)

    def __call__(self, speed: Scalar) -> Scalar:
        """Returns the coefficient at a speed."""
        speeds = self.speeds
        values = self.values
        if speed <= speeds[0]:
            return values[0]
        if speed >= speeds[-1]:
            return values[-1]
        i = bisect_right(speeds, float_of(speed)) - 1
        slope = (values[i + 1] - values[i]) / (speeds[i + 1] - speeds[i])
        return values[i] + slope * (speed - speeds[i])

    def covers(self, speed: float) -> bool:
        """Tells whether the speed lies inside the table."""
        return self.speeds[0] <= speed <= self.speeds[-1]


def speed_line(slope: float, intercept: float, speed_range: Pair) -> SpeedTable:
    """Makes a coefficient that is a line over |v_rel| inside a range (ERRATA E26).

    Args:
        slope: slope of the line, per m/s.
        intercept: value of the line at 0 m/s.
        speed_range: lowest and highest speed, m/s.
    """
    low, high = speed_range
    return SpeedTable(
        speed_range, (intercept + slope * low, intercept + slope * high), "speed line"
    )


@dataclass(frozen=True)
class NormalForceLaw(SectionLaw):
    """F = 1/2 rho A C_N(|v|) |v_p| v_n n, with v_p the velocity without its spanwise part, v_n its
    part along n.

    Equals Drake's `Wing` on a body that does not rotate. The thesis' model of the robot tail (eq.
    6.8, C_D = 2, force normal to the tail) has cos(gamma) |v|^2 where this law has |v_p| v_n, in
    the plane of tail and normal cos^2(gamma) |v|^2: the two are equal broadside only.

    Attributes:
        coefficient: C_N, a number or a function of |v_rel| such as `SpeedTable`.
    """

    coefficient: float | Callable[[Scalar], Scalar] = 2.0

    def __post_init__(self) -> None:
        if not callable(self.coefficient):
            check_from_zero("normal-force law: coefficient", self.coefficient, unit="1")

    def line_force(
        self, line: LineMotion, distances: Scalars, areas: Scalars, density: float
    ) -> LineForce:
        """See `SectionLaw.line_force`."""
        coefficient = self.coefficient
        if not callable(coefficient):
            return plate_force(line, distances, areas, density, coefficient, coefficient)
        weighted = [
            area * coefficient(length(line.velocity(s)))
            for s, area in zip(distances, areas, strict=True)
        ]
        return plate_force(line, distances, weighted, density, 1.0, 1.0)

    def covers(self, speed: float, angle: float) -> bool:
        """See `SectionLaw.covers`; a plain number covers everything."""
        covers = getattr(self.coefficient, "covers", None)
        if covers is None:
            return True
        return bool(covers(speed))


@dataclass(frozen=True)
class TwoSidedLaw(SectionLaw):
    """The normal-force law with a coefficient per side, for a half cylinder with end caps.

    Attributes:
        along_normal: C_N when the air blows along +n (the force points along +n), onto the side
            that faces -n.
        against_normal: C_N when it blows along -n.
    """

    along_normal: float
    against_normal: float

    def line_force(
        self, line: LineMotion, distances: Scalars, areas: Scalars, density: float
    ) -> LineForce:
        """See `SectionLaw.line_force`; each section takes the coefficient of the side that it shows
        to the wind.
        """
        return plate_force(line, distances, areas, density, self.along_normal, self.against_normal)

    def covers(self, speed: float, angle: float) -> bool:
        """See `SectionLaw.covers`; two numbers cover everything."""
        return True


@dataclass(frozen=True)
class CrossedPlatesLaw(SectionLaw):
    """Two plates that cross on one line: `normal` acts along n, `side` along the chord n x a.

    With two equal laws of constant C_N = C_D it is the drag of a sail that always faces the wind,
    F = 1/2 rho A C_D |v_p| v_p with v_p the velocity without its spanwise part; n does not matter
    then.

    Attributes:
        normal: law of the plate whose normal is n.
        side: law of the plate whose normal is the chord.
    """

    normal: SectionLaw
    side: SectionLaw

    def line_force(
        self, line: LineMotion, distances: Scalars, areas: Scalars, density: float
    ) -> LineForce:
        """See `SectionLaw.line_force`."""
        u, k, a, n = line
        across = LineMotion(u, k, a, cross(n, a))
        normal = self.normal.line_force(line, distances, areas, density)
        side = self.side.line_force(across, distances, areas, density)
        return tuple(one + other for one, other in zip(normal, side, strict=True))

    def covers(self, speed: float, angle: float) -> bool:
        """See `SectionLaw.covers`; the laws of both plates must cover the point."""
        return self.normal.covers(speed, angle) and self.side.covers(speed, angle)


def facing_law(law: SectionLaw) -> CrossedPlatesLaw:
    """Returns the law of a sail that shows the same side to the wind whatever its direction; of two
    sides that is the hollow one.
    """
    if isinstance(law, TwoSidedLaw):
        law = NormalForceLaw(law.along_normal)
    return CrossedPlatesLaw(law, law)
