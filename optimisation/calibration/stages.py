"""One stage of a calibration: critical groups of a design, surrogates, members drawn by them, weights by real runs.

A stage holds cars to a bracket (survives one speed, flips in the turn at another) and, the first stage, to a row of
published metrics. For every car of a design the group at which it flips is searched by bisection at both speeds; the
surrogates of that, and of the metrics of the runs that survived, then say where the targets are met. Members are drawn
from a large pool with probability

    q ~ prior x surrogate likelihood of the metrics x (surrogate probability of the bracket + a floor),

run, and weighted with the real likelihood over the surrogate one, zero outside the bracket: importance sampling, so
that an error of the surrogates costs effective samples but does not bias the weights. Where the surrogates find next to
no car in the bracket, the stage is held to the survived speed alone, and `StageResult.target` says so.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from optimisation.calibration.plan import CALIBRATED_METRICS, Discrepancy, StageSize
from optimisation.calibration.prior import Prior, Window
from optimisation.calibration.runs import RunStore, Wanted, car_values, flips_in_the_turn, survives
from optimisation.calibration.surrogate import FlipSurrogate, Surrogate, fit
from optimisation.calibration.weights import effective_size, log_likelihood, normalised, systematic_sample
from optimisation.sweep.engine import Engine
from workbench.errors import UserError
from workbench.published import FlipBracket, PublishedFigures

FloatArray = NDArray[np.float64]

POOL = 2**15
"""Candidates of the prior that surrogates choose from."""
FLOOR = 0.02
"""Added to the surrogate probability of the bracket: what the surrogate excludes is still drawn now and then."""
RARE = 0.01
"""A bracket that holds less than this share of the pool is met by no plausible car to speak of."""
LEAST_RUNS = 8
"""Runs that a surrogate of the metrics needs."""

Say = Callable[[str], None]
Draw = Callable[[int, int, Window | None], tuple[FloatArray, FloatArray]]
"""(number, seed, window of the group) -> coordinates (m, n) and log weights (m) of candidates."""


@dataclass(frozen=True)
class Target:
    """What cars are held to.

    Attributes:
        tail_mode: of the runs.
        bracket: survived and flipped speed, m/s.
        published: metrics of the run at the survived speed; None if only the bracket counts.
        discrepancy: of the metrics.
        must_flip: whether the car must flip at the second speed; without it the first alone counts.
    """

    tail_mode: str
    bracket: FlipBracket
    published: PublishedFigures | None
    discrepancy: dict[str, Discrepancy]
    must_flip: bool = True

    @property
    def speeds(self) -> tuple[float, float]:
        """Survived, flipped, m/s."""
        return self.bracket.survived, self.bracket.flipped


@dataclass(frozen=True)
class Design:
    """Critical groups of some cars.

    Attributes:
        coordinates: of the cars (m, n); the one of the group is that of the first run.
        slow, fast: critical coordinate of the group at the two speeds (m); the upper end where the car never flipped.
        resolution: of the searches.
        upright: coordinates of the runs that survived the slow speed (k, n).
        rows: of these runs.
        cars: number of the car of each of these runs (k).
    """

    coordinates: FloatArray
    slow: FloatArray
    fast: FloatArray
    resolution: float
    upright: FloatArray
    rows: pd.DataFrame
    cars: NDArray[np.int64]


@dataclass(frozen=True)
class Evaluated:
    """Cars that were run at the speeds of a target.

    Attributes:
        coordinates: (m, n).
        slow, fast: rows of the runs at the survived and at the flipped speed; the same where one speed counts only.
    """

    coordinates: FloatArray
    slow: pd.DataFrame
    fast: pd.DataFrame

    def meets(self, target: Target) -> NDArray[np.bool_]:
        """Which cars do what the target asks for (m)."""
        upright = survives(self.slow)
        return upright & flips_in_the_turn(self.fast) if target.must_flip else upright


@dataclass(frozen=True)
class StageResult:
    """Outcome of a stage.

    Attributes:
        target: that the members were held to in the end.
        prior: its keys name the columns.
        design: critical groups.
        flip: surrogate of the flip.
        metrics: surrogates of the metrics at the survived speed.
        members: the cars that were drawn for weights.
        weights: of them (m), summing to 1.
        pool: candidates (k, n) that they were drawn from.
        pool_prior, pool_posterior: weights (k) of the candidates before and after the targets, by the surrogates.
        bracket_share: share of the pool that the surrogates put into the bracket.
    """

    target: Target
    prior: Prior
    design: Design
    flip: FlipSurrogate
    metrics: dict[str, Surrogate]
    members: Evaluated
    weights: FloatArray
    pool: FloatArray
    pool_prior: FloatArray
    pool_posterior: FloatArray
    bracket_share: float

    @property
    def effective_size(self) -> float:
        """Effective sample size of the weights."""
        return effective_size(self.weights)


def run_stage(
    target: Target, prior: Prior, size: StageSize, seed: int, draw: Draw, store: RunStore, engine: Engine, say: Say
) -> StageResult:
    """Designs, runs, draws and weighs the cars of one stage.

    Raises:
        UserError: no member meets the target.
    """
    first, _ = draw(16 * size.points, seed, None)
    design = critical_groups(target, prior, first[: size.points], size, store, engine, say)
    flip, metrics = _surrogates(design, target, prior)
    pool, log_prior = draw(POOL, seed + 1, flip.window)
    share = float(normalised(log_prior) @ flip.bracket(pool))
    if target.must_flip and share < RARE and target.published is None:
        say(f"{share:.1%} of the plausible cars would flip at {target.speeds[1]:g} m/s after {target.speeds[0]:g} m/s")
        target = replace(target, must_flip=False)
    expected = _surrogate_log_likelihood(pool, flip, metrics, target)
    probability = normalised(log_prior + expected)
    chosen, drawn = np.unique(systematic_sample(probability, size.members, seed), return_counts=True)
    members = run_cars(pool[chosen], prior, target, store, engine, None, lambda line: say(f"members: {line}"))
    weights = normalised(np.log(drawn) + real_log_likelihood(members, target) - expected[chosen])
    if not np.any(weights):
        raise UserError(f"none of {len(chosen)} cars meets its target with tail {target.tail_mode!r}")
    return StageResult(
        target, prior, design, flip, metrics, members, weights, pool, normalised(log_prior), probability, share
    )


def critical_groups(
    target: Target, prior: Prior, cars: FloatArray, size: StageSize, store: RunStore, engine: Engine, say: Say
) -> Design:
    """Searches the coordinate of the group at which each car (m, n) flips, by bisection, at both speeds."""
    upright: list[FloatArray] = []
    rows: list[pd.DataFrame] = []
    numbers: list[NDArray[np.int64]] = []
    found = []
    for speed in target.speeds:
        low, high = np.zeros(len(cars)), np.ones(len(cars))
        for halving in range(size.halvings):
            trial = cars.copy()
            trial[:, prior.leading] = 0.5 * (low + high)
            values = car_values(prior.keys, prior.values(trial))
            done = store.run([Wanted(car, target.tail_mode, speed, size.step) for car in values], engine)
            flipped = flips_in_the_turn(done)
            low, high = (
                np.where(flipped, low, trial[:, prior.leading]),
                np.where(flipped, trial[:, prior.leading], high),
            )
            say(f"flip at {speed:g} m/s: halving {halving + 1} of {size.halvings}")
            if speed == target.speeds[0] and np.any(survives(done)):
                upright.append(trial[survives(done)])
                rows.append(done[survives(done)])
                numbers.append(np.flatnonzero(survives(done)))
        found.append(0.5 * (low + high))
    kept = np.vstack(upright) if upright else np.empty((0, cars.shape[1]))
    table = pd.concat(rows, ignore_index=True) if rows else pd.DataFrame()
    whose = np.concatenate(numbers) if numbers else np.empty(0, np.int64)
    return Design(cars, found[0], found[1], 0.5**size.halvings, kept, table, whose)


def run_cars(
    coordinates: FloatArray,
    prior: Prior,
    target: Target,
    store: RunStore,
    engine: Engine,
    step: float | None,
    say: Say,
) -> Evaluated:
    """Runs cars (m, n) at the speeds of a target; the second only where the target asks for it."""
    cars = car_values(prior.keys, prior.values(coordinates))
    speeds = target.speeds if target.must_flip else target.speeds[:1]
    wanted = [Wanted(car, target.tail_mode, speed, step) for speed in speeds for car in cars]
    rows = store.run(wanted, engine, lambda done, of: say(f"tail {target.tail_mode}, {done} of {of} runs"))
    slow, fast = rows[: len(cars)], rows[-len(cars) :]
    return Evaluated(coordinates, slow.reset_index(drop=True), fast.reset_index(drop=True))


def real_log_likelihood(runs: Evaluated, target: Target) -> FloatArray:
    """Log likelihood (m) of the target from the runs themselves, up to a constant; -inf where it is not met."""
    metrics: FloatArray = np.zeros(len(runs.coordinates))
    if target.published is not None:
        columns = {name: runs.slow[name].to_numpy(float) for name in CALIBRATED_METRICS}
        metrics = log_likelihood(columns, target.published, target.discrepancy)
    return np.where(runs.meets(target), metrics, -np.inf)


def _surrogates(design: Design, target: Target, prior: Prior) -> tuple[FlipSurrogate, dict[str, Surrogate]]:
    others = np.delete(design.coordinates, prior.leading, axis=1)
    flip = FlipSurrogate(
        prior.leading, target.speeds, fit(others, design.slow), fit(others, design.fast), design.resolution
    )
    if target.published is None or len(design.rows) < LEAST_RUNS:
        return flip, {}
    columns = {name: design.rows[name].to_numpy(float) for name in CALIBRATED_METRICS}
    return flip, {
        name: fit(design.upright, values, design.cars, prior.leading_of_metrics) for name, values in columns.items()
    }


def _surrogate_log_likelihood(
    coordinates: FloatArray, flip: FlipSurrogate, metrics: dict[str, Surrogate], target: Target
) -> FloatArray:
    expected = flip.bracket(coordinates) if target.must_flip else flip.survival(coordinates)
    log_bracket: FloatArray = np.log(expected + FLOOR)
    if target.published is None or not metrics:
        return log_bracket
    predicted = {name: surrogate.predict(coordinates) for name, surrogate in metrics.items()}
    return log_bracket + log_likelihood(predicted, target.published, target.discrepancy)
