"""Prior of the cars: uniform over the ranges of the parameters, cut to what is plausible; weights and draws by weight.

A car is a point of the unit cube, one coordinate per parameter. The coordinate of the centre of mass stands for the
friction over the static stability factor, mu/SSF = friction x height / half track, which decides the flip (design
section 7): drawn uniformly within the plan's limits it spends the runs where the flip is. Half the track is that of the
line on which the outer tyres stand once the car leans (`CarParameters.outer_half_track`). A uniform prior of the height
then has the density half track / friction in mu/SSF, which `Prior.log_density` returns.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from aerodima.optimisation.calibration.calibration_plan import Plausible, prior_ranges
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.plants.car_model import chassis_centre

Window = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Coordinates (m, n) -> ends (m), (m) of the coordinate of mu/SSF; it may not look at that coordinate."""

HEIGHT, FRICTION, TRACK, WIDTH = "car.com_height", "car.tyre_friction", "car.track", "car.tyre_width"


@dataclass(frozen=True)
class Prior:
    """Prior over a car, or over a car and its tail.

    Attributes:
        keys: parameters that vary as `section.key`: the columns of coordinates and values.
        plausible: what a car cannot be.
        base: scenario that holds every number that does not vary.
    """

    keys: tuple[str, ...]
    plausible: Plausible
    base: Scenario

    @cached_property
    def ranges(self) -> FloatArray:
        """Lowest and highest value (n, 2)."""
        return prior_ranges(self.keys)

    @property
    def leading(self) -> int:
        """Column of the coordinate that decides the flip first, mu/SSF."""
        return self.keys.index(HEIGHT)

    @property
    def leading_of_metrics(self) -> tuple[int, ...]:
        """Columns that decide the metrics of a turn first: sliding tyres give no more than their friction."""
        return (self.keys.index(FRICTION), self.leading)

    @property
    def ratio_scale(self) -> float:
        """Change of mu/SSF over that of its coordinate."""
        return self.plausible.highest_mu_over_ssf.value - self.plausible.lowest_mu_over_ssf.value

    def mu_over_ssf(self, coordinate: FloatArray) -> FloatArray:
        """Friction x height of the centre of mass / half track of its coordinate (m)."""
        return self.plausible.lowest_mu_over_ssf.value + np.asarray(coordinate) * self.ratio_scale

    def half_track(self, values: FloatArray) -> FloatArray:
        """`CarParameters.outer_half_track` (m) of cars (m, n), m."""
        width = values[:, self.keys.index(WIDTH)] if WIDTH in self.keys else self.base.car.tyre_width
        edge = 0.5 * width if self.base.car.tyre_shape == "cylinder" else 0.0
        found: FloatArray = 0.5 * values[:, self.keys.index(TRACK)] + edge
        return found

    def values(self, coordinates: FloatArray) -> FloatArray:
        """Parameters (m, n) in their units of coordinates (m, n) in [0, 1]."""
        low, high = self._scale
        values = low + np.asarray(coordinates) * (high - low)
        height = self.keys.index(HEIGHT)
        values[:, height] *= self._half_track_over_friction(values)
        return values

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Inverse of `values`; outside [0, 1] for values outside their ranges."""
        low, high = self._scale
        scaled = np.array(values, float)
        height = self.keys.index(HEIGHT)
        scaled[:, height] /= self._half_track_over_friction(scaled)
        return (scaled - low) / (high - low)

    def log_density(self, values: FloatArray) -> FloatArray:
        """Logarithm of the prior density in coordinates, up to a constant (m); -inf where a car is implausible."""
        density = np.log(self._half_track_over_friction(values))
        inside = np.all((values >= self.ranges[:, 0] - 1e-12) & (values <= self.ranges[:, 1] + 1e-12), axis=1)
        return np.where(inside & self.are_plausible(values), density, -np.inf)

    def log_density_at(self, coordinates: FloatArray, leading: FloatArray) -> FloatArray:
        """`log_density` of cars (m, n) with another coordinate of mu/SSF (m)."""
        moved = coordinates.copy()
        moved[:, self.leading] = leading
        return self.log_density(self.values(moved))

    def are_plausible(self, values: FloatArray) -> NDArray[np.bool_]:
        """Which cars (m) of (m, n) exist at all, with the chassis' centre of mass where a chassis can have it."""
        car, tail = SimpleNamespace(**dict(self.base.car)), SimpleNamespace(**dict(self.base.tail))
        sections = {"car": car, "tail": tail}
        for key, column in zip(self.keys, values.T, strict=True):
            section, _, name = key.partition(".")
            if section in sections:
                setattr(sections[section], name, column)
        radii = np.sort(np.broadcast_arrays(car.gyration_roll, car.gyration_pitch, car.gyration_yaw), axis=0)
        physical = radii[2] ** 2 <= radii[0] ** 2 + radii[1] ** 2
        mass, x, z = chassis_centre(car, tail, self.base.environment.gravity)  # type: ignore[arg-type]
        limits = self.plausible
        high_enough = (z >= limits.lowest_chassis_com.value) & (z <= limits.highest_chassis_com.value)
        between_the_axles = (x > 0.0) & (x < car.wheelbase)
        arm = np.less_equal(tail.sail_length, tail.length)
        result = physical & (mass > 0.0) & high_enough & (z < 2 * car.com_height) & between_the_axles & arm
        return np.broadcast_to(result, len(values))

    def points(self, number: int, seed: int) -> FloatArray:
        """Coordinates (number, n) of a scrambled Sobol sequence, plausible or not; a power of two keeps its balance."""
        exponent = max(number - 1, 1).bit_length()
        points: FloatArray = qmc.Sobol(len(self.keys), seed=seed).random_base2(exponent)[:number]
        return points

    def draw(self, number: int, seed: int, window: Window | None = None) -> tuple[FloatArray, FloatArray]:
        """Draws plausible cars.

        Args:
            number: how many points of the sequence.
            seed: of the scrambling.
            window: draws the coordinate of mu/SSF between these ends only; the log density makes up for it.

        Returns:
            Coordinates (m, n) of the plausible ones among them, and the log density of the prior there, relative to
            the one they were drawn with (m).
        """
        points = self.points(number, seed)
        share: FloatArray = np.ones(len(points))
        if window is not None:
            low, high = window(points)
            points[:, self.leading] = low + points[:, self.leading] * (high - low)
            share = high - low
        density = self.log_density(self.values(points)) + np.log(share)
        kept = np.isfinite(density)
        return points[kept], density[kept]

    @cached_property
    def _scale(self) -> tuple[FloatArray, FloatArray]:
        low, high = self.ranges[:, 0].copy(), self.ranges[:, 1].copy()
        height = self.keys.index(HEIGHT)
        limits = self.plausible
        low[height], high[height] = limits.lowest_mu_over_ssf.value, limits.highest_mu_over_ssf.value
        return low, high

    def _half_track_over_friction(self, values: FloatArray) -> FloatArray:
        return self.half_track(values) / values[:, self.keys.index(FRICTION)]


def normalised(log_weights: FloatArray) -> FloatArray:
    """Weights (m) that sum to 1; zero where the logarithm is -inf. All zero if there is none above."""
    finite = np.isfinite(log_weights)
    if not np.any(finite):
        return np.zeros(len(log_weights))
    weights = np.where(finite, np.exp(np.where(finite, log_weights, 0.0) - np.max(log_weights[finite])), 0.0)
    return weights / np.sum(weights)


def effective_size(weights: FloatArray) -> float:
    """Effective sample size (sum w)^2 / sum w^2; 0 for weights that are all zero."""
    power = float(np.sum(np.square(weights)))
    return float(np.sum(weights)) ** 2 / power if power > 0.0 else 0.0


def systematic_sample(weights: FloatArray, number: int, seed: int) -> NDArray[np.int64]:
    """Indices of `number` draws with probability proportional to the weights, by systematic resampling."""
    start = np.random.default_rng(seed).random()
    places = (start + np.arange(number)) / number
    cumulative = np.cumsum(weights) / np.sum(weights)
    return np.minimum(np.searchsorted(cumulative, places), len(weights) - 1)
