"""Figures and flips of any car of the prior: Gaussian processes of reduced cars, corrected by full
ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby

import numpy as np
from scipy.special import log_ndtr, log_softmax
from scipy.stats import norm

from aerodima.optimisation.calibrate.calibration_plan import (
    FIGURES,
    LIFT,
    MEANS,
    NUISANCES,
    CarPrior,
    Figure,
    Turn,
)
from aerodima.optimisation.calibrate.regression import Regression, TrainingSet, tune
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Facts

METRICS = (*FIGURES, LIFT)
MIN_MEAN = 1e-3
"""Smallest mean whose logarithm is taken, in the unit of its metric."""
TurnResults = Mapping[str, Facts]
"""Lists of the results of the cars in each turn, by name of the turn."""
Regressions = dict[str, Regression]
"""Regressions by name of the turn."""
MIN_REDUCED_CARS = 8
"""Number of reduced cars that a process needs."""
MIN_FULL_CARS = 3
"""Number of full cars that a correction needs."""
MIN_MARGIN = 0.005
"""Margin that counts as none."""
QUADRATURE_NODES = np.linspace(-6.0, 6.0, 121)
"""Nodes of a quadrature: residuals of the surrogate for a car, over their deviation."""
LOG_WEIGHTS = log_softmax(norm.logpdf(QUADRATURE_NODES))[:, None]
"""Logarithms of the weights of the nodes."""


@dataclass(frozen=True)
class Surrogate:
    """Figures and flips of every turn of a plan, for any car.

    Attributes:
        prior: prior whose coordinates the cars have.
        flips: regressions of the logarithm of the friction at the flip, by name of the turn.
        figures: regressions of `METRICS`, by name of the turn.
        shifts: regressions of full minus reduced cars in that logarithm, by name of the turn; their
            deviations are those of the surrogate.
        corrections: regressions of full minus reduced cars in `METRICS`, likewise.
        means: regressions of the logarithms of `MEANS`, by name of a turn of a trend.
    """

    prior: CarPrior
    flips: Regressions
    figures: Regressions
    shifts: Regressions = field(default_factory=dict)
    corrections: Regressions = field(default_factory=dict)
    means: Regressions = field(default_factory=dict)

    @classmethod
    def from_reduced(
        cls, prior: CarPrior, cars: FloatArray, results: TurnResults, runs: CachedRunner
    ) -> Surrogate:
        """Fits a surrogate to the results of `run_reduced` for cars (m, n), by name of the turn;
        `runs` tune the processes.
        """
        fit = partial(_fit_processes, runs)
        flips, figures = _fit(fit, prior, cars, results, MIN_REDUCED_CARS)
        means = fit(_training_sets_of_means(prior, cars, results))
        return cls(prior, flips, figures, means=means)

    def corrected(self, cars: FloatArray, results: TurnResults) -> Surrogate:
        """Corrects by the results of `search_full` for cars (m, n), by name of the turn."""
        shifts, corrections = _fit(_fit_lines, self.prior, cars, results, MIN_FULL_CARS, self)
        return replace(self, shifts=shifts, corrections=corrections)

    def margin(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Returns the logarithm of the friction at the flip over that of the car (m); above 0 it
        survives.
        """
        scaled = self.prior.scaled(cars)
        flip = self.flips[turn.name](scaled)
        if turn.name in self.shifts:
            flip = flip + self.shifts[turn.name](scaled)
        return flip[:, 0] - np.log(cars[:, self.prior.column(turn.friction)])

    def flip_deviation(self, turn: Turn) -> float:
        """Returns the standard deviation of the residuals of the margin."""
        return float(self.shifts.get(turn.name, self.flips[turn.name]).deviation[0])

    def survival(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Returns the probability (m) that a car survives a turn, with the width of the plan and
        the residuals of the surrogate.
        """
        width = np.hypot(self.prior.plan.outcome_width[turn.tail], self.flip_deviation(turn))
        return norm.cdf(self.margin(cars, turn) / width)

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
        """Returns the logarithm of the probability (m) of the published ends of all turns, by their
        `margin` (m).

        The error of the surrogate is one number for the turns of a car that differ in their speed
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
        """Returns `METRICS` of cars (m, n) in a turn (m, 6), each in its unit; takes `margin` (m)
        where it is known already.
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

        Only the differences of the values at all speeds from their own power of the speed count.

        Args:
            cars: cars of the prior (m, n).
            values: `METRICS` (m, 6) of each turn with a table, by name of the turn.
        """
        scaled = self.prior.scaled(cars)
        means = {name: regression(scaled) for name, regression in self.means.items()}
        total = np.zeros(len(cars))
        for trend in self.prior.plan.trends:
            column = MEANS.index(trend.metric)
            reference = self.prior.plan.reference(trend)
            shown = values[reference.name][:, METRICS.index(trend.metric)]
            logs = [np.log(np.maximum(shown, MIN_MEAN))]
            errors = [0.0]
            for turn in trend.turns():
                logs.append(means[turn.name][:, column])
                errors.append(self.means[turn.name].deviation[column])
            speeds = np.array([reference.speed, *trend.speeds])
            residuals = np.array(logs) - trend.exponent * np.log(speeds)[:, None]
            weights = 1.0 / (trend.deviation**2 + np.square(errors))
            residuals -= np.average(residuals, axis=0, weights=weights)
            total -= 0.5 * weights @ residuals**2
        return total

    def deviation(self, figure: Figure) -> float:
        """Returns the standard deviation of the residuals of a figure."""
        surface = self.corrections.get(figure.turn.name, self.figures[figure.turn.name])
        return float(surface.deviation[METRICS.index(figure.metric)])


TrainingSets = Mapping[str, TrainingSet]
"""Rows that the regression of a turn is fitted to, by name of the turn."""


def _fit_processes(runs: CachedRunner, sets: TrainingSets) -> Regressions:
    """Fits a Gaussian process to each training set."""
    items = [data.tuning_rows() for data in sets.values()]
    keys = [content_key("tune", *(array.tolist() for array in item)) for item in items]
    runs.stage = "Gaussian processes"
    tuned = runs.map(tune, items, keys)
    return {
        name: Regression.process(data, theta)
        for (name, data), theta in zip(sets.items(), tuned, strict=True)
    }


def _fit_lines(sets: TrainingSets) -> Regressions:
    """Fits a plane to each training set."""
    return {name: Regression.line(data) for name, data in sets.items()}


def _fit(
    fit: Callable[[TrainingSets], Regressions],
    prior: CarPrior,
    cars: FloatArray,
    results: TurnResults,
    min_cars: int,
    base: Surrogate | None = None,
) -> tuple[Regressions, Regressions]:
    """Fits the flips and figures of every turn, or their differences from those of a surrogate.

    Args:
        fit: function that makes the regressions of training sets.
        prior: prior whose coordinates the cars have.
        cars: cars that were searched (m, n).
        results: results of `run_reduced` or `search_full`, by name of the turn.
        min_cars: number of cars that a fit needs.
        base: surrogate that is corrected.
    """
    searches = {}
    sets = {}
    for turn in prior.plan.turns:
        search = _search(turn, cars, results[turn.name], min_cars)
        searches[turn.name] = search
        known, flip, *_ = search
        scaled = prior.scaled(cars[known])
        values = flip[known, None]
        if base is not None:
            values = values - base.flips[turn.name](scaled)
        sets[turn.name] = TrainingSet(_flip_columns(prior, turn), scaled, values, known)
    flips = fit(sets)
    sets = {}
    for turn in prior.plan.turns:
        if turn.table:
            _, flip, tried, shown, index = searches[turn.name]
            margin = _unseen(prior, turn, flip, flips[turn.name], tried, index)
            inputs = _with_margin(prior.scaled(tried), margin)
            if base is not None:
                shown = shown - base.figures[turn.name](inputs)
            columns = [*prior.inputs(turn.system), len(prior.names)]
            sets[turn.name] = TrainingSet(columns, inputs, shown, index)
    return flips, fit(sets)


def _training_sets_of_means(
    prior: CarPrior, cars: FloatArray, results: TurnResults
) -> dict[str, TrainingSet]:
    """Collects the logarithms of `MEANS` of the cars (m, n) that survive the turns of trends."""
    columns = [METRICS.index(name) for name in MEANS]
    sets = {}
    for name, turn in prior.plan.trend_turns.items():
        tried, index = _tried(cars, results[name])
        survivors = len(np.unique(index))
        if survivors < MIN_REDUCED_CARS:
            raise UserError(
                f"{name} m/s: {survivors} of {len(cars)} cars survive; needed are "
                f"{MIN_REDUCED_CARS}"
            )
        logs = np.log(np.maximum(np.array(results[name]["figures"])[:, columns], MIN_MEAN))
        sets[name] = TrainingSet(prior.inputs(turn.system), prior.scaled(tried), logs, index)
    return sets


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
    not fitted to; `index` (k) is that of each car among the flips.
    """
    predicted = flip.copy()
    predicted[np.isfinite(flip)] -= regression.residuals[:, 0]
    return predicted[index] - np.log(tried[:, prior.column(turn.friction)])


def _with_margin(scaled: FloatArray, margin: FloatArray) -> FloatArray:
    """Joins scaled cars (m, n) and the logarithm of their margin (m): a car leans ever further as
    the margin goes to 0.
    """
    return np.column_stack([scaled, np.log(0.5 * (margin + np.hypot(margin, 2.0 * MIN_MARGIN)))])


def _search(
    turn: Turn, cars: FloatArray, result: Facts, min_cars: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Returns the indices of cars whose flip is known, the flip of every car, cars (k, n) that
    survived, their figures (k, 6), and the index of their car.
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
    return known, flip, tried[has_flip], np.array(result["figures"])[has_flip], index[has_flip]


def _tried(cars: FloatArray, result: Facts) -> tuple[FloatArray, IntArray]:
    """Returns the cars (k, n) that survived, and the index of each among all (m, n)."""
    tried = np.array(result["inputs"]).reshape(-1, cars.shape[1])
    # No two cars share their first number.
    return tried, np.argmax(tried[:, :1] == cars[:, 0], axis=1)
