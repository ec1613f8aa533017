"""The calibration: runs of reduced and full cars through the engine, posteriors of the cars, and
fine runs that test them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import expit, log_expit, log_ndtr, logit

from aerodima.optimisation.calibrate.calibration_plan import (
    DISCREPANCY,
    LIFT,
    MAX_POSTERIOR_SAMPLES,
    ROLL_DISCREPANCY,
    CalibrationPlan,
    CarPrior,
    Figure,
    Turn,
    figures_of,
    lift_of,
)
from aerodima.optimisation.calibrate.surrogate import METRICS, Surrogate, TurnResults
from aerodima.optimisation.calibrate.turn_runs import (
    WorkItem,
    prior_of,
    run_full,
    run_reduced,
    search_full,
)
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.metrics.published_values import Platform

REDUCED_PER_ITEM = 300
"""Number of reduced cars in one item of work."""
FULL_PER_ITEM = 4
"""Number of full cars in one item of work."""
MIDDLE_FRICTION = 0.67
"""Friction in the middle of the first search for a flip."""
WIDE_REACH = 0.8
"""Reach of the first search in the logarithm of the friction."""
NARROW_REACH = 0.4
"""Reach of the second search in the logarithm of the friction."""
FULL_REACH = {"none": 0.05, "held": 0.05, "swing": 0.15}
"""First step, in the logarithm of the friction, of the search for the flip of a full car from that
of the reduced one, by tail mode."""
COARSE_STEPS = (0.001, 0.002)
"""Steps at which the best car must end its turns as at the fine step, s."""
LIFT_WIDTH = 0.1
"""Width of the yaw rate at which the inner wheels lift, rad/s."""
STARTS = 20_000
"""Number of cars of the prior, of which the likeliest start the sampler."""


def fit_surrogate(plan: CalibrationPlan, runs: CachedRunner) -> Surrogate:
    """Runs the reduced cars and the full cars of a plan, and fits the surrogate to them.

    The first wave of reduced cars is spread over the prior. A rough posterior says where the second
    wave is needed, and a posterior from both waves says where the full cars are.
    """
    prior = prior_of(plan)
    figures = figures_of(plan)
    size = plan.size
    seed = plan.seed
    first = prior.spread(size.cars // 2, seed)
    wide = _reduced(plan, runs, first, WIDE_REACH)
    surrogate = Surrogate.from_reduced(prior, first, wide, runs)
    # The rough posterior is wide, so it settles later.
    rough = sample(surrogate, figures, seed, steps=2 * size.steps)
    second = _different(rough.cars, size.cars, seed)
    narrow = _reduced(plan, runs, second, NARROW_REACH)
    both = _joined({turn: [wide[turn], narrow[turn]] for turn in narrow})
    surrogate = Surrogate.from_reduced(prior, np.vstack([first, second]), both, runs)
    full = _different(sample(surrogate, figures, seed).cars, size.full, seed)
    return surrogate.corrected(full, _full_flips(plan, runs, full, surrogate))


def _reduced(
    plan: CalibrationPlan, runs: CachedRunner, cars: FloatArray, reach: float
) -> TurnResults:
    """Runs `run_reduced` for cars (m, n) and returns the results by name of the turn; the flip is
    searched around the friction of each car.

    The wide search is around the middle of the possible friction. In the turns of trends, which two
    trends may share, cars drive once.
    """
    runs.stage = "reduced cars"
    items = []
    for turn in plan.trend_turns.values():
        items += _work_items(plan, turn, cars, REDUCED_PER_ITEM)
    for turn in plan.turns:
        own = cars.copy()
        if reach == WIDE_REACH:
            own[:, prior_of(plan).column(turn.friction)] = MIDDLE_FRICTION
        items += _work_items(plan, turn, own, REDUCED_PER_ITEM, reach)
    return _joined(_by_turn(run_reduced, runs, items))


def _full_flips(
    plan: CalibrationPlan, runs: CachedRunner, cars: FloatArray, surrogate: Surrogate
) -> TurnResults:
    """Runs `search_full` for cars (m, n), around the friction at which they flip by the surrogate,
    and returns the results by name of the turn.
    """
    runs.stage = "full cars"
    items = []
    for turn in plan.turns:
        alone = _work_items(plan, turn, cars, 1, FULL_REACH[turn.tail])
        for item, margin in zip(alone, surrogate.margin(cars, turn).tolist(), strict=True):
            items.append(replace(item, margins=(margin,)))
    return _joined(_by_turn(search_full, runs, items))


def _joined(results: Mapping[str, list[Any]]) -> TurnResults:
    """Joins the results of the items of each turn."""
    joined = {}
    for turn, parts in results.items():
        joined[turn] = {name: [one for part in parts for one in part[name]] for name in parts[0]}
    return joined


def _work_items(
    plan: CalibrationPlan,
    turn: Turn,
    cars: FloatArray,
    size: int,
    reach: float = 0.0,
    step: float | None = None,
) -> list[WorkItem]:
    """Deals cars (m, n) out to items of `size` cars, all of one reach and one step."""
    numbers = tuple(map(tuple, cars.tolist()))
    return [
        WorkItem(plan, turn, numbers[first : first + size], reach, step)
        for first in range(0, len(numbers), size)
    ]


def _different(cars: FloatArray, number: int, seed: int) -> FloatArray:
    """Returns `number` of the drawn cars (m, n), no two of them alike: a sampler that does not move
    repeats a car.
    """
    return np.random.default_rng(seed).permutation(np.unique(cars, axis=0))[:number]


def _by_turn(
    work: Callable[[WorkItem], Any], runs: CachedRunner, items: Sequence[WorkItem]
) -> dict[str, list[Any]]:
    """Runs items, which are handed out together, and returns their results by name of the turn."""
    results: dict[str, list[Any]] = {}
    keys = [item.key(work.__name__) for item in items]
    for item, result in zip(items, runs.map(work, items, keys), strict=True):
        results.setdefault(item.turn.name, []).append(result)
    return results


@dataclass(frozen=True)
class Posterior:
    """Cars that the figures of some tables leave possible.

    Attributes:
        cars: cars drawn with equal weights (m, n).
        size: effective sample size, that of the worst coordinate.
        length: number of steps that were kept, over the longest autocorrelation time.
    """

    cars: FloatArray
    size: float
    length: float


def log_likelihood(surrogate: Surrogate, figures: Sequence[Figure], cars: FloatArray) -> FloatArray:
    """Computes the logarithm of the probability (m) of figures and of all outcomes, given cars (m,
    n).

    The trigger of the thesis' law is the yaw rate up to which the inner wheels stay on the ground:
    a car whose wheel lifts below it is unlikely, with a width of `LIFT_WIDTH`.
    """
    plan = surrogate.prior.plan
    margins = {turn.name: surrogate.margin(cars, turn) for turn in plan.turns}
    metrics = {
        turn.name: surrogate.values(cars, turn, margins[turn.name])
        for turn in plan.turns
        if turn.table
    }
    total = surrogate.log_outcomes(margins) + surrogate.log_trends(cars, metrics)
    for figure in figures:
        shown = metrics[figure.turn.name][:, METRICS.index(figure.metric)]
        total += log_density(surrogate, figure, cars, shown)
    lift = lift_of(plan)
    width = np.hypot(LIFT_WIDTH, surrogate.deviation(lift))
    lifting = metrics[lift.turn.name][:, METRICS.index(LIFT)]
    return total + log_ndtr((lifting - lift.published) / width)


def log_density(
    surrogate: Surrogate, figure: Figure, cars: FloatArray, values: FloatArray | None = None
) -> FloatArray:
    """Computes the logarithm of the density (m) of a published figure given cars (m, n), per share
    of the figure.

    The model is off by a share of its prediction.

    Args:
        values: values of the figure for the cars (m), where they are known already.
    """
    if values is None:
        values = surrogate.value(cars, figure)
    spread = spread_of(surrogate, figure, cars, values)
    off = (figure.published - values) / spread
    normaliser = spread * np.sqrt(2.0 * np.pi) / abs(figure.published)
    return -0.5 * off * off - np.log(normaliser)


def spread_of(
    surrogate: Surrogate, figure: Figure, cars: FloatArray, values: FloatArray
) -> FloatArray:
    """Computes the standard deviation (m) of the published figure around the values (m) that cars
    (m, n) show, in its unit.

    A rate and its integral are off by different shares; the integral of a gyro gathers what the
    rate averages out.
    """
    name = ROLL_DISCREPANCY if figure.metric == "roll_integral_rad" else DISCREPANCY
    return np.hypot(cars[:, surrogate.prior.column(name)] * values, surrogate.deviation(figure))


def sample(
    surrogate: Surrogate,
    figures: Sequence[Figure],
    seed: int,
    prior: CarPrior | None = None,
    steps: int | None = None,
) -> Posterior:
    """Draws from the posterior given some figures and all outcomes, with an ensemble sampler
    (emcee).

    It walks in the logit of each range, so that no step leaves it.

    Args:
        prior: prior in place of that of the surrogate, inside its ranges.
        steps: number of steps in place of that of the plan.
    """
    import emcee

    prior = prior or surrogate.prior
    size = surrogate.prior.plan.size
    steps = steps or size.steps

    low, high = prior.ranges.T

    def cars_at(points: FloatArray) -> FloatArray:
        return low + (high - low) * expit(points)

    def log_posterior(points: FloatArray) -> FloatArray:
        cars = cars_at(points)
        density = prior.log_density(cars)
        density = density + np.sum(log_expit(points) + log_expit(-points), axis=1)
        can_be = np.isfinite(density)
        density[can_be] += log_likelihood(surrogate, figures, cars[can_be])
        return density

    starts = logit(np.clip((prior.spread(STARTS, seed) - low) / (high - low), 1e-6, 1.0 - 1e-6))
    best = np.argsort(log_posterior(starts))[::-1][: size.walkers]
    moves = [
        (emcee.moves.DEMove(), 0.8),
        (emcee.moves.DESnookerMove(), 0.1),
        (emcee.moves.StretchMove(), 0.1),
    ]
    sampler = emcee.EnsembleSampler(
        size.walkers, starts.shape[1], log_posterior, moves=moves, vectorize=True
    )
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(starts[best], steps, skip_initial_state_check=True)
    burn = steps // 3
    chain = cars_at(sampler.get_chain(discard=burn))
    with np.errstate(invalid="ignore"):  # a chain too short to move
        longest = float(np.nanmax(emcee.autocorr.integrated_time(chain, tol=0)))
    flat = chain.reshape(-1, chain.shape[2])
    number = len(flat)
    drawn = np.random.default_rng(seed).choice(
        number, min(MAX_POSTERIOR_SAMPLES, number), replace=False
    )
    return Posterior(flat[drawn], number / longest, len(chain) / longest)


@dataclass(frozen=True)
class FineRuns:
    """Cars of a posterior that were run with the full car.

    Attributes:
        cars: cars that were run (m, n).
        rows: rows of `run_full` (m) at the fine step of the plan, by name of the turn.
        best: index of the car that stands for a system, by system.
    """

    cars: FloatArray
    rows: dict[str, list[Row]]
    best: dict[Platform, int]


def run_fine(plan: CalibrationPlan, posterior: Posterior, runs: CachedRunner) -> FineRuns:
    """Runs cars of a posterior through every turn with the full car at the plan's fine step."""
    cars = _different(posterior.cars, plan.size.ensemble, plan.seed)
    runs.stage = "full cars"
    rows = _full_rows(plan, plan.turns, cars, plan.size.fine_step, runs)
    systems = dict.fromkeys(turn.system for turn in plan.turns)
    best = {system: _best_car(plan, system, cars, rows, runs) for system in systems}
    return FineRuns(cars, rows, best)


def _best_car(
    plan: CalibrationPlan,
    system: Platform,
    cars: FloatArray,
    rows: Mapping[str, Sequence[Row]],
    runs: CachedRunner,
) -> int:
    """Returns the index of the car nearest to the middle of all (m, n), among those that end most
    turns of a system as published, at the fine step (`rows`) and then at `COARSE_STEPS` too.
    """
    turns = [turn for turn in plan.turns if turn.system == system]
    hits = _published_ends(turns, rows)
    leading = np.flatnonzero(hits == hits.max())
    for step in COARSE_STEPS:
        coarse = _full_rows(plan, turns, cars[leading], step, runs)
        hits[leading] += _published_ends(turns, coarse)
    prior = prior_of(plan)
    scaled = prior.scaled(cars)[:, prior.inputs(system)]
    standard = (scaled - scaled.mean(axis=0)) / (scaled.std(axis=0) + 1e-9)
    distances = np.sum(standard**2, axis=1)
    distances[hits < hits.max()] = np.inf
    return int(np.argmin(distances))


def _published_ends(turns: Sequence[Turn], rows: Mapping[str, Sequence[Row]]) -> IntArray:
    """Counts the turns that each car (m) ends as published, by rows of `run_full`."""
    ends = [
        [row.get("survived") == (turn.ends == "survived") for row in rows[turn.name]]
        for turn in turns
    ]
    return np.sum(ends, axis=0)


def _full_rows(
    plan: CalibrationPlan,
    turns: Sequence[Turn],
    cars: FloatArray,
    step: float,
    runs: CachedRunner,
) -> dict[str, list[Row]]:
    """Runs `run_full` for cars (m, n) at a step (s); returns rows (m) by name of the turn."""
    items = []
    for turn in turns:
        items += _work_items(plan, turn, cars, FULL_PER_ITEM, step=step)
    results = _by_turn(run_full, runs, items)
    return {turn: [row for part in parts for row in part] for turn, parts in results.items()}
