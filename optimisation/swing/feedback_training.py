"""Training of the numbers of the feedback law: reduced training cars, the highest speeds that they
enter at.

A law is scored by the speeds at which cars stay upright, over the entry speed of the car without
tail. A car that turns less than `MIN_LATERAL_SHARE` of it counts much less, by the power
`SHORTFALL_EXPONENT`, so that the search is led to laws that turn enough. The score is half the mean
over cars and manoeuvres and half the mean of the worst fifth. Generations of laws follow
differential evolution (Storn and Price 1997, doi 10.1023/A:1008202821328).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from aerodima.optimisation.judge.candidate import NO_TAIL, Candidate
from aerodima.optimisation.judge.entry_rule import MIN_LATERAL_SHARE
from aerodima.optimisation.judge.entry_speed import Case
from aerodima.optimisation.judge.reduced_entries import gains_of, reduced_cars, sweep_speeds
from aerodima.optimisation.judge.suite import FEEDBACK, TRAINING_MANOEUVRES, select_manoeuvres
from aerodima.optimisation.studies.limit_search import unbroken
from aerodima.optimisation.studies.runs import CachedRunner, scenario_content
from aerodima.workbench.batch.row_store import ProgressBar, ProgressLine, content_key
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

RANGES = {
    "feedback.lean_gain": (-8.0, 1.0),
    "feedback.roll_gain": (-20.0, 30.0),
    "feedback.roll_rate_gain": (-1.0, 4.0),
    "feedback.yaw_rate_gain": (-1.0, 1.0),
    "feedback.grip": (2.0, 25.0),
    "feedback.most_roll": (0.8, 1.45),
    "feedback.out_speed": (2.0, 24.0),
    "feedback.return_speed": (0.7, 12.0),
    "feedback.kp": (2.0, 60.0),
    "feedback.kd": (0.3, 5.0),
    "feedback.pitch_angle": (-1.3, 0.6),
}
"""Numbers that are free, in the units of `FeedbackParameters`."""
RATIOS = np.concatenate([np.arange(0.72, 1.2, 0.06), np.arange(1.2, 3.2, 0.12)])
"""Speeds of the sweep of a law, over the entry speed of the car without tail."""
SPEEDS_WITHOUT = np.arange(1.3, 6.05, 0.1)
"""Speeds of the sweep of a car without tail, m/s; on a car that reaches the last one a tail can
gain nothing."""
LAWS_PER_ITEM = 22
"""Laws in one item of work."""
SHORTFALL_EXPONENT = 12
"""Power of what is turned over what must be; with 3 the search found laws that stay upright and
turn too little."""
LATERAL_MARGIN = 1.02
"""What must be turned here over what must be turned by the full car, whose lateral acceleration is
5 % smaller to 2 % larger (law of `models/parameters/feedback.yaml`, three training cars, turn, held
turn and fishhook at 3.2 and 6 m/s)."""
WORST_SHARE = 0.2
"""Share of cases that the second half of the score is made of."""
MIN_LATERAL = 1.0
"""Lateral acceleration of a car that is upright at no speed without a tail, m/s2."""
Law = Mapping[str, float]
"""Numbers of a law by the keys of `RANGES`."""


@dataclass(frozen=True)
class LawSearch:
    """Effort of a search.

    Attributes:
        laws: of a generation, for each free number.
        generations: beside the first one.
        seed: of the first generation and of all later draws.
        around: share of the ranges, around the law that it starts from, over which the first
            generation is drawn.

    Raises:
        UserError: fewer than 3 laws, or a share out of range.
    """

    laws: int = 4
    generations: int = 8
    seed: int = 1
    around: float = 0.3

    def __post_init__(self) -> None:
        check_range("laws for each number", self.laws, 3, math.inf, NO_UNIT, error=SweepError)
        check_range("around", self.around, 0.0, 1.0, NO_UNIT, above_low=True, error=SweepError)


@dataclass(frozen=True)
class LawBatch:
    """Laws on cars in a manoeuvre: small enough to send to a worker.

    Attributes:
        manoeuvre: name of the suite; `tail` of `suite.TAILS`.
        cars: settings of each car.
        laws: that are scored.
    """

    manoeuvre: str
    tail: str
    cars: tuple[tuple[str, ...], ...]
    laws: tuple[Law, ...]

    def key(self) -> str:
        """Returns the key of its cached result."""
        (manoeuvre,) = select_manoeuvres([self.manoeuvre], self.tail)
        content = scenario_content(manoeuvre.scenario, manoeuvre.settings)
        return content_key("screened entries", vars(self), *content, manoeuvre.drivers)


def train_feedback(
    cases: Sequence[Case], tail: str, search: LawSearch, runs: CachedRunner
) -> Candidate:
    """Searches the law with the best score on training cars (`TRAINING_MANOEUVRES`).

    Args:
        cases: training cars with their surfaces.
        tail: of `suite.TAILS`.
        search: how much.
        runs: where the runs are made.

    Raises:
        UserError: no law keeps a car upright.
    """
    runs.stage = "feedback law"
    cars = tuple((*car.settings_on("entry_turn"), *surface.settings) for car, surface in cases)
    number = len(TRAINING_MANOEUVRES)

    def score_laws(laws: Sequence[Law]) -> FloatArray:
        batches = []
        for first in range(0, len(laws), LAWS_PER_ITEM):
            part = tuple(laws[first : first + LAWS_PER_ITEM])
            batches += [LawBatch(name, tail, cars, part) for name in TRAINING_MANOEUVRES]
        ratios = runs.map(score_law_batch, batches, [batch.key() for batch in batches])
        by_manoeuvre = [np.concatenate(ratios[index::number]) for index in range(number)]
        return score(np.concatenate(by_manoeuvre, axis=1))

    (first, *_) = select_manoeuvres(TRAINING_MANOEUVRES, tail)
    shipped = load_scenario(first.scenario).feedback
    start = {name: float(getattr(shipped, name.split(".")[1])) for name in RANGES}
    best = search_laws(search, start, score_laws, runs.say)
    numbers = [f"{name}={value!r}" for name, value in best.items()]
    return Candidate(f"trained {FEEDBACK.name}", (*FEEDBACK.settings, *numbers))


def search_laws(
    search: LawSearch,
    start: Law,
    score_laws: Callable[[Sequence[Law]], FloatArray],
    progress: ProgressLine,
) -> Law:
    """Searches the law of the largest score.

    Args:
        search: how much.
        start: a law that the first generation has, beside those that are drawn.
        score_laws: returns the scores (n,) of laws.
        progress: receives a line for each generation.

    Raises:
        UserError: no score is above 0.
    """
    best = start
    best_score = 0.0
    tried = 0
    bar = ProgressBar(progress, search.generations + 1)

    def cost(shares: FloatArray) -> FloatArray:
        nonlocal best, best_score, tried
        laws = laws_at(shares.T)
        scores = score_laws(laws)
        index = int(np.argmax(scores))
        if scores[index] > best_score:
            best = laws[index]
            best_score = float(scores[index])
        tried += len(laws)
        bar.advance(f"{tried} laws tried on reduced cars, the best {best_score - 1.0:+.1%}")
        return -scores

    numbers = len(RANGES)
    centre = shares_of(start)
    drawn = qmc.LatinHypercube(numbers, rng=search.seed).random(search.laws * numbers)
    first = np.clip(centre + search.around * (drawn - centre), 0.0, 1.0)
    first[0] = centre
    evolve(cost, first, search.generations, search.seed)
    if best_score <= 0.0:
        raise SweepError("no law that was tried keeps a training car upright at any speed")
    return best


def evolve(
    cost: Callable[[FloatArray], FloatArray], first: FloatArray, generations: int, seed: int
) -> None:
    """Minimises a cost of shares between 0 and 1 by differential evolution.

    Args:
        cost: of members (numbers, members).
        first: generation (members, numbers).
        generations: beside the first one.
        seed: of all draws.
    """
    differential_evolution(
        cost,
        [(0.0, 1.0)] * first.shape[1],
        init=first,
        maxiter=generations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=seed,
    )


def laws_at(shares: FloatArray) -> list[Law]:
    """Returns the laws at shares (n, numbers) of the `RANGES`, to four digits."""
    low, high = np.array(list(RANGES.values())).T
    laws: list[Law] = []
    for row in low + shares * (high - low):
        numbers = [float(f"{value:.4g}") for value in row]
        laws.append(dict(zip(RANGES, numbers, strict=True)))
    return laws


def shares_of(law: Law) -> FloatArray:
    """Returns the position of a law in the `RANGES` (numbers,), clipped to their ends."""
    shares = [(law[name] - low) / (high - low) for name, (low, high) in RANGES.items()]
    return np.clip(shares, 0.0, 1.0)


def score(ratios: FloatArray) -> FloatArray:
    """Returns the scores of laws (laws,) from their speeds divided by those without a tail (laws,
    cases).
    """
    number = max(1, round(WORST_SHARE * ratios.shape[1]))
    worst = np.sort(ratios, axis=1)[:, :number]
    return np.asarray(0.5 * (ratios.mean(axis=1) + worst.mean(axis=1)))


def score_law_batch(batch: LawBatch) -> list[list[float]]:
    """Returns the speed that each law is worth over the entry speed without tail (laws, cars).

    Raises:
        UserError: what the reduced car does not know.
    """
    reference = _reference(batch.manoeuvre, batch.tail, batch.cars)
    number = len(batch.laws)
    count = reference.cars.count
    which = np.tile(np.arange(count), number)
    laws = [law for law in batch.laws for _ in range(count)]
    gains = gains_of(laws, reference.drivers[0])
    without = reference.speeds[which]
    speeds = RATIOS[:, None] * without
    cars = reference.cars.take(which)
    completed, lateral = sweep_speeds(cars, speeds, reference.drivers, gains, np.ones(len(which)))
    enough = LATERAL_MARGIN * reference.min_lateral[which]
    turned = np.minimum(1.0, np.maximum(lateral, 0.0) / enough) ** SHORTFALL_EXPONENT
    worth = np.where(unbroken(completed), RATIOS[:, None] * turned, 0.0)
    best = np.max(worth, axis=0)
    best = np.where(without >= SPEEDS_WITHOUT[-1], np.minimum(best, 1.0), best)
    ratios: list[list[float]] = best.reshape(number, count).tolist()
    return ratios


class _Reference(NamedTuple):
    """A manoeuvre with its drivers, its cars (n) with the tail, and what the cars without tail
    reach: entry speeds (n), m/s, and the lateral accelerations (n) that are enough, m/s2.
    """

    drivers: list[Scenario]
    cars: VehicleParams
    speeds: FloatArray
    min_lateral: FloatArray


@lru_cache(maxsize=16)
def _reference(manoeuvre: str, tail: str, cars: tuple[tuple[str, ...], ...]) -> _Reference:
    (chosen,) = select_manoeuvres([manoeuvre], tail)
    settings = (*chosen.settings, *FEEDBACK.settings)
    drivers = [load_scenario(chosen.scenario, (*settings, *driver)) for driver in chosen.drivers]
    bare = reduced_cars(chosen, cars, NO_TAIL)
    count = bare.count
    speeds = np.outer(SPEEDS_WITHOUT, np.ones(count))
    gains = gains_of([{}] * count, drivers[0])
    completed, lateral = sweep_speeds(bare, speeds, drivers, gains, np.zeros(count))
    held = unbroken(completed)
    last = np.maximum(np.sum(held, axis=0) - 1, 0)
    share = 1e-9 if chosen.rule == "path" else MIN_LATERAL_SHARE
    most = np.max(np.where(held, lateral, 0.0), axis=0, initial=MIN_LATERAL)
    with_tail = reduced_cars(chosen, cars, FEEDBACK)
    return _Reference(drivers, with_tail, SPEEDS_WITHOUT[last], share * most)
