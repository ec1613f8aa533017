"""Figures and flips of any car of the prior: Gaussian processes of reduced cars, corrected by full
ones.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
from scipy.linalg import cho_solve
from scipy.special import log_ndtr
from scipy.stats import norm

from aerodima.optimisation.calibrate.calibration_plan import (
    FIELD_NUISANCES,
    FIGURES,
    FRICTION,
    LIFT,
    CarPrior,
    Figure,
    Turn,
)
from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.core.errors import UserError

METRICS = (*FIGURES, LIFT)
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
NODES = np.linspace(-6.0, 6.0, 121)
WEIGHTS = np.log(norm.pdf(NODES) / norm.pdf(NODES).sum())[:, None]
"""Values of what the surrogate misses of a car, over its deviation, and the logarithms of their
weights."""


@dataclass(frozen=True)
class Regression:
    """A regression over some columns of scaled cars.

    Attributes:
        columns: of the cars.
        model: scaled columns (m, c) -> values (m, k).
        deviation: of what it misses in cars that it was not fitted to (k), in the unit of its
            values.
        missed: what it misses of each row once it was fitted without that row's car (m, k).
    """

    columns: tuple[int, ...]
    model: Callable[[FloatArray], FloatArray]
    deviation: FloatArray
    missed: FloatArray = field(default_factory=lambda: np.zeros((0, 1)))

    @classmethod
    def process(
        cls, columns: list[int], scaled: FloatArray, values: FloatArray, cars: IntArray
    ) -> Regression:
        """Fits a Gaussian process with a length for every column to values (m, k) at scaled cars
        (m, n).

        Args:
            cars: which car a row is of (m); what the process misses of a car is found without all
                rows of that car.
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
        missed = np.full(values.shape, np.nan)
        for own in _rows_by(cars[rows]):
            missed[rows[own]] = spread * np.linalg.solve(inverse[np.ix_(own, own)], weights[own])
        rest = np.isnan(missed[:, 0])  # not fitted, so that the process has not seen them
        missed[rest] = values[rest] - model(scaled[rest][:, columns])
        return cls(tuple(columns), model, _deviation(missed[rows]), missed)

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
        missed = values - cross_val_predict(ridge, chosen, values, groups=cars, cv=folds).reshape(
            values.shape
        )
        slopes = np.atleast_2d(ridge.coef_)
        offset = np.atleast_1d(ridge.intercept_)
        return cls(tuple(columns), partial(_plane_at, slopes, offset), _deviation(missed), missed)

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
    """

    prior: CarPrior
    flips: dict[str, Regression]
    figures: dict[str, Regression]
    shifts: dict[str, Regression] = field(default_factory=dict)
    corrections: dict[str, Regression] = field(default_factory=dict)

    @classmethod
    def from_reduced(
        cls, prior: CarPrior, cars: FloatArray, found: Mapping[str, Mapping[str, Any]]
    ) -> Surrogate:
        """Fits to `run_reduced` of all cars (m, n), by name of the turn."""
        flips = {}
        figures = {}
        for turn in prior.plan.turns:
            name = turn.name
            known, flip, tried, shown, whose = _search(turn, cars, found[name], MIN_REDUCED_CARS)
            scaled = prior.scaled(cars[known])
            columns = _of_the_flip(prior, turn)
            surface = Regression.process(columns, scaled, flip[known, None], known)
            flips[name] = surface
            if turn.table:
                margin = _unseen(prior, turn, flip, surface, tried, whose)
                inputs = _with_margin(prior.scaled(tried), margin)
                columns = _of_a_figure(prior, turn)
                figures[name] = Regression.process(columns, inputs, shown, whose)
        return cls(prior, flips, figures)

    def corrected(self, cars: FloatArray, found: Mapping[str, Mapping[str, Any]]) -> Surrogate:
        """Corrects by `search_full` of all cars (m, n), by name of the turn."""
        prior = self.prior
        shifts = {}
        corrections = {}
        for turn in prior.plan.turns:
            name = turn.name
            known, flip, tried, shown, whose = _search(turn, cars, found[name], MIN_FULL_CARS)
            scaled = prior.scaled(cars[known])
            missed = flip[known, None] - self.flips[name](scaled)
            surface = Regression.line(_of_the_flip(prior, turn), scaled, missed, known)
            shifts[name] = surface
            if turn.table:
                margin = _unseen(prior, turn, flip, surface, tried, whose)
                inputs = _with_margin(prior.scaled(tried), margin)
                missed = shown - self.figures[name](inputs)
                columns = _of_a_figure(prior, turn)
                corrections[name] = Regression.line(columns, inputs, missed, whose)
        return replace(self, shifts=shifts, corrections=corrections)

    def margin(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Returns the logarithm of the friction at the flip over that of the car (m); above 0 it
        survives.
        """
        scaled = self.prior.scaled(cars)
        shift = self.shifts.get(turn.name)
        found = self.flips[turn.name](scaled) + (0.0 if shift is None else shift(scaled))
        margin: FloatArray = found[:, 0] - np.log(
            cars[:, self.prior.column(f"{turn.system} {FRICTION}")]
        )
        return margin

    def flip_deviation(self, turn: Turn) -> float:
        """Returns the standard deviation of the residuals of the margin."""
        return float(self.shifts.get(turn.name, self.flips[turn.name]).deviation[0])

    def survival(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Returns the probability (m) that a car survives a turn, with the width of the plan and
        the residuals of the surrogate.
        """
        width = np.hypot(self.prior.plan.outcome_width[turn.tail], self.flip_deviation(turn))
        found: FloatArray = norm.cdf(self.margin(cars, turn) / width)
        return found

    def draw_outcomes(self, car: FloatArray, rng: np.random.Generator) -> dict[str, bool]:
        """Draws which turns a car (1, n) survives, with the probabilities of `log_outcomes`."""
        plan = self.prior.plan
        missed = {_kind(turn): rng.standard_normal() for turn in plan.turns}
        survives = {}
        for turn in plan.turns:
            margin = self.margin(car, turn)[0] + self.flip_deviation(turn) * missed[_kind(turn)]
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
                missed = self.flip_deviation(turn) * NODES[:, None]
                z = (margins[turn.name] + missed) / self.prior.plan.outcome_width[turn.tail]
                joint = joint + log_ndtr(z if turn.ends == "survived" else -z)
            total = total + np.logaddexp.reduce(joint + WEIGHTS)
        return total

    def values(self, cars: FloatArray, turn: Turn, margin: FloatArray | None = None) -> FloatArray:
        """Returns `METRICS` of cars (m, n) in a turn (m, 6), each in its unit; `margin` (m) where
        it is known already.
        """
        inputs = _with_margin(
            self.prior.scaled(cars), self.margin(cars, turn) if margin is None else margin
        )
        correction = self.corrections.get(turn.name)
        return self.figures[turn.name](inputs) + (0.0 if correction is None else correction(inputs))

    def value(self, cars: FloatArray, figure: Figure) -> FloatArray:
        """Returns a figure of cars (m, n), in its unit (m)."""
        return self.values(cars, figure.turn)[:, METRICS.index(figure.metric)]

    def deviation(self, figure: Figure) -> float:
        """Returns the standard deviation of the residuals of a figure."""
        surface = self.corrections.get(figure.turn.name, self.figures[figure.turn.name])
        return float(surface.deviation[METRICS.index(figure.metric)])


def _kind(turn: Turn) -> tuple[str, str]:
    return turn.system, turn.tail


def _of_the_flip(prior: CarPrior, turn: Turn) -> list[int]:
    columns = prior.inputs(turn.system)[:-1]
    left = {prior.column(name) for name in ("window", *FIELD_NUISANCES) if name != "gyro_bias"}
    return [column for column in columns if column not in left]


def _unseen(
    prior: CarPrior,
    turn: Turn,
    flip: FloatArray,
    surface: Regression,
    tried: FloatArray,
    whose: IntArray,
) -> FloatArray:
    """Returns the margin of cars that were tried (k), as the surrogate predicts it for cars it was
    not fitted to.
    """
    without = flip.copy()
    without[np.isfinite(flip)] -= surface.missed[:, 0]
    margin: FloatArray = without[whose] - np.log(
        tried[:, prior.column(f"{turn.system} {FRICTION}")]
    )
    return margin


def _of_a_figure(prior: CarPrior, turn: Turn) -> list[int]:
    return [*prior.inputs(turn.system), len(prior.names)]


def _with_margin(scaled: FloatArray, margin: FloatArray) -> FloatArray:
    """Joins scaled cars (m, n) and the logarithm of their margin (m): a car leans ever further as
    the margin goes to 0.
    """
    return np.column_stack([scaled, np.log(0.5 * (margin + np.hypot(margin, 2.0 * MIN_MARGIN)))])


def _search(
    turn: Turn, cars: FloatArray, found: Mapping[str, Any], least: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Returns which of the cars flip, the flip of each, cars (k, n) that survived, their figures
    (k, 6), and the index of their car.
    """
    flip = np.array(found["flips"], float)
    known = np.flatnonzero(np.isfinite(flip))
    tried = np.array(found["inputs"]).reshape(-1, cars.shape[1])
    order = np.argsort(cars[:, 0])
    # No two cars share their first number.
    whose = order[np.searchsorted(cars[order, 0], tried[:, 0])]
    own = np.isfinite(flip[whose])
    shown = len(np.unique(whose[own]))
    if min(len(known), shown) < least:
        raise UserError(
            f"{turn.name} m/s: {len(known)} of {len(flip)} cars flip at a friction that was tried, "
            f"{shown} of these have runs that survive; needed are {least} of "
            f"each{''.join(found.get('errors', [])[:1])}"
        )
    return known, flip, tried[own], np.array(found["figures"])[own], whose[own]


def _deviation(missed: FloatArray) -> FloatArray:
    """Returns the size that 68 % of residuals (m, k) do not exceed; a car at a flip's edge may be
    off by any amount.
    """
    found: FloatArray = np.quantile(np.abs(missed), 0.6827, axis=0)
    return found


def _rows_by(cars: IntArray) -> list[IntArray]:
    """Returns the rows of each car."""
    order = np.argsort(cars, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(cars[order])) + 1)
