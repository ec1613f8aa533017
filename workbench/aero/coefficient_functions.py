"""Aerodynamic coefficients as functions: over the relative speed, or over speed and angle of attack.

All take floats or AutoDiffXd, are continuous, and hold their edge value outside their range; `covers` tells where they
were measured. Speeds in m/s, angles |gamma| in rad, coefficients without unit.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from aerodima.workbench.aero.laws import Scalar, float_of
from aerodima.workbench.errors import ModelError

LEAST_DRAG = -0.05
"""Lowest C_D of a table. A node may lie a little below zero: the fits scatter, and one published C_D is -0.012."""


def require_increasing(name: str, values: Sequence[float], where: str) -> None:
    """Refuses a grid with fewer than two points, NaN, negative values or without strict increase."""
    for i, value in enumerate(values):
        if not math.isfinite(value) or value < 0.0:
            raise ModelError(f"{where}: {name}[{i}] is {value}, but it must be a finite number from 0")
    if len(values) < 2:
        raise ModelError(f"{where}: {name} has {len(values)} points, but a table needs at least 2")
    for i, (left, right) in enumerate(pairwise(values)):
        if right <= left:
            raise ModelError(f"{where}: {name} must increase strictly, but {name}[{i + 1}] = {right} follows {left}")


def require_finite(name: str, values: np.ndarray, where: str) -> None:
    """Refuses holes and NaN, naming the first."""
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        index = "".join(f"[{i}]" for i in bad[0])
        raise ModelError(f"{where}: {name}{index} is missing or not finite; fill the hole or leave the whole row out")


@dataclass(frozen=True)
class SpeedTable:
    """A coefficient over |v_rel|, linear between the points and constant beyond them (thesis Fig. 6.15).

    Attributes:
        speeds: strictly increasing (n), m/s.
        values: (n).
        where: name of the file or table, for messages.
    """

    speeds: tuple[float, ...]
    values: tuple[float, ...]
    where: str = "speed table"

    def __post_init__(self) -> None:
        require_increasing("speeds", self.speeds, self.where)
        if len(self.values) != len(self.speeds):
            raise ModelError(f"{self.where}: {len(self.values)} values for {len(self.speeds)} speeds")
        require_finite("values", np.asarray(self.values, float), self.where)

    def __call__(self, speed: Scalar) -> Scalar:
        """The coefficient at a speed."""
        speeds, values = self.speeds, self.values
        if speed <= speeds[0]:
            return values[0]
        if speed >= speeds[-1]:
            return values[-1]
        i = bisect_right(speeds, float_of(speed)) - 1
        return values[i] + (values[i + 1] - values[i]) / (speeds[i + 1] - speeds[i]) * (speed - speeds[i])

    def covers(self, speed: float) -> bool:
        """Whether the speed lies inside the table."""
        return self.speeds[0] <= speed <= self.speeds[-1]


@dataclass(frozen=True)
class SpeedLine:
    """A coefficient that is a line over |v_rel| inside a range, and constant beyond it (ERRATA E26).

    Attributes:
        slope: per m/s.
        intercept: at 0 m/s.
        speed_range: lowest and highest speed, m/s.
    """

    slope: float
    intercept: float
    speed_range: tuple[float, float]

    def __post_init__(self) -> None:
        require_increasing("speed_range", self.speed_range, "speed line")
        if not (math.isfinite(self.slope) and math.isfinite(self.intercept)):
            raise ModelError("speed line: slope and intercept must be finite numbers")

    def __call__(self, speed: Scalar) -> Scalar:
        """The coefficient at a speed."""
        low, high = self.speed_range
        return self.intercept + self.slope * (low if speed < low else high if speed > high else speed)

    def covers(self, speed: float) -> bool:
        """Whether the speed lies inside the range."""
        return self.speed_range[0] <= speed <= self.speed_range[1]


@dataclass(frozen=True)
class RegularTable:
    """A coefficient on a grid of speed and angle, bilinear between the nodes.

    Attributes:
        speeds: strictly increasing (n), m/s.
        angles: strictly increasing |gamma| (m), rad.
        values: n rows of m.
        measured: n rows of m flags; a cell is covered when all its corners are measured. All are when empty.
        where: name of the file or table, for messages.
    """

    speeds: tuple[float, ...]
    angles: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]
    measured: tuple[tuple[bool, ...], ...] = ()
    where: str = "coefficient table"

    def __post_init__(self) -> None:
        require_increasing("speeds", self.speeds, self.where)
        require_increasing("angles", self.angles, self.where)
        rows = {len(row) for row in self.values}
        if len(self.values) != len(self.speeds) or rows != {len(self.angles)}:
            raise ModelError(
                f"{self.where}: the table must have {len(self.speeds)} rows (speeds) "
                f"of {len(self.angles)} values (angles)"
            )
        require_finite("values", np.asarray(self.values, float), self.where)

    def __call__(self, speed: Scalar, angle: Scalar) -> Scalar:
        """The coefficient at a speed and an angle of attack."""
        return self.at(self.cell(speed, angle))

    def cell(self, speed: Scalar, angle: Scalar) -> tuple[int, Scalar, int, Scalar]:
        """Row and fraction, column and fraction of a point; tables on one grid share it."""
        return *_cell(self.speeds, speed), *_cell(self.angles, angle)

    def at(self, cell: tuple[int, Scalar, int, Scalar]) -> Scalar:
        """The coefficient at a point given by its cell."""
        i, x, j, y = cell
        low, high = self.values[i], self.values[i + 1]
        at_low = low[j] + (low[j + 1] - low[j]) * y
        return at_low + (high[j] + (high[j + 1] - high[j]) * y - at_low) * x

    def covers(self, speed: float, angle: float) -> bool:
        """Whether the point lies in a cell with measured corners; on a grid line only the nodes of that line count."""
        if not (self.speeds[0] <= speed <= self.speeds[-1] and self.angles[0] <= angle <= self.angles[-1]):
            return False
        if not self.measured:
            return True
        (i, x), (j, y) = _cell(self.speeds, speed), _cell(self.angles, angle)
        rows = [r for r, weight in ((i, 1.0 - x), (i + 1, x)) if weight > 0.0]
        columns = [c for c, weight in ((j, 1.0 - y), (j + 1, y)) if weight > 0.0]
        return all(self.measured[r][c] for r in rows for c in columns)


def _cell(grid: tuple[float, ...], value: Scalar) -> tuple[int, Scalar]:
    """Index of the left neighbour and the fraction of the way to the right one, 0 to 1."""
    if value <= grid[0]:
        return 0, 0.0
    last = len(grid) - 2
    if value >= grid[-1]:
        return last, 1.0
    i = bisect_right(grid, value if isinstance(value, float) else float_of(value)) - 1
    return i, (value - grid[i]) / (grid[i + 1] - grid[i])


@dataclass(frozen=True)
class PolynomialSurface:
    """sum c_pq (speed / speed_scale)^p (angle / angle_scale)^q; speed and angle are held at the edges of the range.

    Attributes:
        coefficients: rows p of columns q.
        speed_range, angle_range: that the nodes spanned, m/s and rad.
        speed_scale, angle_scale: m/s and rad; keep the coefficients of order one.
    """

    coefficients: tuple[tuple[float, ...], ...]
    speed_range: tuple[float, float]
    angle_range: tuple[float, float]
    speed_scale: float = 1.0
    angle_scale: float = 1.0

    def __post_init__(self) -> None:
        where = "polynomial surface"
        require_increasing("speed_range", self.speed_range, where)
        require_increasing("angle_range", self.angle_range, where)
        require_finite("coefficients", np.asarray(self.coefficients, float), where)
        for name in ("speed_scale", "angle_scale"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(f"{where}: {name} is {value}, but it must be a finite number above 0")

    @property
    def degree(self) -> tuple[int, int]:
        """Degree in speed and in angle."""
        return len(self.coefficients) - 1, len(self.coefficients[0]) - 1

    def __call__(self, speed: Scalar, angle: Scalar) -> Scalar:
        """The coefficient at a speed and an angle of attack, by Horner's rule."""
        (v_low, v_high), (g_low, g_high) = self.speed_range, self.angle_range
        v = (v_low if speed < v_low else v_high if speed > v_high else speed) / self.speed_scale
        g = (g_low if angle < g_low else g_high if angle > g_high else angle) / self.angle_scale
        total = 0.0
        for row in reversed(self.coefficients):
            inner = 0.0
            for c in reversed(row):
                inner = inner * g + c
            total = total * v + inner
        return total

    def covers(self, speed: float, angle: float) -> bool:
        """Whether the point lies in the range of the nodes."""
        return (
            self.speed_range[0] <= speed <= self.speed_range[1] and self.angle_range[0] <= angle <= self.angle_range[1]
        )


def fit_surface(
    speeds: np.ndarray, angles: np.ndarray, values: np.ndarray, highest: tuple[int, int] = (2, 5)
) -> PolynomialSurface:
    """Least-squares surface of the highest degree that the nodes determine, up to 2 x 5 (thesis Fig. 4.21).

    The degree with the most coefficients whose design matrix has full column rank is taken; of equals the one that is
    higher in the angle.

    Args:
        speeds, angles, values: one entry per node.

    Raises:
        ModelError: NaN, or nodes that span no range in speed or angle.
    """
    v, g, c = (np.asarray(array, float) for array in (speeds, angles, values))
    for name, array in (("speeds", v), ("angles", g), ("values", c)):
        require_finite(name, array, "surface fit")
    v_scale, g_scale = float(v.max()) or 1.0, float(g.max()) or 1.0
    choices = sorted(
        ((p, q) for p in range(highest[0] + 1) for q in range(highest[1] + 1)),
        key=lambda d: (-(d[0] + 1) * (d[1] + 1), -d[1]),
    )
    for p, q in choices:
        design = np.vander(v / v_scale, p + 1, True)[:, :, None] * np.vander(g / g_scale, q + 1, True)[:, None, :]
        matrix = design.reshape(len(c), -1)
        if (
            matrix.shape[1] <= len(c)
            and np.linalg.matrix_rank(matrix, tol=1e-9 * np.sqrt(matrix.size)) == matrix.shape[1]
        ):
            solution = np.linalg.lstsq(matrix, c, rcond=None)[0].reshape(p + 1, q + 1)
            rows = tuple(tuple(float(x) for x in row) for row in solution)
            return PolynomialSurface(
                rows, (float(v.min()), float(v.max())), (float(g.min()), float(g.max())), v_scale, g_scale
            )
    raise ModelError("surface fit: there are no nodes")
