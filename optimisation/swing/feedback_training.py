"""Training of the numbers of the feedback law on reduced training cars in swerves.

A law is scored by aims, such as how far the last point of the outline has moved aside after 0.5 s,
with the best of some steerings, over that of the same car without tail and with its own best
steering: half the mean over cars, floors, speeds and aims, half the mean of the worst fifth.
NHTSA's fishhook and J-turn also count, as one place per car and speed of the standard, where a law
is worth `PASSED` if it keeps the car upright in both. Each place has a condition: how late the IMU
is, what the car carries, how strong its motors are.

Law and steerings are searched in turn, since a law that kicks the car needs another steering than a
car without tail.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swerve.aims import FAILED, find_aim
from aerodima.optimisation.swerve.aims import score as score_swerves
from aerodima.optimisation.swerve.candidate import NO_TAIL, SWERVE, Candidate
from aerodima.optimisation.swerve.reduced_swerves import (
    ReducedSwerve,
    SteeringItem,
    best_steering,
)
from aerodima.optimisation.swerve.standard_manoeuvres import MANOEUVRES, SPEEDS, standard_angle
from aerodima.optimisation.swerve.steering import (
    CONSTANT_ENDS,
    TICK,
    SearchEffort,
    possible_steering,
)
from aerodima.optimisation.swerve.suite import FEEDBACK, SUITE, Case
from aerodima.workbench.batch.row_store import ProgressBar, ProgressLine
from aerodima.workbench.car.reduced.swerves import LEVELS
from aerodima.workbench.car.swerve import Swerve
from aerodima.workbench.core.array_types import FloatArray, NamedArrays, Pair
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.extras import require
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.scenario.scenario import load_scenario

Ranges = Mapping[str, Pair]
"""Lowest and highest value of each free number, by its key."""
RANGES: Ranges = {name: (low, high) for name, (low, high, _) in SUITE.trained.items()}
"""Ranges of the free numbers of the law, in the units of `FeedbackParameters`."""
START = {name: start for name, (_, _, start) in SUITE.trained.items()}
"""Law that the search starts from."""
ANGLE_SHARES = np.geomspace(0.4, 2.5, 10)
"""Factors on a steering's angles with which a law is tried."""
WORST_SHARE = 0.2
"""Share of the places, the worst ones, that make up the second half of the score."""
PASSED = 1.25
"""Worth of a law that keeps a car upright in both manoeuvres of the standard: about its worth in a
swerve. A law that does so in one of the two is worth half of it."""
FISHHOOK = load_scenario(MANOEUVRES["fishhook"].scenario)
"""Scenario of the fishhook, with the roll rate that its driver waits for."""
Law = Mapping[str, float]
"""Numbers of a law by their keys."""


@dataclass(frozen=True)
class LawSearch:
    """Budget of a search of a law.

    Attributes:
        laws: number of laws in a generation.
        generations: number of generations in a round.
        seed: seed of the first round; later rounds use the seeds that follow it.
        around: standard deviation of the first generation around the law that it starts from, as a
            share of the ranges.
        rounds: number of searches, each with the best steerings of the law before.

    Raises:
        UserError: fewer than 4 laws, no round, or a share out of range.
    """

    laws: int = 16
    generations: int = 60
    seed: int = 1
    around: float = 0.1
    rounds: int = 3

    def __post_init__(self) -> None:
        check_range("laws", self.laws, 4, math.inf, NO_UNIT, error=SweepError)
        check_range("rounds", self.rounds, 1, math.inf, NO_UNIT, error=SweepError)
        check_range("around", self.around, 0.0, 1.0, NO_UNIT, above_low=True, error=SweepError)


class Place(NamedTuple):
    """A car at its speed on its floor with the feedback law.

    Attributes:
        settings: settings of the car, its floor, speed and law.
        aim: name of the aim by which laws are scored.
        steerings: steerings with which laws are tried.
        reference: largest aim of the same car without tail, m; None in the manoeuvres of the
            standard, where the steerings are those of a fishhook before the counter-steer and of a
            J-turn.
    """

    settings: Settings
    aim: str
    steerings: tuple[tuple[float, ...], ...]
    reference: float | None


class LawBatch(NamedTuple):
    """Laws to try on a car, small enough to send to a worker."""

    place: Place
    laws: tuple[Law, ...]


def train_feedback(
    cases: Sequence[Case],
    speeds: Sequence[float],
    aims: Sequence[str],
    search: LawSearch,
    runs: CachedRunner,
    effort: SearchEffort | None = None,
) -> Candidate:
    """Searches the law with the best score on training cars.

    Args:
        cases: training cars with their tail and floor.
        speeds: speeds of the swerves, m/s.
        aims: names of the aims by which laws are scored.
        search: budget of the search of the law.
        runs: runner of the searches and swerves.
        effort: budget of each search of a steering; by default `SearchEffort()`.

    Raises:
        UserError: no law keeps a car upright.
    """
    effort = effort or SearchEffort()
    places = find_places(cases, speeds, aims, runs, effort)
    standard = standard_places(cases, aims[0])
    best: Law = START
    for number in range(search.rounds):
        tried = [*add_steerings(places, best, runs, effort), *standard]
        runs.stage = "feedback law"

        def score_laws(laws: Sequence[Law], places: Sequence[Place] = tried) -> FloatArray:
            batches = [LawBatch(place, tuple(laws)) for place in places]
            return score(np.transpose(runs.map(score_law_batch, batches)))

        best = search_laws(replace(search, seed=search.seed + number), best, score_laws, runs.say)
    return Candidate(f"trained {FEEDBACK.name}", (*FEEDBACK.settings, *law_settings(best)))


def law_settings(law: Law) -> Settings:
    """Returns the settings of a law."""
    return tuple(f"{name}={value!r}" for name, value in law.items())


def find_places(
    cases: Sequence[Case],
    speeds: Sequence[float],
    aims: Sequence[str],
    runs: CachedRunner,
    effort: SearchEffort,
) -> list[Place]:
    """Returns the places of cases, speeds and aims, each in one of the suite's conditions.

    Laws are tried there with the best steering of the car without tail, its angles times
    `ANGLE_SHARES`. Places where that car has no swerve that counts are left out.
    """
    runs.stage = "steerings"
    driven: list[Settings] = []
    for case in cases:
        for speed in speeds:
            condition = condition_settings(case, len(driven))
            driven.append((*case.settings(), *condition, f"manoeuvre.speed={speed!r}"))
    wanted = list(product(aims, driven))
    items = [SteeringItem(((*one, *NO_TAIL.settings),), aim, effort) for aim, one in wanted]
    places = []
    for (aim, one), bare in zip(wanted, runs.map(best_steering, items), strict=True):
        if bare["score"] > 0.0:
            settings = (*one, *FEEDBACK.settings)
            places.append(Place(settings, aim, shared(bare["steering"]), bare["score"]))
    if not places:
        raise SweepError("no training car stays upright without a tail")
    return places


def standard_places(cases: Sequence[Case], aim: str) -> list[Place]:
    """Returns the places of NHTSA's fishhook and J-turn on the cars' own friction, at the speeds of
    the standard. The aim, which has a value where a swerve counts, tells who is upright.
    """
    places: list[Place] = []
    own = {case.car.name: replace(case, floor=1.0) for case in cases}
    for case in own.values():
        car = load_scenario(SWERVE, case.settings())
        angles = [standard_angle(car, one.factor) for one in MANOEUVRES.values()]
        steerings = tuple((angle, angle, angle, *CONSTANT_ENDS) for angle in angles)
        for speed in SPEEDS:
            driven = (
                *case.settings(),
                *condition_settings(case, len(places)),
                *FEEDBACK.settings,
                f"manoeuvre.speed={speed!r}",
            )
            places.append(Place(driven, aim, steerings, None))
    return places


def condition_settings(case: Case, index: int) -> Settings:
    """Returns the settings of the suite's condition at an index, in turn, for the car of a case."""
    delay, load, torque_error = SUITE.conditions[index % len(SUITE.conditions)]
    mass = load * load_scenario(SWERVE, case.settings()).car.mass
    return (
        f"imu.delay={delay}",
        f"car.mass={mass:.6g}",
        f"tail_motor.torque_error={torque_error}",
    )


def shared(steering: Sequence[float]) -> tuple[tuple[float, ...], ...]:
    """Returns a steering with its angles times each of `ANGLE_SHARES`."""
    angles = np.outer(ANGLE_SHARES, steering[:LEVELS])
    return tuple((*row, *steering[LEVELS:]) for row in angles.tolist())


def add_steerings(
    places: Sequence[Place], law: Law, runs: CachedRunner, effort: SearchEffort
) -> list[Place]:
    """Returns places with the best steering of a law added to those with which laws are tried."""
    runs.stage = "steerings of the law"
    items = [
        SteeringItem(((*place.settings, *law_settings(law)),), place.aim, effort)
        for place in places
    ]
    results = runs.map(best_steering, items)
    return [
        place._replace(steerings=(*place.steerings, *shared(result["steering"])))
        for place, result in zip(places, results, strict=True)
    ]


def search_laws(
    search: LawSearch,
    start: Law,
    score_laws: Callable[[Sequence[Law]], FloatArray],
    progress: ProgressLine,
    ranges: Ranges = RANGES,
) -> Law:
    """Searches the law with the largest score.

    Args:
        search: budget of the search; one round is made.
        start: law around which the first generation is drawn; it is scored before that.
        score_laws: function that returns the scores (n,) of laws.
        progress: function that receives a line for each generation.
        ranges: ranges of the free numbers.

    Raises:
        UserError: no score is above 0.
    """
    require("search", "training of a law", "cma", error=SweepError)
    import cma

    rng = np.random.default_rng(search.seed)
    strategy = cma.CMAEvolutionStrategy(
        shares_of(start, ranges),
        search.around,
        {
            "bounds": [0.0, 1.0],
            "popsize": search.laws,
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": math.nan,
            "verbose": -9,
        },
    )
    best = start
    best_score = float(score_laws([start])[0])
    bar = ProgressBar(progress, search.generations)
    for generation in range(search.generations):
        shares = np.array(strategy.ask())
        laws = laws_at(shares, ranges)
        scores = score_laws(laws)
        strategy.tell(shares, -scores)
        first = int(np.argmax(scores))
        if scores[first] > best_score:
            best, best_score = laws[first], float(scores[first])
        tried = (generation + 1) * search.laws + 1
        bar.advance(f"{tried} laws tried on reduced cars, the best scores {best_score:.3f}")
    if best_score <= 0.0:
        raise SweepError("no law that was tried keeps a training car upright at any speed")
    return best


def laws_at(shares: FloatArray, ranges: Ranges = RANGES) -> list[Law]:
    """Returns the laws at shares (n, numbers) of ranges, rounded to four digits."""
    low, high = np.array(list(ranges.values())).T
    return [
        dict(zip(ranges, (float(f"{value:.4g}") for value in row), strict=True))
        for row in low + shares * (high - low)
    ]


def shares_of(law: Law, ranges: Ranges = RANGES) -> FloatArray:
    """Returns the position of a law in ranges (numbers,), clipped to their ends."""
    shares = [(law[name] - low) / (high - low) for name, (low, high) in ranges.items()]
    return np.clip(shares, 0.0, 1.0)


def score(ratios: FloatArray) -> FloatArray:
    """Returns the scores of laws (laws,) from their worth at each place (laws, places)."""
    worst = np.sort(ratios, axis=1)[:, : max(1, round(WORST_SHARE * ratios.shape[1]))]
    return np.asarray(0.5 * (ratios.mean(axis=1) + worst.mean(axis=1)))


def score_law_batch(batch: LawBatch) -> list[float]:
    """Returns the worth of each law at its place (laws,): the aim that it reaches over that without
    tail, 0 where no swerve counts; in the manoeuvres of the standard see `PASSED`.

    Raises:
        UserError: the place holds something that the reduced car does not know.
    """
    place, laws = batch
    aim = find_aim(place.aim)
    car = ReducedSwerve(load_scenario(SWERVE, place.settings))
    count = len(place.steerings)
    limit = car.scenario.servo.limit
    steerings = possible_steering(np.tile(place.steerings, (len(laws), 1)), limit)
    numbers = repeated(laws, count)
    if place.reference is None:
        steerings[::count] = counter_steer(steerings, car.drive(steerings.T, numbers), car)[::count]
    values = score_swerves(car.drive(steerings.T, numbers), aim).reshape(len(laws), count)
    if place.reference is None:
        worth = PASSED * np.mean(values > FAILED, axis=1)
    else:
        worth = np.maximum(values.max(axis=1), 0.0) / place.reference
    return worth.tolist()


def repeated(laws: Sequence[Law], count: int) -> NamedArrays:
    """Returns the numbers of laws by their keys, each law `count` times in a row."""
    return {name: np.repeat([law[name] for law in laws], count) for name in laws[0]}


def counter_steer(steerings: FloatArray, driven: Swerve, car: ReducedSwerve) -> FloatArray:
    """Returns steerings (n, `STEERING`) that counter-steer as the driver of a fishhook does, see
    `FishhookDriver`.

    Args:
        steerings: steerings to one side.
        driven: swerves of the car with these steerings.
        car: reduced car that made the swerves.
    """
    angles = steerings[:, 0]
    reached = angles / car.scenario.servo.rate
    outwards = np.gradient(driven.roll, driven.time, axis=0) >= FISHHOOK.manoeuvre.counter_roll_rate
    rolled = np.logical_or.accumulate(outwards & driven.steered[:, None], axis=0)
    falls = rolled & ~outwards & (driven.time[:, None] >= reached)
    instant = driven.time[np.argmax(falls, axis=0)] + car.scenario.imu.delay
    instant = np.where(falls.any(axis=0), instant, car.scenario.manoeuvre.turn_hold)
    return np.stack([angles, -angles, -angles, instant, instant + TICK], axis=1)
