"""Laws that are trained: the thesis' law with other numbers, the best of which are looked for on training cars alone.

A family may also change numbers of the car, such as the size of its tail: one search for both.

Whole generations of laws (`law_search`) are driven on reduced cars (`optimisation.screening`), each law with the best
steering of each case. The best of those that differ then go to the full car, and the best one there is the law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.studies.contestants import SWINGING, THESIS, Contestant, centre_of_raised
from aerodima.optimisation.studies.law_search import LawSearch, LawsFound, search_laws
from aerodima.optimisation.studies.steering_search import SteeringSearch, search_steering
from aerodima.optimisation.sweep.study_engine import RememberingEngine
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.controllers.swing_law import SwingSettings
from aerodima.workbench.errors import SweepError

CHUNK = 96
"""Reduced cars that one worker drives at once; what is found does not depend on the number of workers."""
SOON_OVER = 0.5
"""How long a reduced car is driven after its steering, s."""


@dataclass(frozen=True)
class LawFamily:
    """Laws among which one is looked for: the thesis' law, some of whose numbers are free.

    Attributes:
        name: of the contestant that is found.
        ranges: least and largest value by name in the section `controller` of a scenario, or by `section.key` of
            another one, in its units.
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

    @property
    def starts(self) -> Sequence[Mapping[str, float]]:
        """Laws that a search begins with, beside those that it draws."""
        return [self.published_law]

    def beyond(self, laws: Sequence[Mapping[str, float]], engine: RememberingEngine) -> FloatArray:
        """How far laws (n,) are beyond what the car allows; only those with 0 are driven."""
        return np.zeros(len(laws))

    def settings(self, law: Mapping[str, float]) -> tuple[str, ...]:
        """Of the law with these numbers; those of the thesis go with its own trigger."""
        return THESIS.settings if law == self.published_law else self._own_settings(law)

    def _own_settings(self, law: Mapping[str, float]) -> tuple[str, ...]:
        numbers = (f"{name if '.' in name else f'controller.{name}'}={value!r}" for name, value in law.items())
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
        board_margin: least height of the anti-ramp board over the ground in a turn that counts, m.
        content: key of what the files behind the cases hold (`scenario_content`); with another nothing remembered is
            taken.
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
    board_margin: float = 0.0
    content: str = ""


def screened_courses(task: Screening) -> list[list[float]]:
    """Course with the best steering (laws x cases), rad; 0 where no turn counts, or the swing begins before the turn.

    Raises:
        UserError: what the screening model does not know.
    """
    count = len(task.cases)
    which = np.tile(np.arange(count), len(task.laws))
    cases = tuple((*case, *task.fixed) for case in task.cases)
    scenarios, all_cars, all_plans = _reduced(task.scenario, cases, task.content)
    numbers: dict[str, Any] = {
        name: np.repeat([law[name] for law in task.laws], count) for name in task.laws[0] if "." not in name
    }
    cars, plans = all_cars.take(which), replace(all_plans.take(which), **numbers)
    if len(numbers) < len(task.laws[0]):
        cars = Vehicles.of([changed(scenario, law) for law in task.laws for scenario in scenarios])
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
        counted &= turns.lowest_board >= task.board_margin
        return [float(course) if ok else None for course, ok in zip(turns.course, counted & waits[places], strict=True)]

    found = search_steering(task.steering, len(which), run)
    best = [max((value for value in tried.values() if value is not None), default=0.0) for tried in found]
    return [best[k : k + count] for k in range(0, len(best), count)]


@lru_cache(maxsize=4)
def _reduced(
    scenario: str, cases: tuple[tuple[str, ...], ...], _content: str
) -> tuple[list[Scenario], Vehicles, TurnPlans]:
    scenarios = [load_scenario(scenario, settings) for settings in cases]
    return scenarios, Vehicles.of(scenarios), TurnPlans.of(scenarios)


def changed(scenario: Scenario, law: Mapping[str, float]) -> Scenario:
    """A scenario with the numbers of a law that are named `section.key`; the gearbox moves with the tail's joints."""
    sections: dict[str, dict[str, float]] = {}
    for name, value in law.items():
        section, _, key = name.rpartition(".")
        if section:
            sections.setdefault(section, {})[key] = value
    if (height := law.get("tail.mount_height")) is not None:
        sections["car"] = {"com_height": centre_of_raised(scenario, height)} | sections.get("car", {})
    return scenario.varied(**sections)


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


def screened_finalists(family: LawFamily, search: LawSearch, cases: Screening, engine: RememberingEngine) -> LawsFound:
    """Laws of a family that do best on reduced cars; a search that was stopped goes on, since all its runs are kept."""
    published = course_table(cases, [{}], engine)[0]
    own = replace(cases, fixed=family.fixed)

    def worth(laws: Sequence[Mapping[str, float]]) -> FloatArray:
        found = -family.beyond(laws, engine)
        allowed = np.flatnonzero(found == 0.0)
        if allowed.size:
            courses = course_table(own, [laws[place] for place in allowed.tolist()], engine)
            found[allowed] = score(courses, published, cases.cars)
        return found

    return search_laws(family, search, worth, engine.say)


def course_table(cases: Screening, laws: Sequence[Mapping[str, float]], engine: RememberingEngine) -> FloatArray:
    """`screened_courses` of any number of laws (laws, cases), shared among the workers and kept."""
    chunk = max(1, CHUNK // len(cases.cases))
    tasks = [replace(cases, laws=tuple(laws[k : k + chunk])) for k in range(0, len(laws), chunk)]
    return np.concatenate(run_screenings(engine, tasks))
