"""What is known of cars that are not yet run: surrogates over their coordinates, and what pilot runs tell.

Surrogates are polynomial chaos, fitted by Bayesian linear regression: sums of Legendre polynomials up to degree 2,
orthonormal over the unit cube, with a Gaussian prior on the coefficients that holds second-order terms smaller than
linear ones.

A pilot run tells more than whether the car flipped. Near the critical mu/SSF the car comes to rest at the tipping
point, or leaves it exponentially: a roll that stops short of it lacks an energy that grows with the distance to the
critical value, and a flip takes the longer the smaller that distance is. Both give the distance within a factor of
about two, so two or three runs find a critical mu/SSF where bisection would take six.

Both only say where a car is run next; the weight of every member rests on its own runs
(`aerodima.optimisation.calibration.member_draw`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from aerodima.optimisation.calibration.calibration_runs import Datum, flips_in_the_turn, log_density, survives
from aerodima.workbench.config.array_types import FloatArray

LINEAR_SCALES = (0.03, 0.1, 0.3, 1.0)
"""Candidates for the prior standard deviation of a linear coefficient, in standard deviations of the quantity."""
NOISES = (0.03, 0.1, 0.3, 1.0)
"""Candidates for what the polynomial leaves over, in the same unit."""
CHUNK = 4096
"""Points that are expanded at a time; all at once would take gigabytes."""
LEADING_SCALE = 3.0
"""Prior standard deviation of the linear coefficient of a leading coordinate, same unit."""
SECOND_ORDER = 0.15
"""Prior standard deviation of a second-order coefficient relative to a linear one."""


def basis(coordinates: FloatArray) -> FloatArray:
    """Orthonormal Legendre polynomials up to degree 2 of coordinates (m, n): shape (m, 1 + n + n (n + 1) / 2).

    Order: 1; the linear terms; the squares; the products of two different coordinates.
    """
    x = 2.0 * np.asarray(coordinates, float) - 1.0
    linear = np.sqrt(3.0) * x
    squares = np.sqrt(5.0) * 0.5 * (3.0 * x**2 - 1.0)
    first, second = np.triu_indices(x.shape[1], 1)
    return np.hstack([np.ones((len(x), 1)), linear, squares, linear[:, first] * linear[:, second]])


def coefficient_scales(size: int, linear: float) -> FloatArray:
    """Prior standard deviations of the coefficients of `basis` for `size` coordinates; the constant is free."""
    second = linear * SECOND_ORDER
    return np.concatenate([[1e3], np.full(size, linear), np.full(size + size * (size - 1) // 2, second)])


@dataclass(frozen=True)
class Surrogate:
    """One quantity over the coordinates.

    Attributes:
        centre, spread: of the runs it was fitted to.
        coefficients: of `basis`, in spreads.
        error: standard deviation of its prediction of cars left out of the fit, unit of the quantity.
    """

    centre: float
    spread: float
    coefficients: FloatArray
    error: float


def predictions(coordinates: FloatArray, surrogates: Sequence[Surrogate]) -> list[FloatArray]:
    """Each quantity (m) at coordinates (m, n), in its unit; `basis`, most of the work, is evaluated once for all."""
    if not surrogates:
        return []
    parts = np.array_split(np.asarray(coordinates), max(1, len(coordinates) // CHUNK))
    found = []
    for part in parts:
        terms = basis(part)
        found.append([terms @ surrogate.coefficients for surrogate in surrogates])
    return [
        surrogate.centre + surrogate.spread * np.concatenate(columns)
        for surrogate, columns in zip(surrogates, zip(*found, strict=True), strict=True)
    ]


def fit(
    coordinates: FloatArray, values: FloatArray, cars: NDArray[np.int64] | None = None, leading: tuple[int, ...] = ()
) -> Surrogate:
    """Bayesian linear regression on `basis`; noise and prior scale are chosen by the error of cars left out.

    Args:
        coordinates: (m, n).
        values: of the quantity (m); all finite.
        cars: number of the car of each run (m); runs of one car are left out together. One car each by default.
        leading: columns that are known to matter most; they are not held to the prior scale of the others.
    """
    cars = np.arange(len(values)) if cars is None else cars
    members = [np.flatnonzero(cars == car) for car in np.unique(cars)]
    centre, spread = float(np.mean(values)), float(np.std(values)) or 1.0
    y, features = (values - centre) / spread, basis(coordinates)
    best: tuple[float, FloatArray] | None = None
    for linear in LINEAR_SCALES:
        scales = coefficient_scales(coordinates.shape[1], linear)
        for column in leading:
            scales[1 + column] = LEADING_SCALE
        scaled = features * scales
        gram = scaled @ scaled.T
        for noise in NOISES:
            inverse = np.linalg.inv(gram + noise**2 * np.eye(len(y)))
            weighted = inverse @ y
            left_out = [np.linalg.solve(inverse[np.ix_(own, own)], weighted[own]) for own in members]
            error = float(np.sqrt(np.mean(np.concatenate(left_out) ** 2)))
            if best is None or error < best[0]:
                best = error, scales * (scaled.T @ (inverse @ y))
    assert best is not None
    return Surrogate(centre, spread, best[1], best[0] * spread)


def surrogate_log_likelihood(
    coordinates: FloatArray, surrogates: Mapping[Datum, Surrogate], *, widened: bool = False
) -> FloatArray:
    """Log likelihood (m) of figures by their surrogates, up to a constant.

    Args:
        coordinates: (m, n).
        surrogates: of the figures.
        widened: by the errors of the surrogates: a proposal is to be wider than its target.
    """
    total: FloatArray = np.zeros(len(coordinates))
    found = predictions(coordinates, list(surrogates.values()))
    for (datum, surrogate), values in zip(surrogates.items(), found, strict=True):
        deviation = np.hypot(datum.discrepancy, surrogate.error) if widened else datum.discrepancy
        total += log_density((values - datum.figure) / deviation)
    return total


@dataclass(frozen=True)
class FlipSurrogate:
    """Where a car flips: its critical mu/SSF at two speeds, over the other coordinates.

    Attributes:
        column: of the coordinate that stands for mu/SSF.
        speeds: slow and fast, m/s.
        slow, fast: surrogates of the critical coordinate at these speeds: the car flips above it.
        narrowest: distance of the two that none is taken to fall below.
    """

    column: int
    speeds: tuple[float, float]
    slow: Surrogate
    fast: Surrogate
    narrowest: float

    @property
    def deviation(self) -> float:
        """Standard deviation of a predicted critical coordinate."""
        return max(self.slow.error, self.fast.error)

    def bracket(self, coordinates: FloatArray) -> FloatArray:
        """Probability (m) that the car survives the slow speed and flips at the fast one."""
        slow, below = self.edges(coordinates)
        own = coordinates[:, self.column]
        return np.maximum(ndtr((slow - own) / self.deviation) - ndtr((slow - below - own) / self.deviation), 0.0)

    def window(self, edges: tuple[FloatArray, FloatArray], deviations: float = 3.0) -> tuple[FloatArray, FloatArray]:
        """Ends (m), (m) of the coordinate between which the bracket can be met, from what `edges` gives."""
        slow, below = edges
        reach = deviations * self.deviation
        low = np.clip(slow - below - reach, 0.0, 1.0 - self.narrowest)
        return low, np.clip(slow + reach, low + self.narrowest, 1.0)

    def edges(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Critical coordinate at the slow speed (m), and how far below it that of the fast one lies (m)."""
        others = np.delete(coordinates, self.column, axis=1)
        slow, fast = predictions(others, (self.slow, self.fast))
        return slow, np.maximum(slow - fast, self.narrowest)

    def flip_speed(self, coordinates: FloatArray) -> FloatArray:
        """Speed (m) at which the car flips, m/s: linear in mu/SSF between and beyond the two speeds."""
        slow, below = self.edges(coordinates)
        share = (slow - coordinates[:, self.column]) / below
        return self.speeds[0] + (self.speeds[1] - self.speeds[0]) * share


GRID = np.linspace(-0.3, 1.3, 1601)
"""Critical coordinates that densities are kept at; a car may flip outside of what its mu/SSF may be."""

TIPPING = 0.655
STIFFNESS = 0.04
"""Group = -STIFFNESS (TIPPING - peak roll)^2 below the critical one; fitted to 350 survivors of 89 cars whose critical
mu/SSF had been found by bisection, as are the constants below."""
GROWTH = 3.1
FIRST = -3.4
"""Logarithm of the distance above it = FIRST - GROWTH (time of the flip - end of the steering command)."""
FAR = 0.02
"""Distance beyond which roll and time tell no more than that it is larger."""
EARLY, FLAT = 0.2, 0.06
"""Flips within this time (s) and rolls below this angle (rad) are far."""
FACTOR = 0.65
"""Standard deviation of the logarithm of a distance."""
NEVER = -60.0
"""Logarithm that stands for impossible."""


@dataclass(frozen=True)
class Closeness:
    """How far runs were from the critical mu/SSF.

    Attributes:
        side: 1 where the critical mu/SSF lies above that of the run, -1 below, 0 where the run says nothing (m).
        distance: of mu/SSF (m); a lower bound where `is_far`.
        is_far: (m).
    """

    side: NDArray[np.int64]
    distance: FloatArray
    is_far: NDArray[np.bool_]


def closeness(rows: pd.DataFrame, steering_end: float) -> Closeness:
    """Reads runs; a car that tips over before its turn is far above.

    Args:
        rows: of the runs.
        steering_end: time at which the command goes straight again, s.
    """
    survived, flipped = survives(rows), flips_in_the_turn(rows)
    tipped = np.asarray(rows["outcome"] == "flipped", bool) & ~flipped
    roll = _numbers(rows, "peak_roll_rad", TIPPING)
    late = _numbers(rows, "stopped_at_flip_s", steering_end + 1.5) - steering_end
    below = STIFFNESS * np.maximum(TIPPING - roll, 0.05) ** 2
    above = np.exp(FIRST - GROWTH * late)
    side = np.where(survived, 1, np.where(flipped | tipped, -1, 0))
    is_far = np.where(survived, roll < FLAT, (late < EARLY) | tipped)
    return Closeness(side, np.where(is_far, FAR, np.where(survived, below, above)), is_far)


@dataclass(frozen=True)
class Edge:
    """Densities of the critical coordinates of cars.

    Attributes:
        log_density: over `GRID`, up to a constant per car (m, k).
    """

    log_density: FloatArray

    @classmethod
    def around(cls, middle: FloatArray, deviation: FloatArray) -> "Edge":
        """What a surrogate says: its prediction (m) and its error (m), with the tails of Student's t (5 degrees)."""
        z = (GRID - middle[:, None]) / deviation[:, None]
        return cls(-3.0 * np.log1p(z**2 / 5.0))

    def after(self, trial: FloatArray, found: Closeness, scale: float) -> "Edge":
        """What is known after one more run of each car at the coordinate `trial` (m).

        Args:
            trial: coordinate of mu/SSF of the run.
            found: in it.
            scale: of mu/SSF over its coordinate.
        """
        gap = scale * found.side[:, None] * (GRID - trial[:, None])
        z = np.log(np.maximum(gap, 1e-5) / found.distance[:, None]) / FACTOR
        near = -2.5 * np.log1p(z**2 / 4.0)
        likelihood = np.where(gap > 0.0, np.where(found.is_far[:, None], log_ndtr(z), near), NEVER)
        return Edge(self.log_density + np.where(found.side[:, None] == 0, 0.0, likelihood))

    def quantile(self, level: float) -> FloatArray:
        """Quantile (m) of each car's critical coordinate."""
        density = np.exp(self.log_density - np.max(self.log_density, axis=1, keepdims=True))
        cumulative = np.cumsum(density, axis=1)
        cumulative /= cumulative[:, -1:]
        return np.array([np.interp(level, row, GRID) for row in cumulative])

    @property
    def middle(self) -> FloatArray:
        """Median (m)."""
        return self.quantile(0.5)

    @property
    def deviation(self) -> FloatArray:
        """Half of the middle two thirds (m)."""
        return 0.5 * (self.quantile(0.84) - self.quantile(0.16))


def _numbers(rows: pd.DataFrame, name: str, otherwise: float) -> FloatArray:
    if name not in rows:
        return np.full(len(rows), otherwise)
    return np.asarray(pd.to_numeric(rows[name], errors="coerce").fillna(otherwise), float)
