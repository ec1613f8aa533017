"""Search among laws: the thesis' law with other numbers, the best of which are looked for on training cars alone.

Whole generations of laws are driven on reduced cars (`optimisation.screening`), each law with the best steering of
each case: differential evolution (Storn and Price 1997, doi 10.1023/A:1008202821328). The best of those that differ
then go to the full car, and the best one there is the law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.sweep.runs import Runs, scenario_content
from aerodima.optimisation.swing.candidate import SWINGING, THESIS, Candidate
from aerodima.optimisation.swing.judge import Courses
from aerodima.optimisation.swing.task import Floor, SteeringSearch, Task, search_steering
from aerodima.workbench.batch.row_store import ProgressBar, content_key
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.swing_law import SwingSettings
from aerodima.workbench.errors import SweepError

APART = 0.05
"""Least share of a range by which finalists differ in one number at least."""
CHUNK = 96
"""Reduced cars that one worker drives at once; what is found does not depend on the number of workers."""
SOON_OVER = 0.5
"""How long a reduced car is driven after its steering, s."""
LONGEST_DELAY = 0.5
"""From the release to the swing, s; to the length of the steering where that is longer."""


@dataclass(frozen=True)
class LawFamily:
    """Laws among which one is looked for: the thesis' law, some of whose numbers are free.

    Attributes:
        name: of the candidate that is found.
        ranges: least and largest value by name, in the units of the scenario.
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
        longer = max(1.0, pulse / LONGEST_DELAY)
        stretched = {"delay": (1.0, longer), "swing_speed": (1.0 / longer, 1.0)}
        factors = {name: stretched.get(name, (1.0, 1.0)) for name in self.ranges}
        return replace(self, ranges={k: (v[0] * factors[k][0], v[1] * factors[k][1]) for k, v in self.ranges.items()})

    def shares(self, law: Mapping[str, float]) -> FloatArray:
        """Where a law lies in the ranges (ranges,), its ends where it lies beyond."""
        return np.array([np.clip((law[k] - low) / (high - low), 0.0, 1.0) for k, (low, high) in self.ranges.items()])

    def published_law(self) -> dict[str, float]:
        """The free numbers as the thesis has them."""
        published = SwingSettings.published()
        return {name: float(getattr(published, name)) for name in self.ranges}

    def settings(self, law: Mapping[str, float]) -> tuple[str, ...]:
        """Of the law with these numbers of the section `controller`."""
        return (*SWINGING, *self.fixed, *(f"controller.{name}={value!r}" for name, value in law.items()))


TRAINED = LawFamily(
    "trained",
    {
        "delay": (0.0, LONGEST_DELAY),
        "swing_speed": (2.0, 14.0),
        "swing_kd": (0.5, 5.0),
        "travel": (0.6, 3.14),
        "settle_kp": (0.5, 20.0),
        "settle_kd": (0.2, 5.0),
        "hold_angle": (0.9, 1.57),
        "pitch_angle": (-0.6, 0.6),
    },
    ("controller.trigger=steering", "controller.trigger_steering_angle=0.03"),
)
"""Release after the steering command, rate, how hard it is reached (`swing_kd` times the rate is the torque at the
release), travel, braking, and where the tail waits."""


@dataclass(frozen=True)
class LawSearch:
    """How much is searched.

    Attributes:
        laws: of a generation, for each free number of the family.
        generations: beside the first one.
        finalists: laws that go to the full car.
        seed: of the first generation and of all later draws.
        steering_runs: of each search for an amplitude on a reduced car.
        around: share of the ranges, around the law that it starts from, over which the first generation is drawn.

    Raises:
        UserError: fewer than 3 laws, no finalist, or a share out of range.
    """

    laws: int = 6
    generations: int = 15
    finalists: int = 5
    seed: int = 1
    steering_runs: int = 7
    around: float = 1.0

    def __post_init__(self) -> None:
        if self.laws < 3:
            raise SweepError(f"{self.laws} laws for each number: allowed: at least 3")
        if self.finalists < 1:
            raise SweepError(f"{self.finalists} finalists: allowed: at least 1")
        if not 0.0 < self.around <= 1.0:
            raise SweepError(f"around {self.around:g}: allowed: above 0, at most 1")


def search_law(task: Task, family: LawFamily, search: LawSearch, runs: Runs) -> tuple[Candidate, pd.DataFrame]:
    """The law of a family for each speed that is best on the training cars, and a table of the finalists.

    Args:
        task: of the turns; its training cars and its floors for them.
        family: among which one is looked for.
        search: how much.
        runs: where they are made.

    Raises:
        UserError: no training car has a floor, or no turn of the published swing counts; what reduced cars do not know.
    """
    chosen, rows = {}, []
    family, courses = family.for_pulse(task.pulse), Courses(task, runs)
    published = family.published_law()
    all_floors, _ = courses.floors(task.training_cars)
    for speed in task.speeds:
        floors = [floor for floor in all_floors if floor.speed == speed]
        cases = replace(screening_of(task, floors, search.steering_runs), fixed=family.fixed)
        reference = course_table(replace(cases, fixed=()), [{}], runs)[0]
        finalists = search_laws(family, search, published, partial(_screened_worth, cases, reference, runs), runs.say)
        laws = [published, *finalists]
        candidates = [THESIS, *(Candidate("", family.settings(law)) for law in finalists)]
        runs.stage = family.name
        full = courses.best(candidates, floors)
        worth = score(full, full[0], cases.cars)
        best = int(np.argmax(worth))
        chosen[speed] = candidates[best].settings
        for place, law in enumerate(laws):
            row = {"family": family.name, "speed_m_per_s": speed, "law": place or "published", **law}
            rows.append(row | {"worth": worth[place], "median_course_rad": np.median(full[place])})
    return Candidate(family.name, (), chosen), pd.DataFrame(rows)


def search_laws(
    family: LawFamily,
    search: LawSearch,
    start: Mapping[str, float],
    worth: Callable[[Sequence[Mapping[str, float]]], FloatArray],
    told: Callable[[str], None],
) -> list[dict[str, float]]:
    """The best laws of a family, the best first, that differ by `APART`.

    Args:
        family: among them.
        search: how much.
        start: a law that the first generation has, beside those that are drawn.
        worth: scores (n,) of laws; those that are not above 0 are no finalists.
        told: of the progress.
    """
    seen: list[tuple[float, FloatArray]] = []
    bar = ProgressBar(told, search.generations + 1)

    def cost(shares: FloatArray) -> FloatArray:
        scores = worth(family.laws(shares.T))
        seen.extend(zip(scores.tolist(), shares.T.copy(), strict=True))
        best = max(score for score, _ in seen)
        said = "none allowed yet" if best <= 0.0 else f"the best {best - 1.0:+.1%}"
        bar.one_more(f"{family.name}: {len(seen)} laws tried on reduced cars, {said}")
        return -scores

    numbers = len(family.ranges)
    first = qmc.LatinHypercube(numbers, rng=search.seed).random(search.laws * numbers)
    first[0] = shares = family.shares(start)
    if search.around < 1.0:
        first = np.clip(shares + search.around * (first - shares[None]), 0.0, 1.0)
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
    chosen: list[FloatArray] = []
    for value, shares in sorted(seen, key=lambda pair: -pair[0]):
        if value > 0.0 and all(np.max(np.abs(shares - other)) >= APART for other in chosen):
            chosen.append(shares)
    return family.laws(np.array(chosen[: search.finalists]).reshape(-1, numbers))


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


@dataclass(frozen=True)
class Screening:
    """Laws on cases of reduced cars: small enough to send to a worker.

    Attributes:
        scenario: of the turn.
        cases: settings of each, friction and length of the pulse among them.
        cars: the car of each case.
        steering: search for the amplitude of each law in each case.
        most_roll, most_sideslip: of a turn that counts, rad.
        duration: how long the cars are driven from their steering on, s.
        content: key of what the files behind the cases hold (`scenario_content`); with another nothing remembered is
            taken.
        laws: numbers by name; none: the published one.
        fixed: settings of all of them.
    """

    scenario: str
    cases: tuple[tuple[str, ...], ...]
    cars: tuple[str, ...]
    steering: SteeringSearch
    most_roll: float
    most_sideslip: float
    duration: float = LONGEST_DELAY + SOON_OVER
    content: str = ""
    laws: tuple[Mapping[str, float], ...] = ({},)
    fixed: tuple[str, ...] = ()


def screening_of(task: Task, floors: Sequence[Floor], steering_runs: int) -> Screening:
    """The published law on floors of a task."""
    settings = []
    for floor in floors:
        own = task.settings(THESIS, floor.car, floor.speed, task.step)
        settings.append((*own, floor.setting, f"manoeuvre.turn_hold={task.pulse!r}"))
    return Screening(
        task.scenario,
        tuple(settings),
        tuple(floor.car.name for floor in floors),
        replace(task.search, runs=steering_runs),
        task.most_roll,
        task.most_sideslip,
        task.pulse + SOON_OVER,
        content_key([scenario_content(task.scenario, own) for own in settings]),
    )


def screened_courses(screening: Screening) -> list[list[float]]:
    """Course with the best steering (laws x cases), rad; 0 where no turn counts, or the swing begins before the turn.

    Raises:
        UserError: what the screening model does not know.
    """
    count, laws = len(screening.cases), screening.laws
    which = np.tile(np.arange(count), len(laws))
    cases = tuple((*case, *screening.fixed) for case in screening.cases)
    all_cars, all_plans = _reduced(screening.scenario, cases, screening.content)
    numbers: dict[str, Any] = {name: np.repeat([law[name] for law in laws], count) for name in laws[0]}
    cars, plans = all_cars.take(which), replace(all_plans.take(which), **numbers)
    straight = drive_turns(cars, plans, duration=0.0)
    waits = np.isnan(straight.trigger)

    def run(wanted: Sequence[tuple[int, int]]) -> list[float | None]:
        places = [place for place, _ in wanted]
        angles = np.array([screening.steering.angle(place) for _, place in wanted])
        turns = drive_turns(
            cars.take(places),
            replace(plans.take(places), steer_angle=angles),
            duration=screening.duration,
            begun=straight.last[:, places],
        )
        counted = turns.clean & (turns.peak_roll <= screening.most_roll)
        counted &= (np.abs(turns.sideslip) <= screening.most_sideslip) & waits[places]
        return [float(course) if ok else None for course, ok in zip(turns.course, counted, strict=True)]

    found = search_steering(screening.steering, len(which), run)
    best = [max((value for value in tried.values() if value is not None), default=0.0) for tried in found]
    return [best[k : k + count] for k in range(0, len(best), count)]


def course_table(cases: Screening, laws: Sequence[Mapping[str, float]], runs: Runs) -> FloatArray:
    """`screened_courses` of any number of laws (laws, cases), shared among the workers and kept."""
    chunk = max(1, CHUNK // len(cases.cases))
    parts = [replace(cases, laws=tuple(laws[k : k + chunk])) for k in range(0, len(laws), chunk)]
    keys = [content_key("screened courses", vars(part) | {"steering": vars(part.steering)}) for part in parts]
    return np.concatenate(runs.call(screened_courses, parts, keys))


def _screened_worth(
    cases: Screening, reference: FloatArray, runs: Runs, laws: Sequence[Mapping[str, float]]
) -> FloatArray:
    return score(course_table(cases, laws, runs), reference, cases.cars)


@lru_cache(maxsize=4)
def _reduced(scenario: str, cases: tuple[tuple[str, ...], ...], _content: str) -> tuple[Vehicles, TurnPlans]:
    scenarios = [load_scenario(scenario, settings) for settings in cases]
    return Vehicles.of(scenarios), TurnPlans.of(scenarios)
