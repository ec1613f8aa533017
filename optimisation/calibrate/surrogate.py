"""Figures and flips of any car of the prior: Gaussian processes of reduced cars, corrected by full
ones.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby

import numpy as np
from scipy.linalg import cho_solve
from scipy.special import log_ndtr
from scipy.stats import norm

from aerodima.optimisation.calibrate.calibration_plan import (
    FIGURES,
    LIFT,
    NUISANCES,
    CarPrior,
    Figure,
    Turn,
)
from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Facts

METRICS = (*FIGURES, LIFT)
MEANS = ("average_yaw_rate_rad_per_s", "average_linear_acceleration_m_per_s2")
"""Metrics of trends."""
MIN_MEAN = 1e-3
"""Least mean that has a logarithm, in the unit of its metric."""
TurnResults = Mapping[str, Facts]
"""Name of a turn -> lists of the results of its cars, by name."""
VARIANCE_BOUNDS = (1e-2, 1e3)
"""Bounds of the variance that a process is tuned in."""
LENGTH_BOUNDS = (0.3, 100.0)
"""Bounds of its lengths over scaled columns."""
NOISE_BOUNDS = (1e-5, 1.0)
"""Bounds of the variance of its noise."""
HYPERPARAMETER_SAMPLES = 250
"""Most rows by which a process is tuned."""
TRAINING_SAMPLES = 1200
"""Most rows to which a process is fitted."""
MIN_REDUCED_CARS = 8
"""Cars that a process needs."""
MIN_FULL_CARS = 3
"""Full cars that a correction needs."""
RIDGES = np.logspace(0.0, 4.0, 9)
"""Ridges of a correction that are tried."""
MIN_MARGIN = 0.005
"""Margin that counts as none."""
QUADRATURE_NODES = np.linspace(-6.0, 6.0, 121)
"""Residuals of the surrogate for a car, over their deviation."""
LOG_WEIGHTS = np.log(norm.pdf(QUADRATURE_NODES) / norm.pdf(QUADRATURE_NODES).sum())[:, None]
"""Logarithms of the weights of the nodes."""


@dataclass(frozen=True)
class Regression:
    """A regression over some columns of scaled cars.

    Attributes:
        columns: of the cars.
        model: scaled columns (m, c) -> values (m, k).
        deviation: of the residuals of cars that it was not fitted to (k), in the unit of its
            values.
        residuals: of each row, fitted without that row's car (m, k).
    """

    columns: tuple[int, ...]
    model: Callable[[FloatArray], FloatArray]
    deviation: FloatArray
    residuals: FloatArray = field(default_factory=lambda: np.zeros((0, 1)))

    @classmethod
    def process(
        cls, columns: list[int], scaled: FloatArray, values: FloatArray, cars: IntArray
    ) -> Regression:
        """Fits a Gaussian process with a length for every column to values (m, k) at scaled cars
        (m, n).

        Args:
            cars: which car a row is of (m); the residuals of a car are found without all rows of
                that car.
        """
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

        rows = np.random.default_rng(len(values)).permutation(len(values))[:TRAINING_SAMPLES]
        middle = values.mean(axis=0)
        spread = values.std(axis=0) + 1e-9
        chosen = scaled[rows][:, columns]
        target = (values[rows] - middle) / spread
        kernel = ConstantKernel(1.0, VARIANCE_BOUNDS) * RBF(
            np.full(len(columns), 2.0), LENGTH_BOUNDS
        ) + WhiteKernel(0.01, NOISE_BOUNDS)
        with warnings.catch_warnings():
            # The length of a column without influence is at its bound.
            warnings.simplefilter("ignore")
            tuned = (
                GaussianProcessRegressor(kernel)
                .fit(chosen[:HYPERPARAMETER_SAMPLES], target[:HYPERPARAMETER_SAMPLES])
                .kernel_
            )
        fitted = GaussianProcessRegressor(tuned, optimizer=None).fit(chosen, target)
        size = tuned.k1.k1.constant_value
        lengths = tuned.k1.k2.length_scale
        weights = fitted.alpha_.reshape(target.shape)
        places = chosen / lengths
        model = partial(_process_at, lengths, places, weights * (size * spread), middle)
        inverse = cho_solve((fitted.L_, True), np.eye(len(rows)))
        residuals = np.full(values.shape, np.nan)
        for own in _rows_by(cars[rows]):
            residuals[rows[own]] = spread * np.linalg.solve(inverse[np.ix_(own, own)], weights[own])
        rest = np.isnan(residuals[:, 0])  # not fitted, so that the process has not seen them
        residuals[rest] = values[rest] - model(scaled[rest][:, columns])
        return cls(tuple(columns), model, _deviation(residuals[rows]), residuals)

    @classmethod
    def line(
        cls, columns: list[int], scaled: FloatArray, values: FloatArray, cars: IntArray
    ) -> Regression:
        """Fits a plane with a ridge, for rows of few cars; arguments as those of `process`."""
        from sklearn.linear_model import Ridge
        from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_predict

        chosen = scaled[:, columns]
        folds = GroupKFold(min(8, len(np.unique(cars))))
        tried = GridSearchCV(Ridge(), {"alpha": RIDGES}, cv=folds, scoring="neg_mean_squared_error")
        ridge = tried.fit(chosen, values, groups=cars).best_estimator_
        predicted = cross_val_predict(ridge, chosen, values, groups=cars, cv=folds)
        residuals = values - predicted.reshape(values.shape)
        model = partial(_plane_at, np.atleast_2d(ridge.coef_), np.atleast_1d(ridge.intercept_))
        return cls(tuple(columns), model, _deviation(residuals), residuals)

    def __call__(self, scaled: FloatArray) -> FloatArray:
        """Returns values (m, k) at scaled cars (m, n)."""
        return self.model(scaled[:, self.columns])


def _process_at(
    lengths: FloatArray,
    places: FloatArray,
    weights: FloatArray,
    middle: FloatArray,
    inputs: FloatArray,
) -> FloatArray:
    """Predicts as sklearn's `predict`, without its checks, which take most of the time of a
    posterior.
    """
    at = inputs / lengths
    alike = at @ places.T
    alike -= 0.5 * np.sum(places**2, axis=1)
    alike -= 0.5 * np.sum(at**2, axis=1)[:, None]
    return middle + np.exp(alike, out=alike) @ weights


def _plane_at(slopes: FloatArray, offset: FloatArray, inputs: FloatArray) -> FloatArray:
    return inputs @ slopes.T + offset


@dataclass(frozen=True)
class Surrogate:
    """Figures and flips of every turn of a plan, for any car.

    Attributes:
        prior: whose coordinates the cars have.
        flips: name of the turn -> logarithm of the friction at the flip.
        figures: name of the turn -> `METRICS`.
        shifts: name of the turn -> full less reduced cars in that logarithm; its deviation is that
            of the surrogate.
        corrections: name of the turn -> full less reduced cars in `METRICS`, likewise.
        means: name of a turn of a trend -> logarithms of `MEANS`.
    """

    prior: CarPrior
    flips: dict[str, Regression]
    figures: dict[str, Regression]
    shifts: dict[str, Regression] = field(default_factory=dict)
    corrections: dict[str, Regression] = field(default_factory=dict)
    means: dict[str, Regression] = field(default_factory=dict)

    @classmethod
    def from_reduced(cls, prior: CarPrior, cars: FloatArray, results: TurnResults) -> Surrogate:
        """Fits to `run_reduced` of all cars (m, n), by name of the turn."""
        flips, figures = _fit(Regression.process, prior, cars, results, MIN_REDUCED_CARS)
        means = {
            turn.name: _fit_means(prior, turn, cars, results[turn.name])
            for trend in prior.plan.trends
            for turn in trend.turns()
        }
        return cls(prior, flips, figures, means=means)

    def corrected(self, cars: FloatArray, results: TurnResults) -> Surrogate:
        """Corrects by `search_full` of all cars (m, n), by name of the turn."""
        fits = _fit(Regression.line, self.prior, cars, results, MIN_FULL_CARS, self)
        return replace(self, shifts=fits[0], corrections=fits[1])

    def margin(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Returns the logarithm of the friction at the flip over that of the car (m); above 0 it
        survives.
        """
        scaled = self.prior.scaled(cars)
        flip = self.flips[turn.name](scaled)
        if turn.name in self.shifts:
            flip = flip + self.shifts[turn.name](scaled)
        return np.asarray(flip[:, 0] - np.log(cars[:, self.prior.column(turn.friction)]))

    def flip_deviation(self, turn: Turn) -> float:
        """Returns the standard deviation of the residuals of the margin."""
        return float(self.shifts.get(turn.name, self.flips[turn.name]).deviation[0])

    def survival(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Returns the probability (m) that a car survives a turn, with the width of the plan and
        the residuals of the surrogate.
        """
        width = np.hypot(self.prior.plan.outcome_width[turn.tail], self.flip_deviation(turn))
        return np.asarray(norm.cdf(self.margin(cars, turn) / width))

    def draw_outcomes(self, car: FloatArray, rng: np.random.Generator) -> dict[str, bool]:
        """Draws which turns a car (1, n) survives, with the probabilities of `log_outcomes`."""
        plan = self.prior.plan
        residuals = {_kind(turn): rng.standard_normal() for turn in plan.turns}
        survives = {}
        for turn in plan.turns:
            margin = self.margin(car, turn)[0] + self.flip_deviation(turn) * residuals[_kind(turn)]
            needed = plan.outcome_width[turn.tail] * rng.standard_normal()
            survives[turn.name] = bool(margin > needed)
        return survives

    def log_outcomes(self, margins: Mapping[str, FloatArray]) -> FloatArray:
        """Returns the logarithm of the probability (m) of how all turns of the plan ended, by their
        `margin` (m).

        What the surrogate misses is one number for the turns of a car that differ in their speed
        alone.
        """
        total: FloatArray = np.zeros(())
        for _, turns in groupby(sorted(self.prior.plan.turns, key=_kind), key=_kind):
            joint: FloatArray = np.zeros(())
            for turn in turns:
                residuals = self.flip_deviation(turn) * QUADRATURE_NODES[:, None]
                z = (margins[turn.name] + residuals) / self.prior.plan.outcome_width[turn.tail]
                joint = joint + log_ndtr(z if turn.ends == "survived" else -z)
            total = total + np.logaddexp.reduce(joint + LOG_WEIGHTS)
        return total

    def values(self, cars: FloatArray, turn: Turn, margin: FloatArray | None = None) -> FloatArray:
        """Returns `METRICS` of cars (m, n) in a turn (m, 6), each in its unit; `margin` (m) where
        it is known already.
        """
        if margin is None:
            margin = self.margin(cars, turn)
        inputs = _with_margin(self.prior.scaled(cars), margin)
        values = self.figures[turn.name](inputs)
        if turn.name in self.corrections:
            values = values + self.corrections[turn.name](inputs)
        return values

    def value(self, cars: FloatArray, figure: Figure) -> FloatArray:
        """Returns a figure of cars (m, n), in its unit (m)."""
        return self.values(cars, figure.turn)[:, METRICS.index(figure.metric)]

    def log_trends(self, cars: FloatArray, values: Mapping[str, FloatArray]) -> FloatArray:
        """Returns the logarithm of the probability (m) of the plan's trends, given cars (m, n).

        What counts is how the values at all speeds differ from their own power of the speed.

        Args:
            values: name of a turn with a table -> its `METRICS` (m, 6).
        """
        scaled = self.prior.scaled(cars)
        total = np.zeros(len(cars))
        for trend in self.prior.plan.trends:
            reference = self.prior.plan.reference(trend)
            shown = values[reference.name][:, METRICS.index(trend.metric)]
            logs = [np.log(np.maximum(shown, MIN_MEAN))]
            speeds = [reference.speed]
            variances = [trend.deviation**2]
            for turn in trend.turns():
                regression = self.means[turn.name]
                column = MEANS.index(trend.metric)
                logs.append(regression(scaled)[:, column])
                speeds.append(turn.speed)
                variances.append(trend.deviation**2 + regression.deviation[column] ** 2)
            residuals = np.array(logs) - trend.exponent * np.log(speeds)[:, None]
            weights = 1.0 / np.array(variances)[:, None]
            middle = np.sum(weights * residuals, axis=0) / np.sum(weights)
            total -= 0.5 * np.sum(weights * (residuals - middle) ** 2, axis=0)
        return total

    def deviation(self, figure: Figure) -> float:
        """Returns the standard deviation of the residuals of a figure."""
        surface = self.corrections.get(figure.turn.name, self.figures[figure.turn.name])
        return float(surface.deviation[METRICS.index(figure.metric)])


def _fit(
    fit: Callable[[list[int], FloatArray, FloatArray, IntArray], Regression],
    prior: CarPrior,
    cars: FloatArray,
    results: TurnResults,
    min_cars: int,
    base: Surrogate | None = None,
) -> tuple[dict[str, Regression], dict[str, Regression]]:
    """Fits the flips and figures of every turn, or what they are beyond those of a surrogate.

    Args:
        fit: of `Regression`.
        prior: whose coordinates the cars have.
        cars: that were searched (m, n).
        results: of `run_reduced` or `search_full`, by name of the turn.
        min_cars: that a fit needs.
        base: surrogate that is corrected.
    """
    flips = {}
    figures = {}
    for turn in prior.plan.turns:
        name = turn.name
        known, flip, tried, shown, index = _search(turn, cars, results[name], min_cars)
        scaled = prior.scaled(cars[known])
        values = flip[known, None]
        if base is not None:
            values = values - base.flips[name](scaled)
        regression = fit(_flip_columns(prior, turn), scaled, values, known)
        flips[name] = regression
        if turn.table:
            margin = _unseen(prior, turn, flip, regression, tried, index)
            inputs = _with_margin(prior.scaled(tried), margin)
            if base is not None:
                shown = shown - base.figures[name](inputs)
            columns = [*prior.inputs(turn.system), len(prior.names)]
            figures[name] = fit(columns, inputs, shown, index)
    return flips, figures


def _fit_means(
    prior: CarPrior, turn: Turn, cars: FloatArray, result: Facts
) -> Regression:
    """Fits the logarithms of `MEANS` of the cars (m, n) that survive a turn of a trend."""
    tried, index = _tried(cars, result)
    shown = np.array(result["figures"])[:, [METRICS.index(name) for name in MEANS]]
    logs = np.log(np.maximum(shown, MIN_MEAN))
    return Regression.process(prior.inputs(turn.system), prior.scaled(tried), logs, index)


def _kind(turn: Turn) -> tuple[str, str]:
    return turn.system, turn.tail


def _flip_columns(prior: CarPrior, turn: Turn) -> list[int]:
    """Returns the columns that the flip of a turn depends on."""
    columns = prior.inputs(turn.system)[:-1]
    without = [prior.column(name) for name in NUISANCES if name != "gyro_bias"]
    return [column for column in columns if column not in without]


def _unseen(
    prior: CarPrior,
    turn: Turn,
    flip: FloatArray,
    regression: Regression,
    tried: FloatArray,
    index: IntArray,
) -> FloatArray:
    """Returns the margin of cars that were tried (k), as the surrogate predicts it for cars it was
    not fitted to; `index` (k) of each among the flips.
    """
    predicted = flip.copy()
    predicted[np.isfinite(flip)] -= regression.residuals[:, 0]
    friction = tried[:, prior.column(turn.friction)]
    return np.asarray(predicted[index] - np.log(friction))


def _with_margin(scaled: FloatArray, margin: FloatArray) -> FloatArray:
    """Joins scaled cars (m, n) and the logarithm of their margin (m): a car leans ever further as
    the margin goes to 0.
    """
    return np.column_stack([scaled, np.log(0.5 * (margin + np.hypot(margin, 2.0 * MIN_MARGIN)))])


def _search(
    turn: Turn, cars: FloatArray, result: Facts, min_cars: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Returns which of the cars flip, the flip of each, cars (k, n) that survived, their figures
    (k, 6), and the index of their car.
    """
    flip = np.array(result["flips"], float)
    known = np.flatnonzero(np.isfinite(flip))
    tried, index = _tried(cars, result)
    has_flip = np.isfinite(flip[index])
    shown = len(np.unique(index[has_flip]))
    if min(len(known), shown) < min_cars:
        errors = "".join(result.get("errors", [])[:1])
        raise UserError(
            f"{turn.name} m/s: {len(known)} of {len(flip)} cars flip at a friction that was tried, "
            f"{shown} of these have runs that survive; needed are {min_cars} of each{errors}"
        )
    figures = np.array(result["figures"])
    return known, flip, tried[has_flip], figures[has_flip], index[has_flip]


def _tried(cars: FloatArray, result: Facts) -> tuple[FloatArray, IntArray]:
    """Returns the cars (k, n) that survived, and the index of each among all (m, n)."""
    tried = np.array(result["inputs"]).reshape(-1, cars.shape[1])
    order = np.argsort(cars[:, 0])
    # No two cars share their first number.
    return tried, order[np.searchsorted(cars[order, 0], tried[:, 0])]


def _deviation(residuals: FloatArray) -> FloatArray:
    """Returns the size that 68 % of residuals (m, k) do not exceed; a car at a flip's edge may be
    off by any amount.
    """
    return np.asarray(np.quantile(np.abs(residuals), 0.6827, axis=0))


def _rows_by(cars: IntArray) -> list[IntArray]:
    """Returns the rows of each car."""
    order = np.argsort(cars, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(cars[order])) + 1)
