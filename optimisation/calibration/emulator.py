"""Figures and flips of any car of the prior in a millisecond: networks of reduced cars, corrected by full ones."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm

from aerodima.optimisation.calibration.two_systems import FIGURES, LIFT, OF_THE_FIELD, CarPrior, Figure, Turn
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import UserError

METRICS = (*FIGURES, LIFT)
NEURONS, DECAY = (40, 40), 0.01
"""Of the networks; a quadratic of the same runs misses a fifth more, and far from them it predicts anything."""
HELD_BACK = 0.15
"""Share of the runs that a network is not fitted to, and that says what it misses."""
LEAST, LEAST_FULL = 8, 3
"""Runs that a network, and survivors that a correction needs."""
RIDGES = np.logspace(0.0, 4.0, 9)
"""Ridges of a correction that are tried, by leaving one run out."""


@dataclass(frozen=True)
class Surface:
    """A regression over some columns of scaled cars.

    Attributes:
        columns: of the cars.
        model: scaled columns (m, c) -> values (m, k).
        deviation: of what it misses in runs that it was not fitted to (k), in the unit of its values.
    """

    columns: tuple[int, ...]
    model: Callable[[FloatArray], FloatArray]
    deviation: FloatArray

    @classmethod
    def network(cls, columns: list[int], scaled: FloatArray, values: FloatArray) -> Surface:
        """Fitted to values (m, k) at scaled cars (m, n)."""
        from sklearn.neural_network import MLPRegressor

        middle, spread = values.mean(axis=0), values.std(axis=0) + 1e-9
        held = np.random.default_rng(len(values)).random(len(values)) < HELD_BACK
        chosen, target = scaled[:, columns], (values - middle) / spread
        net = MLPRegressor(
            hidden_layer_sizes=NEURONS, activation="tanh", solver="lbfgs", alpha=DECAY, max_iter=400, random_state=0
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the limit of the iterations is meant: it keeps the network smooth
            net.fit(chosen[~held], target[~held])

        def model(inputs: FloatArray) -> FloatArray:
            # As `net.predict`, without its checks, which take most of the time of a posterior.
            layer = inputs
            for weights, offsets in zip(net.coefs_[:-1], net.intercepts_[:-1], strict=True):
                layer = np.tanh(layer @ weights + offsets)
            return middle + spread * (layer @ net.coefs_[-1] + net.intercepts_[-1])

        return cls(tuple(columns), model, np.std(values[held] - model(chosen[held]), axis=0))

    @classmethod
    def line(cls, columns: list[int], scaled: FloatArray, values: FloatArray) -> Surface:
        """Fitted to values (m, k) at scaled cars (m, n) with a ridge, for few runs."""
        from sklearn.linear_model import RidgeCV
        from sklearn.model_selection import cross_val_predict

        ridge, chosen = RidgeCV(alphas=RIDGES), scaled[:, columns]
        missed = values - cross_val_predict(ridge, chosen, values, cv=min(8, len(values)))
        ridge.fit(chosen, values)
        deviation = np.sqrt(np.mean(missed**2, axis=0))
        return cls(tuple(columns), lambda inputs: inputs @ ridge.coef_.T + ridge.intercept_, deviation)

    def __call__(self, scaled: FloatArray) -> FloatArray:
        """Values (m, k) at scaled cars (m, n)."""
        return self.model(scaled[:, self.columns])


@dataclass(frozen=True)
class Emulator:
    """What every turn of a plan shows, for any car.

    Attributes:
        prior: whose coordinates the cars have.
        flips: name of the turn -> logarithm of the friction at the flip.
        figures: name of the turn -> `METRICS`.
        shift: name of the turn -> correction of the logarithm of the friction at the flip, and its deviation.
        corrections: name of the turn -> `METRICS` of full less reduced cars; its deviation is that of the emulator.
    """

    prior: CarPrior
    flips: dict[str, Surface]
    figures: dict[str, Surface]
    shift: dict[str, tuple[float, float]] = field(default_factory=dict)
    corrections: dict[str, Surface] = field(default_factory=dict)

    @classmethod
    def of_reduced(cls, prior: CarPrior, cars: FloatArray, found: Mapping[str, Mapping[str, Any]]) -> Emulator:
        """From `run_reduced` of all cars (m, n), by name of the turn."""
        flips, figures, scaled = {}, {}, prior.scaled(cars)
        for turn in prior.plan.turns:
            rows, flip = found[turn.name], np.array(found[turn.name]["flips"], float)
            known = np.isfinite(flip)
            if np.count_nonzero(known) < LEAST or len(rows["figures"]) < LEAST:
                raise UserError(
                    f"{turn.name} m/s: {np.count_nonzero(known)} of {len(flip)} reduced cars flip at a friction that "
                    f"was tried, {len(rows['figures'])} runs survive; needed are {LEAST} of each"
                )
            flips[turn.name] = Surface.network(_of_the_flip(prior, turn), scaled[known], flip[known, None])
            if turn.table:
                inputs, values = prior.scaled(np.array(rows["inputs"])), np.array(rows["figures"])
                figures[turn.name] = Surface.network(prior.inputs(turn.system), inputs, values)
        return cls(prior, flips, figures)

    def corrected(self, cars: Mapping[str, FloatArray], found: Mapping[str, list[dict[str, Any]]]) -> Emulator:
        """By runs of the full car: cars (m, n) and rows of `run_full` (m), by name of the turn."""
        shift, corrections = {}, {}
        for turn in self.prior.plan.turns:
            good = [place for place, row in enumerate(found[turn.name]) if "error" not in row]
            rows, tried = [found[turn.name][place] for place in good], cars[turn.name][good]
            survived = np.array([row["survived"] for row in rows], bool)
            if turn.table and (upright := np.count_nonzero(survived)) < LEAST_FULL:
                raise UserError(
                    f"{turn.name} m/s: {upright} of {len(found[turn.name])} full cars survive, {len(rows)} could be "
                    f"run; needed are {LEAST_FULL} survivors"
                )
            shift[turn.name] = _shift(self.margin(tried, turn), survived)
            if turn.table:
                scaled = self.prior.scaled(tried[survived])
                shown = np.array([[row[metric] for metric in METRICS] for row in rows if row["survived"]])
                missed = shown - self.figures[turn.name](scaled)
                corrections[turn.name] = Surface.line(self.prior.inputs(turn.system), scaled, missed)
        return replace(self, shift=shift, corrections=corrections)

    def margin(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Logarithm of the friction at the flip over that of the car (m); above 0 it survives."""
        friction = cars[:, self.prior.column(f"{turn.system} {self.prior.plan.each[0]}")]
        found: FloatArray = self.flips[turn.name](self.prior.scaled(cars))[:, 0] - np.log(friction)
        return found + self.shift.get(turn.name, (0.0, 0.0))[0]

    def survival(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """Probability (m) that a car survives a turn, with the width of the plan and what the emulator misses."""
        width = np.hypot(self.prior.plan.outcome_width, self.shift.get(turn.name, (0.0, 0.0))[1])
        found: FloatArray = norm.cdf(self.margin(cars, turn) / width)
        return found

    def values(self, cars: FloatArray, turn: Turn) -> FloatArray:
        """`METRICS` of cars (m, n) in a turn (m, 6), each in its unit."""
        scaled, correction = self.prior.scaled(cars), self.corrections.get(turn.name)
        return self.figures[turn.name](scaled) + (0.0 if correction is None else correction(scaled))

    def value(self, cars: FloatArray, figure: Figure) -> FloatArray:
        """A figure of cars (m, n), in its unit (m)."""
        return self.values(cars, figure.turn)[:, METRICS.index(figure.metric)]

    def deviation(self, figure: Figure) -> float:
        """What the emulator misses of a figure, one standard deviation."""
        surface = self.corrections.get(figure.turn.name, self.figures[figure.turn.name])
        return float(surface.deviation[METRICS.index(figure.metric)])


def _of_the_flip(prior: CarPrior, turn: Turn) -> list[int]:
    columns = prior.inputs(turn.system)[:-1]
    left = {prior.column(name) for name in ("window", *OF_THE_FIELD) if name != "gyro_bias"}
    return [column for column in columns if column not in left]


def _shift(margins: FloatArray, survived: FloatArray) -> tuple[float, float]:
    """Shift and deviation of margins (m) that make outcomes (m) likeliest; weakly held to 0 and 0.03."""

    def cost(guess: FloatArray) -> float:
        z = (margins + guess[0]) / np.exp(guess[1])
        misfit = -np.sum(norm.logcdf(np.where(survived, z, -z)))
        return float(misfit + 0.5 * (guess[0] / 0.1) ** 2 + 0.5 * ((guess[1] - np.log(0.03)) / 0.7) ** 2)

    best = minimize(cost, [0.0, np.log(0.03)], method="Nelder-Mead").x
    return float(best[0]), float(np.exp(best[1]))
