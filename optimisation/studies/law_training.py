"""Laws that are trained: the thesis' law with other numbers, the best of which are looked for on training cars alone.

Differential evolution (Storn and Price 1997, doi 10.1023/A:1008202821328; `scipy.optimize.differential_evolution`)
drives whole generations of laws on reduced cars (`optimisation.screening`), each law with the best steering of each
case. The best of those that differ then go to the full car, and the best one there is the law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from operator import itemgetter
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.studies.contestants import SWINGING, THESIS, Contestant
from aerodima.optimisation.studies.steering_search import SteeringSearch, search_steering
from aerodima.optimisation.sweep.study_engine import RememberingEngine
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.swing_law import SwingSettings
from aerodima.workbench.errors import SweepError

CHUNK = 24
"""Laws that one worker drives at once; what is found does not depend on the number of workers."""
SOON_OVER = 0.5
"""How long a reduced car is driven after its steering, s."""
LATEST, GAIN = 3, 0.005
"""A search gains if its last so many generations brought that much: of the course of the published law."""
APART = 0.05
"""Least share of a range by which finalists differ in one number at least."""


@dataclass(frozen=True)
class LawFamily:
    """Laws among which one is looked for: the thesis' law, some of whose numbers are free.

    Attributes:
        name: of the contestant that is found.
        ranges: least and largest value by name in the section `controller` of a scenario, in its units.
        fixed: settings that all of them have.
    """

    name: str
    ranges: Mapping[str, tuple[float, float]] = field(hash=False)
    fixed: tuple[str, ...] = ()

    def laws(self, shares: FloatArray) -> list[dict[str, float]]:
        """Numbers at shares (n, ranges) of the ranges, to four digits; a travel is at most twice the `hold_angle`."""
        ends = np.array(list(self.ranges.values()))
        found = []
        for row in ends[:, 0] + shares * (ends[:, 1] - ends[:, 0]):
            law = {name: float(f"{value:.4g}") for name, value in zip(self.ranges, row.tolist(), strict=True)}
            if "travel" in law:
                law["travel"] = min(law["travel"], 2.0 * law["hold_angle"])
            found.append(law)
        return found

    def for_pulse(self, pulse: float) -> LawFamily:
        """For steering of that length, s: where it is longer, the swing may wait and last as much longer."""
        longer = max(1.0, pulse / DELAYS[1])
        stretched = {"delay": (1.0, longer), "swing_speed": (1.0 / longer, 1.0)}
        factors = {name: stretched.get(name, (1.0, 1.0)) for name in self.ranges}
        return replace(self, ranges={k: (v[0] * factors[k][0], v[1] * factors[k][1]) for k, v in self.ranges.items()})

    def shares(self, law: Mapping[str, float]) -> FloatArray:
        """Where a law lies in the ranges (ranges,), its ends where it lies beyond."""
        return np.array([np.clip((law[k] - low) / (high - low), 0.0, 1.0) for k, (low, high) in self.ranges.items()])

    @property
    def published_law(self) -> dict[str, float]:
        """The free numbers as the thesis has them."""
        published = SwingSettings.published()
        return {name: float(getattr(published, name)) for name in self.ranges}

    def settings(self, law: Mapping[str, float]) -> tuple[str, ...]:
        """Of the law with these numbers; those of the thesis go with its own trigger."""
        if law == self.published_law:
            return THESIS.settings
        numbers = (f"controller.{name}={value!r}" for name, value in law.items())
        return (*SWINGING, "controller.swing_file=none", *self.fixed, *numbers)

    def contestant(self, laws: Mapping[float, Mapping[str, float]]) -> Contestant:
        """Of laws by speed, m/s."""
        words = ", ".join(dict.fromkeys(" @ ".join(f"{value:g}" for value in law.values()) for law in laws.values()))
        name = f"{self.name} ({words})" if len(self.ranges) <= 2 else self.name
        return Contestant(name, (), choices={speed: self.settings(law) for speed, law in laws.items()})


CONSTANT_RATE = LawFamily("best constant rate", {"swing_speed": (1.0, 14.0), "trigger_yaw_rate": (0.2, 2.0)})
DELAYS = (0.0, 0.5)
"""From the release to the swing, s; to the length of the steering where that is longer."""
_MOTION = {
    "delay": DELAYS,
    "swing_speed": (2.0, 14.0),
    "swing_kd": (0.5, 5.0),
    "travel": (0.6, 3.14),
    "settle_kp": (0.5, 20.0),
    "settle_kd": (0.2, 5.0),
    "hold_angle": (0.9, 1.57),
    "pitch_angle": (-0.6, 0.6),
}
TRAINED = LawFamily(
    "trained",
    _MOTION,
    ("controller.trigger=steering", "controller.trigger_steering_angle=0.03"),
)
"""Release after the steering command, rate, how hard it is reached (`swing_kd` times the rate is the torque at the
release), travel, braking, and where the tail waits. A yaw rate that says as early that the car turns is reached on the
straight already, by the drag of the held tail."""
TRAINED_BY_YAW = LawFamily("trained, released by yaw rate", {"trigger_yaw_rate": (0.2, 2.0), **_MOTION})
"""Likewise from a yaw rate on. Where the held tail comes to it on the straight already, the law turns nothing."""


@dataclass(frozen=True)
class LawSearch:
    """How much is searched.

    Attributes:
        laws: of a generation, for each free number of the family.
        generations: beside the first one.
        finalists: laws that go to the full car.
        seed: of the first generation and of all later draws.
        steering_runs: of each search for an amplitude on a reduced car.

    Raises:
        UserError: fewer than 3 laws, or no finalist.
    """

    laws: int = 6
    generations: int = 15
    finalists: int = 5
    seed: int = 1
    steering_runs: int = 7

    def __post_init__(self) -> None:
        if self.laws < 3:
            raise SweepError(f"{self.laws} laws for each number: allowed: at least 3")
        if self.finalists < 1:
            raise SweepError(f"{self.finalists} finalists: allowed: at least 1")


@dataclass(frozen=True)
class Screening:
    """Laws on cases of reduced cars: small enough to send to a worker.

    Attributes:
        scenario: of the turn.
        cases: settings of each, friction and length of the pulse among them.
        cars: the car of each case.
        steering: search for the amplitude of each law in each case.
        most_roll, most_sideslip: of a turn that counts, rad.
        laws: numbers by name; none: the published one.
        fixed: settings of all of them.
        duration: how long the cars are driven from their steering on, s.
    """

    scenario: str
    cases: tuple[tuple[str, ...], ...]
    cars: tuple[str, ...]
    steering: SteeringSearch
    most_roll: float
    most_sideslip: float
    laws: tuple[Mapping[str, float], ...] = ({},)
    fixed: tuple[str, ...] = ()
    duration: float = DELAYS[1] + SOON_OVER


def screened_courses(task: Screening) -> list[list[float]]:
    """Course with the best steering (laws x cases), rad; 0 where no turn counts, or the swing begins before the turn.

    Raises:
        UserError: what the screening model does not know.
    """
    count = len(task.cases)
    which = np.tile(np.arange(count), len(task.laws))
    all_cars, all_plans = _reduced(task.scenario, tuple((*case, *task.fixed) for case in task.cases))
    numbers: dict[str, Any] = {name: np.repeat([law[name] for law in task.laws], count) for name in task.laws[0]}
    cars, plans = all_cars.take(which), replace(all_plans.take(which), **numbers)
    straight = drive_turns(cars, plans, duration=0.0)
    waits = np.isnan(straight.trigger)

    def run(wanted: Sequence[tuple[int, int]]) -> list[float | None]:
        places = [place for place, _ in wanted]
        angles = np.array([task.steering.angle(place) for _, place in wanted])
        turns = drive_turns(
            cars.take(places),
            replace(plans.take(places), steer_angle=angles),
            duration=task.duration,
            begun=straight.last[:, places],
        )
        counted = turns.clean & (turns.peak_roll <= task.most_roll) & (np.abs(turns.sideslip) <= task.most_sideslip)
        return [float(course) if ok else None for course, ok in zip(turns.course, counted & waits[places], strict=True)]

    found = search_steering(task.steering, len(which), run)
    best = [max((value for value in tried.values() if value is not None), default=0.0) for tried in found]
    return [best[k : k + count] for k in range(0, len(best), count)]


@lru_cache(maxsize=4)
def _reduced(scenario: str, cases: tuple[tuple[str, ...], ...]) -> tuple[Vehicles, TurnPlans]:
    scenarios = [load_scenario(scenario, settings) for settings in cases]
    return Vehicles.of(scenarios), TurnPlans.of(scenarios)


def score(courses: FloatArray, published: FloatArray, cars: Sequence[str]) -> FloatArray:
    """What laws are worth (laws,): course over that of the published one, half the mean, half the worst car's mean.

    Args:
        courses: of laws (laws, cases), rad.
        published: of the published law (cases,), rad; cases in which it has none do not count.
        cars: of each case.

    Raises:
        UserError: it has none at all.
    """
    known = published > 0.0
    if not known.any():
        raise SweepError(f"training cars {', '.join(dict.fromkeys(cars))}: no turn of the published swing counts")
    ratios = courses[:, known] / published[known]
    own = [name for name, there in zip(cars, known.tolist(), strict=True) if there]
    by_car = np.array([ratios[:, [name == car for name in own]].mean(axis=1) for car in dict.fromkeys(own)])
    worth: FloatArray = 0.5 * (ratios.mean(axis=1) + by_car.min(axis=0))
    return worth


def run_screenings(engine: RememberingEngine, tasks: Sequence[Screening]) -> list[list[list[float]]]:
    """`screened_courses` of each; what the engine remembers is not driven again."""
    keys = [content_key("screened courses", vars(task) | {"steering": vars(task.steering)}) for task in tasks]
    return engine.call_once(screened_courses, tasks, keys)


def screened_finalists(
    family: LawFamily, search: LawSearch, cases: Screening, engine: RememberingEngine
) -> list[dict[str, float]]:
    """Laws of a family that do best on reduced cars; a search that was stopped goes on, since all its runs are kept."""

    def courses(tasks: Sequence[Screening]) -> FloatArray:
        return np.concatenate(run_screenings(engine, tasks))

    def worth(laws: Sequence[Mapping[str, float]]) -> FloatArray:
        parts = [tuple(laws[k : k + CHUNK]) for k in range(0, len(laws), CHUNK)]
        return score(courses([replace(cases, laws=part, fixed=family.fixed) for part in parts]), published, cases.cars)

    published = courses([cases])[0]
    return search_laws(family, search, worth, engine.say)


def search_laws(
    family: LawFamily,
    search: LawSearch,
    worth: Callable[[Sequence[Mapping[str, float]]], FloatArray],
    told: Callable[[str], None],
) -> list[dict[str, float]]:
    """The finalists, the best first: of all laws that were tried those that differ by `APART`.

    Args:
        family: among them.
        search: how.
        worth: scores (n,) of laws.
        told: of the progress.
    """
    seen: list[tuple[float, FloatArray]] = []

    def cost(shares: FloatArray) -> FloatArray:
        scores = worth(family.laws(shares.T))
        seen.extend(zip(scores.tolist(), shares.T.copy(), strict=True))
        told(f"{family.name}: {len(seen)} laws tried on reduced cars, the best {max(w for w, _ in seen) - 1.0:+.1%}")
        return -scores

    numbers = len(family.ranges)
    first = qmc.LatinHypercube(numbers, rng=search.seed).random(search.laws * numbers)
    first[0] = family.shares(family.published_law)
    differential_evolution(
        cost, [(0.0, 1.0)] * numbers, init=first, maxiter=search.generations, tol=0.0, polish=False, vectorized=True,
        updating="deferred", rng=search.seed,
    )  # fmt: skip
    if is_gaining([worth for worth, _ in seen], search.laws * numbers):
        told(f"{family.name}: stopped at {search.generations} generations while it still gained")
    chosen: list[FloatArray] = []
    for _, shares in sorted(seen, key=itemgetter(0), reverse=True):
        if all(np.max(np.abs(shares - other)) >= APART for other in chosen):
            chosen.append(shares)
    return family.laws(np.array(chosen[: search.finalists]))


def is_gaining(worths: Sequence[float], generation: int) -> bool:
    """Whether one of the last `LATEST` generations, of that many laws, gained at least `GAIN` over those before it."""
    before = worths[: -LATEST * generation]
    return bool(before) and max(worths) >= max(before) + GAIN
