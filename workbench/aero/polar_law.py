"""The polar law: drag along the relative wind and lift across it, for round or feathered tails
(design section 5).
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Any, ClassVar

from aerodima.workbench.aero.section_laws import (
    STILL,
    LineForce,
    LineMotion,
    Scalar,
    Scalars,
    SectionLaw,
    cross,
    dot,
    float_of,
    polar_angle,
    require_increasing,
)
from aerodima.workbench.core.errors import ModelError

Grid = tuple[float, ...]
_LIFT_END = math.radians(10.0)
"""Within this of gamma = 90 degrees the lift fades to zero, because its direction is undefined
there, rad."""
_ONE_DEGREE = math.radians(1.0)
"""Usual `lift_blend` of a `PolarLaw`, rad."""

MIN_DRAG = -0.05
"""Lowest C_D of a table. A node may lie a little below zero: the fits scatter, and one published
C_D is -0.012."""
_MAX_ANGLE = math.radians(90.1)
"""Largest |gamma| of a table, rad: air along the tail, with rounding."""


def require_spanwise(angle: float, where: str) -> None:
    """Raise ModelError for an angle of a table (rad) that |gamma| cannot have."""
    if angle > _MAX_ANGLE:
        raise ModelError(
            f"{where}: an angle is {angle:g} rad, but |gamma| goes from air across the tail (0) to "
            "air along it (pi/2); it is neither in degrees nor the angle of attack of the chord"
        )


@dataclass(frozen=True)
class RegularTable:
    """A coefficient on a grid of speed and angle, bilinear between the nodes.

    Attributes:
        speeds: speeds of the grid, strictly increasing (n), m/s.
        angles: angles |gamma| of the grid, strictly increasing (m), rad.
        values: coefficients at the nodes, n rows of m.
        measured: whether a node is measured, n rows of m; a cell is covered when all its corners
            are measured.
        where: name of the file or table, for messages.
    """

    speeds: Grid
    angles: Grid
    values: tuple[Grid, ...]
    measured: tuple[tuple[bool, ...], ...]
    where: str = "coefficient table"

    def __post_init__(self) -> None:
        require_increasing("speeds", self.speeds, self.where)
        require_increasing("angles", self.angles, self.where)

    def __call__(self, speed: Scalar, angle: Scalar) -> Scalar:
        """Returns the coefficient at a speed and an angle of attack."""
        return self.at(self.cell(speed, angle))

    def cell(self, speed: Scalar, angle: Scalar) -> tuple[int, Scalar, int, Scalar]:
        """Returns row and fraction, column and fraction of a point; tables on one grid share it."""
        return *_cell(self.speeds, speed), *_cell(self.angles, angle)

    def at(self, cell: tuple[int, Scalar, int, Scalar]) -> Scalar:
        """Returns the coefficient at a point given by its cell."""
        i, x, j, y = cell
        low = self.values[i]
        high = self.values[i + 1]
        at_low = low[j] + (low[j + 1] - low[j]) * y
        at_high = high[j] + (high[j + 1] - high[j]) * y
        return at_low + (at_high - at_low) * x

    def covers(self, speed: float, angle: float) -> bool:
        """Tells whether the point lies in a cell with measured corners; on a grid line only the
        nodes of that line count.
        """
        speeds = self.speeds
        angles = self.angles
        if not (speeds[0] <= speed <= speeds[-1] and angles[0] <= angle <= angles[-1]):
            return False
        rows = self.measured[_corners(*_cell(speeds, speed))]
        columns = _corners(*_cell(angles, angle))
        return all(all(row[columns]) for row in rows)


def _cell(grid: Grid, value: Scalar) -> tuple[int, Scalar]:
    """Returns the index of the left neighbour and the share of the way to the right one, 0 to 1."""
    if value <= grid[0]:
        return 0, 0.0
    last = len(grid) - 2
    if value >= grid[-1]:
        return last, 1.0
    i = bisect_right(grid, value if isinstance(value, float) else float_of(value)) - 1
    return i, (value - grid[i]) / (grid[i + 1] - grid[i])


def _corners(left: int, fraction: Scalar) -> slice:
    """Returns the neighbours of a point on a grid; a point on a node has only that node."""
    return slice(left + (fraction >= 1.0), left + 1 + (fraction > 0.0))


@dataclass(frozen=True)
class PolarLaw(SectionLaw):
    """F = 1/2 rho A |v|^2 (C_D d + C_L l), d = v/|v|, l perpendicular to v in the plane of v and a,
    on the root side.

    C_D and C_L are even in gamma; for gamma < 0 the lift turns to the tip side. Lift acts towards
    the root and the area carries no cosine, because only this gives the published currents of
    tail 1 (ERRATA E39, E40).

    Attributes:
        drag: drag coefficient C_D, a number or a table over |v_rel| (m/s) and |gamma| (rad).
        lift: lift coefficient C_L, likewise; two tables have the same nodes.
        lift_blend: angle from gamma = 0 within which the lift passes smoothly from one side to the
            other, rad. With 0 it jumps.
    """

    knows_normal: ClassVar[bool] = False
    drag: float | RegularTable
    lift: float | RegularTable = 0.0
    lift_blend: float = _ONE_DEGREE

    def _fade(self, spanwise: Scalar, across: Scalar, speed: Scalar) -> Scalar:
        """Returns a factor on C_L: sign of gamma, smooth at 0, and zero at 90 degrees."""
        x = across / (speed * math.sin(_LIFT_END))
        if x >= 1.0:
            end = 1.0
        else:
            end = x * x * (3.0 - 2.0 * x)
        if self.lift_blend == 0.0:
            return end if spanwise >= 0.0 else -end
        x = spanwise / (speed * math.sin(self.lift_blend))
        if x >= 1.0:
            return end
        if x <= -1.0:
            return -end
        return 0.5 * x * (3.0 - x * x) * end

    def _parts(
        self, spanwise: Scalar, across_squared: Scalar, scale: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Returns alpha and beta of F = alpha v + beta a for one section; scale = 1/2 rho A."""
        squared = across_squared + spanwise * spanwise
        if squared <= STILL:
            return 0.0, 0.0
        speed = squared**0.5
        if across_squared <= STILL:
            along: Any = self.drag
            if isinstance(along, RegularTable):
                along = along(speed, math.pi / 2)
            return scale * speed * along, 0.0
        across = across_squared**0.5
        drag: Any = self.drag
        lift: Any = self.lift
        if isinstance(drag, RegularTable):
            size = spanwise if spanwise >= 0.0 else -spanwise
            cell = drag.cell(speed, polar_angle(size, across))
            drag = drag.at(cell)
            lift = lift.at(cell)
        lift = lift * self._fade(spanwise, across, speed) / across
        return scale * speed * (drag + lift * spanwise), -scale * lift * squared * speed

    def line_force(
        self, line: LineMotion, distances: Scalars, areas: Scalars, density: float
    ) -> LineForce:
        """See `SectionLaw.line_force`."""
        u, k, a, _ = line
        u_x, u_y, u_z = u
        k_x, k_y, k_z = k
        a_x, a_y, a_z = a
        spanwise = dot(u, a)
        across_x = u_x - spanwise * a_x
        across_y = u_y - spanwise * a_y
        across_z = u_z - spanwise * a_z
        half = 0.5 * density
        a_sum = as_sum = ass_sum = b_sum = 0.0
        for s, area in zip(distances, areas, strict=True):
            x = across_x + s * k_x
            y = across_y + s * k_y
            z = across_z + s * k_z
            alpha, beta = self._parts(spanwise, x * x + y * y + z * z, half * area)
            a_sum += alpha
            as_sum += alpha * s
            ass_sum += alpha * s * s
            b_sum += beta
        f_x = a_sum * u_x + as_sum * k_x + b_sum * a_x
        f_y = a_sum * u_y + as_sum * k_y + b_sum * a_y
        f_z = a_sum * u_z + as_sum * k_z + b_sum * a_z
        m_x = as_sum * u_x + ass_sum * k_x
        m_y = as_sum * u_y + ass_sum * k_y
        m_z = as_sum * u_z + ass_sum * k_z
        return f_x, f_y, f_z, *cross(a, (m_x, m_y, m_z))

    def covers(self, speed: float, angle: float) -> bool:
        """See `SectionLaw.covers`; plain numbers cover everything."""
        return not isinstance(self.drag, RegularTable) or self.drag.covers(speed, abs(angle))
