"""Search of the numbers of the feedback law: reduced training cars, the highest speeds that they
enter at.

A law is scored by the speeds at which cars stay upright, over the entry speed of the car without
tail. A car that turns less than `LEAST_SHARE` of it counts much less, by the power `LACK`, so that
the search is led to laws that turn enough. The score is half the mean over cars and manoeuvres and
half the mean of the worst fifth. Generations of laws follow differential evolution (Storn and Price
1997, doi 10.1023/A:1008202821328).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from aerodima.optimisation.judge.candidate import NO_TAIL, Candidate
from aerodima.optimisation.judge.entry_speed import LEAST_SHARE, EntryFloor, Manoeuvre
from aerodima.optimisation.judge.suite import FEEDBACK, TRAINED_ON, manoeuvres
from aerodima.optimisation.studies.runs import Runs, scenario_content
from aerodima.workbench.batch.row_store import ProgressBar, ProgressLine, content_key
from aerodima.workbench.car.reduced.entry_runs import climb
from aerodima.workbench.car.reduced.vehicle_parameters import Vehicles
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import Member
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
"""Speeds of the climb of a law, over the entry speed of the car without tail."""
SPEEDS_WITHOUT = np.arange(1.3, 6.05, 0.1)
"""m/s, of the climb of a car without tail; on a car that comes to its end a tail can gain nothing.
"""
AT_ONCE = 22
"""Laws in one piece of work."""
LACK = 12
"""Power of what is turned over what must be; with 3 the search found laws that stay upright and
turn too little."""
MARGIN = 1.02
"""What must be turned here over what must be turned by the full car, whose figure is 5 % smaller to
2 % larger (law of `models/parameters/feedback.yaml`, three training cars, turn, held turn and
fishhook at 3.2 and 6 m/s)."""
WORST = 0.2
"""Share of cases that the second half of the score is made of."""
MIN_FIGURE = 1.0
"""m/s2, of a car that is upright at no speed without a tail."""
CASE_SPEED = 4.0
"""m/s, at which the cars are built; each run has its own."""


@dataclass(frozen=True)
class LawSearch:
    """How much is searched.

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
        if self.laws < 3:
            raise SweepError(f"{self.laws} laws for each number: allowed: at least 3")
        if not 0.0 < self.around <= 1.0:
            raise SweepError(f"around {self.around:g}: allowed: above 0, at most 1")


@dataclass(frozen=True)
class Screened:
    """Laws on cars in a manoeuvre: small enough to send to a worker.

    Attributes:
        manoeuvre: name of the suite; `tail` of `suite.TAILS`.
        cars: settings of each car.
        laws: numbers by name.
    """

    manoeuvre: str
    tail: str
    cars: tuple[tuple[str, ...], ...]
    laws: tuple[Mapping[str, float], ...]


def search_feedback(
    cases: Sequence[tuple[Member, EntryFloor]], tail: str, search: LawSearch, runs: Runs
) -> Candidate:
    """The law with the best score on training cars (`TRAINED_ON`).

    Args:
        cases: training cars with their floors.
        tail: of `suite.TAILS`.
        search: how much.
        runs: where the runs are made.

    Raises:
        UserError: no law keeps a car upright.
    """
    runs.stage = "feedback law"
    chosen = {name: manoeuvres([name], tail)[0] for name in TRAINED_ON}
    contents = {
        name: (*scenario_content(one.scenario, one.settings), one.drivers)
        for name, one in chosen.items()
    }

    cars = tuple((*car.settings_on("entry_turn"), *floor.settings) for car, floor in cases)

    def worth(laws: Sequence[Mapping[str, float]]) -> FloatArray:
        parts = [
            Screened(name, tail, cars, tuple(laws[k : k + AT_ONCE]))
            for k in range(0, len(laws), AT_ONCE)
            for name in TRAINED_ON
        ]
        keys = [
            content_key("screened entries", vars(part), *contents[part.manoeuvre]) for part in parts
        ]
        found = runs.call(screened_entries, parts, keys)
        by_manoeuvre = [np.concatenate(found[k :: len(TRAINED_ON)]) for k in range(len(TRAINED_ON))]
        return score(np.concatenate(by_manoeuvre, axis=1))

    shipped = load_scenario(chosen[TRAINED_ON[0]].scenario).feedback
    start = {name: float(getattr(shipped, name.split(".")[1])) for name in RANGES}
    best = search_laws(search, start, worth, runs.say)
    return Candidate(
        f"trained {FEEDBACK.name}",
        (*FEEDBACK.settings, *(f"{name}={value!r}" for name, value in best.items())),
    )


def search_laws(
    search: LawSearch,
    start: Mapping[str, float],
    worth: Callable[[Sequence[Mapping[str, float]]], FloatArray],
    progress: ProgressLine,
) -> dict[str, float]:
    """The law of the largest score.

    Args:
        search: how much.
        start: a law that the first generation has, beside those that are drawn.
        worth: scores (n,) of laws.
        progress: receives a line for each generation.

    Raises:
        UserError: no score is above 0.
    """
    best = (0.0, dict(start))
    bar = ProgressBar(progress, search.generations + 1)
    tried = 0

    def cost(shares: FloatArray) -> FloatArray:
        nonlocal best, tried
        laws = laws_at(shares.T)
        scores = worth(laws)
        best = max([best, *zip(scores.tolist(), laws, strict=True)], key=lambda pair: pair[0])
        tried = tried + len(laws)
        bar.advance(f"{tried} laws tried on reduced cars, the best {best[0] - 1.0:+.1%}")
        return -scores

    numbers = len(RANGES)
    own = shares_of(start)
    drawn = qmc.LatinHypercube(numbers, rng=search.seed).random(search.laws * numbers)
    first = np.clip(own + search.around * (drawn - own), 0.0, 1.0)
    first[0] = own
    differential_evolution(
        cost,
        [(0.0, 1.0)] * numbers,
        init=first,
        maxiter=search.generations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=search.seed,
    )
    if best[0] <= 0.0:
        raise SweepError("no law that was tried keeps a training car upright at any speed")
    return best[1]


def laws_at(shares: FloatArray) -> list[dict[str, float]]:
    """Laws at shares (n, numbers) of the `RANGES`, to four digits."""
    low, high = np.array(list(RANGES.values())).T
    rows = (low + shares * (high - low)).tolist()
    return [
        {name: float(f"{value:.4g}") for name, value in zip(RANGES, row, strict=True)}
        for row in rows
    ]


def shares_of(law: Mapping[str, float]) -> FloatArray:
    """Where a law lies in the `RANGES` (numbers,), its ends where it lies beyond."""
    return np.array(
        [
            np.clip((law[name] - low) / (high - low), 0.0, 1.0)
            for name, (low, high) in RANGES.items()
        ]
    )


def score(ratios: FloatArray) -> FloatArray:
    """Score of laws (laws,) from their speeds divided by those without a tail (laws, cases)."""
    worst = np.sort(ratios, axis=1)[:, : max(1, round(WORST * ratios.shape[1]))]
    found: FloatArray = 0.5 * (ratios.mean(axis=1) + worst.mean(axis=1))
    return found


def screened_entries(screened: Screened) -> list[list[float]]:
    """Speed that each law is worth over the entry speed without tail (laws, cars).

    Raises:
        UserError: what the screening model does not know.
    """
    drivers, vehicles, without, least = _reference(screened.manoeuvre, screened.tail, screened.cars)
    count = vehicles.count
    laws = screened.laws
    which = np.tile(np.arange(count), len(laws))
    gains = gains_of([law for law in laws for _ in range(count)], drivers[0])
    speeds = RATIOS[:, None] * without[which]
    upright, figure = climb(vehicles.take(which), speeds, drivers, gains, np.ones(len(which)))
    held = np.cumprod(upright, axis=0) > 0
    turned = np.minimum(1.0, np.maximum(figure, 0.0) / (MARGIN * least[which])) ** LACK
    worth = np.max(np.where(held, RATIOS[:, None] * turned, 0.0), axis=0)
    worth = np.where(without[which] >= SPEEDS_WITHOUT[-1], np.minimum(worth, 1.0), worth)
    found: list[list[float]] = worth.reshape(len(laws), count).tolist()
    return found


@lru_cache(maxsize=16)
def _reference(
    manoeuvre: str, tail: str, cars: tuple[tuple[str, ...], ...]
) -> tuple[list[Scenario], Vehicles, FloatArray, FloatArray]:
    """Drivers of a manoeuvre, its cars with the tail, entry speeds without (n), m/s, and the least
    figures (n).
    """
    (chosen,) = manoeuvres([manoeuvre], tail)
    settings = (*chosen.settings, *FEEDBACK.settings)
    drivers = [load_scenario(chosen.scenario, (*settings, *driver)) for driver in chosen.drivers]
    none = reduced_cars(chosen, cars, NO_TAIL)
    speeds = np.outer(SPEEDS_WITHOUT, np.ones(none.count))
    upright, figure = climb(
        none, speeds, drivers, gains_of([{}] * none.count, drivers[0]), np.zeros(none.count)
    )
    held = np.cumprod(upright, axis=0) > 0
    last = np.maximum(np.sum(held, axis=0) - 1, 0)
    share = 1e-9 if chosen.rule == "path" else LEAST_SHARE
    least = share * np.max(np.where(held, figure, 0.0), axis=0, initial=MIN_FIGURE)
    return drivers, reduced_cars(chosen, cars, FEEDBACK), SPEEDS_WITHOUT[last], least


def reduced_cars(chosen: Manoeuvre, cars: Sequence[tuple[str, ...]], who: Candidate) -> Vehicles:
    """Cars by their settings with the tail of a manoeuvre and a candidate."""
    of_the_car = (
        "manoeuvre.kind=turn",
        "manoeuvre.turns=1",
        "manoeuvre.rolling_start=false",
        "manoeuvre.turn_start=2",
    )
    still = ("manoeuvre.duration=4", f"manoeuvre.speed={CASE_SPEED!r}", *of_the_car)
    scenarios = []
    for car in cars:
        own = (*car, *chosen.settings)
        ballast: tuple[str, ...] = ()
        if who.ballast is not None:
            ballast = who.ballast(load_scenario(chosen.scenario, own))
        scenarios.append(load_scenario(chosen.scenario, (*own, *who.settings, *ballast, *still)))
    return Vehicles.of(scenarios)


def gains_of(laws: Sequence[Mapping[str, float]], scenario: Scenario) -> Any:
    """Fields of `FeedbackParameters` of laws as arrays (laws,); what a law does not name is the
    scenario's.
    """
    given = dict(scenario.feedback)
    return SimpleNamespace(
        **{
            key: np.array([law.get(f"feedback.{key}", value) for law in laws], float)
            for key, value in given.items()
        }
    )
