"""Task: the question that candidates are judged by: manoeuvre, cars, floors, measure, and limits.

A case is a car, a speed and a floor: a multiple of the critical friction of the published swing at full lock there.
Measured is the course that a pulse of steering turns, with the steering that is best for each candidate. A run counts
that is clean, leaves the turn, and keeps to the limits of roll and sideslip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import yaml
from pydantic import Field

from aerodima.optimisation.sweep.rollover_threshold import (
    FRICTION,
    SPEED,
    Case,
    Search,
    find_thresholds,
    is_clean,
    rounded,
)
from aerodima.optimisation.sweep.runs import Runs, RunTask
from aerodima.optimisation.swing.candidate import THESIS, Candidate, refuse_twice
from aerodima.workbench.config.checked_files import StrictModel, checked, find_file, nearest, read_yaml
from aerodima.workbench.config.ensemble import Member, load_ensemble
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SweepError, UserError

Found = dict[int, float | None]
"""Place on the grid -> what the run was worth; None where it does not count."""


@dataclass(frozen=True)
class SteeringSearch:
    """How an amplitude is looked for.

    Attributes:
        low, high: ends of the grid, rad.
        intervals: of the grid; neighbours differ by the same factor, 1.1 % with these numbers.
        runs: of each search.
        spread: of them so many are spread over the grid first.
    """

    low: float = math.radians(2.0)
    high: float = math.radians(30.0)
    intervals: int = 256
    runs: int = 9
    spread: int = 3

    def __post_init__(self) -> None:
        if not 0.0 < self.low < self.high <= math.pi / 2:
            given = f"{math.degrees(self.low):g} to {math.degrees(self.high):g} degrees"
            raise SweepError(
                f"steering {given}: allowed: from above 0 to at most 90 degrees, the first below the second"
            )
        if not 1 <= self.spread <= self.runs:
            raise SweepError(f"{self.runs} runs of a search for steering: allowed: at least {self.spread}")

    def angle(self, place: int) -> float:
        """Amplitude at a place of the grid, rad."""
        return rounded(self.low * (self.high / self.low) ** (place / self.intervals))

    def place(self, angle: float) -> int:
        """Place on the grid that is nearest to an amplitude, rad."""
        return round(self.intervals * math.log(angle / self.low) / math.log(self.high / self.low))

    def following(self, found: Mapping[int, float | None]) -> list[int]:
        """Places that are run next; none at the end."""
        if not found:
            return [self.intervals * number // (self.spread + 1) for number in range(1, self.spread + 1)]
        if len(found) >= self.runs:
            return []
        best = best_place(found)
        if best is None:
            return [min(found) // 2] if min(found) > 0 else []
        below = max((place for place in found if place < best), default=-1)
        above = min((place for place in found if place > best), default=self.intervals + 1)
        middles = [(best + above) // 2, (below + best + 1) // 2]
        if found.get(above) is not None and best - below > above - best:
            middles.reverse()
        return [middle for middle in middles if middle not in found][:1]


def best_place(found: Mapping[int, float | None]) -> int | None:
    """Of the largest value; the smallest amplitude of equal ones, None when nothing counts."""
    values = {place: value for place, value in found.items() if value is not None}
    return max(sorted(values), key=lambda place: values[place], default=None)


def search_steering(
    search: SteeringSearch, number: int, run: Callable[[Sequence[tuple[int, int]]], Sequence[float | None]]
) -> list[Found]:
    """Several searches at once, so that all workers have something to do.

    Args:
        search: the same for all of them.
        number: of searches.
        run: what the runs of (number of the search, place on the grid) are worth, in order.
    """
    found: list[Found] = [{} for _ in range(number)]
    while wanted := [(which, place) for which, tried in enumerate(found) for place in search.following(tried)]:
        for (which, place), value in zip(wanted, run(wanted), strict=True):
            found[which][place] = value
    return found


SCHEMA = "aerodima/task/1"
CASE = ["car", "speed_m_per_s", "floor", "pulse_s"]
"""Columns of a table that name a case."""
FINE_STEP = 0.0005
"""Step of the plant at which claims are made, s; a fourth of that of ordinary runs."""
PULSE = 0.5
"""Length of the steering unless another is asked for, s."""
AFTER = 1.5
"""How long a run goes on after the steering, s."""
MOST_ROLL, MOST_SIDESLIP = 0.35, 0.1
"""rad; outwards from the turn on, and to either side at the exit."""
FRICTION_CLIMB = Search(FRICTION, 0.3, 1.3, 0.05, 0.0125)


class Task(StrictModel):
    """What is asked; a file of `models/tasks`.

    Attributes:
        scenario: of the turn; its tail is the one that all candidates have unless they bring another.
        ensemble: of cars, split by `seed` into test cars, training cars and reserved ones.
        judged_on: the test cars, or the reserved ones, which nobody has looked at while a law was chosen.
        cars: of these so many, or these by name; `training` so many of the training cars.
        speeds: m/s.
        floors: friction over the critical friction of the published swing at full lock.
        pulse: length of the steering, s.
        steering: least and largest amplitude that is tried, degrees; `runs` of each search for one.
        most_roll, most_sideslip: of a run that counts, rad: outwards, and to either side at the exit.
        step, fine_step: of the plant, s: of searches, and of claims.
    """

    schema_: Literal["aerodima/task/1"] = Field(default="aerodima/task/1", alias="schema")
    scenario: str = "turn_fast"
    ensemble: str = "car"
    seed: int = Field(default=1, ge=0)
    judged_on: Literal["test", "reserved"] = "test"
    cars: int | list[str] = 4
    training: int = Field(default=4, ge=0)
    speeds: list[float] = Field(default=[4.5], min_length=1)
    floors: list[float] = Field(default=[1.1, 1.3], min_length=1)
    pulse: float = Field(default=PULSE, ge=0.1, le=2.0)
    steering: tuple[float, float] = (2.0, 30.0)
    runs: int = Field(default=9, ge=3, le=50)
    most_roll: float = Field(default=MOST_ROLL, gt=0.0, le=1.5)
    most_sideslip: float = Field(default=MOST_SIDESLIP, gt=0.0, le=1.5)
    step: float = Field(default=0.002, gt=0.0, le=0.005)
    fine_step: float = Field(default=FINE_STEP, gt=0.0, le=0.005)

    def model_post_init(self, _context: Any) -> None:
        """Raises `SweepError` for what no single value says: numbers named twice, a scenario without such a turn."""
        for name, values, low, high in (("speed", self.speeds, 1.0, 8.0), ("floor", self.floors, 0.2, 3.0)):
            refuse_twice([f"{value:g}" for value in values], name)
            for value in values:
                if not low <= value <= high:
                    raise SweepError(f"{name} {value:g}: allowed: {low:g} to {high:g}")
        try:
            turn = load_scenario(self.scenario, [f"manoeuvre.steer_angle={self.search.high!r}"]).manoeuvre
        except UserError as error:
            raise SweepError(f"task: {error}") from None
        if turn.kind != "turn":
            raise SweepError(f"{self.scenario}: manoeuvre.kind {turn.kind}; allowed: turn")
        if turn.turns != 1:
            raise SweepError(f"{self.scenario}: manoeuvre.turns {turn.turns}; allowed: 1")

    @cached_property
    def search(self) -> SteeringSearch:
        """For the amplitude of the steering."""
        low, high = map(math.radians, self.steering)
        return SteeringSearch(low, high, runs=self.runs)

    @cached_property
    def test_cars(self) -> tuple[Member, ...]:
        """Cars that are judged on; SweepError for more than there are, or one that is none of them."""
        there: tuple[Member, ...] = getattr(load_ensemble(self.ensemble).split(self.seed), self.judged_on)
        if isinstance(self.cars, int):
            return _first(there, self.cars, "cars")
        known = {car.name: car for car in there}
        refuse_twice(self.cars, "car")
        for name in self.cars:
            if name not in known:
                raise SweepError(
                    f"car {name!r}: is no {self.judged_on} car with this seed; allowed: {', '.join(sorted(known))}"
                )
        return tuple(known[name] for name in self.cars)

    @property
    def training_cars(self) -> tuple[Member, ...]:
        """Cars that candidates are searched on; none of them is a test car."""
        return _first(load_ensemble(self.ensemble).split(self.seed).training, self.training, "training")

    def counts(self, row: Mapping[str, Any]) -> bool:
        """Whether a run is a turn: clean, little roll, out of the turn, and hardly sliding there."""
        if row["outcome"] is None or not is_clean(row) or row["exit_sideslip_rad"] is None:
            return False
        return row["peak_roll_rad"] <= self.most_roll and abs(row["exit_sideslip_rad"]) <= self.most_sideslip

    def course(self, row: Mapping[str, Any]) -> float | None:
        """The measure: the course that was turned, rad; None for a run that does not count."""
        return float(row["course_change_rad"]) if self.counts(row) else None

    def settings(self, who: Candidate, car: Member, speed: float, step: float) -> tuple[str, ...]:
        """Settings of a candidate's turns with a car, a speed (m/s) and a step of the plant (s), but for the floor."""
        own = car.settings_on(self.scenario)
        ballast = () if who.ballast is None else who.ballast(load_scenario(self.scenario, own))
        return (*own, *step_settings(step), *who.at(speed), *ballast, f"{SPEED}={speed!r}")

    def run(self, turn: SteeredTurn, step: float, after: float = AFTER) -> RunTask:
        """A steered turn as a run with a step of the plant (s), which goes on for some time after the steering (s)."""
        who, floor = turn.who, turn.floor
        end = load_scenario(self.scenario).manoeuvre.turn_start + self.pulse + after
        steered = (
            f"manoeuvre.steer_angle={self.search.angle(turn.place)!r}",
            f"manoeuvre.turn_hold={self.pulse!r}",
            f"manoeuvre.duration={end:.9g}",
        )
        settings = (*self.settings(who, floor.car, floor.speed, step), floor.setting, *steered)
        return RunTask(f"{who.name} {floor.car.name} {floor.speed:g}", self.scenario, settings)

    def steered_turn(self, who: Candidate, row: Mapping[Any, Any]) -> SteeredTurn:
        """The turn of a row of the table of cases, with the steering that was proved."""
        car = next(car for car in self.test_cars if car.name == row["car"])
        floor = Floor(car, row["speed_m_per_s"], row["floor"], row["critical_friction"])
        return SteeredTurn(who, floor, self.search.place(math.radians(row["steering_deg"])))


@dataclass(frozen=True)
class Floor:
    """A case: `share` times the critical friction is the friction of the floor. speed: m/s."""

    car: Member
    speed: float
    share: float
    critical: float

    @property
    def friction(self) -> float:
        """Of tyres on the floor."""
        return float(f"{self.share * self.critical:.6g}")

    @property
    def setting(self) -> str:
        """The override that makes the floor."""
        return f"{FRICTION}={self.friction!r}"


@dataclass(frozen=True)
class SteeredTurn:
    """A candidate on a floor, steered: the amplitude by its place on the grid."""

    who: Candidate
    floor: Floor
    place: int


def load_task(name_or_path: str, settings: Sequence[str] = ()) -> Task:
    """A task of `models/tasks`, or of a file.

    Args:
        name_or_path: of the task.
        settings: overrides such as `cars=12` or `speeds=[3.6, 4.5]`.

    Raises:
        UserError: no such task; an unknown key, or a value that is not allowed.
    """
    path = find_file(name_or_path, "tasks", "task", SweepError)
    data = read_yaml(path, SweepError)
    known = [*Task.model_fields]
    for setting in settings:
        key, separator, text = setting.partition("=")
        if not separator or key.strip() not in known or key.startswith("schema"):
            raise SweepError(f"--set {setting}: allowed is KEY=VALUE; {nearest(key.strip(), known[1:])}")
        try:
            data[key.strip()] = yaml.safe_load(text)
        except yaml.YAMLError:
            raise SweepError(f"--set {setting}: {text!r} is not a value") from None
    return checked(Task, data, str(path), SweepError, schema=SCHEMA)


def step_settings(step: float) -> tuple[str, ...]:
    """Settings of a step of the plant, s."""
    return (f"simulation.step={step!r}", f"simulation.log_rate={min(500.0, 1.0 / step):g}")


def find_floors(task: Task, cars: Sequence[Member], runs: Runs) -> tuple[list[Floor], list[str]]:
    """Floors of cars, speeds and shares, and the cars and speeds that have none.

    Raises:
        UserError: none has a floor.
    """
    keys = [(car, speed) for car in cars for speed in task.speeds]
    cases = [Case(THESIS.name, task.scenario, task.settings(THESIS, *key, task.step)) for key in keys]
    starts = [load_scenario(task.scenario, car.settings_on(task.scenario)).car.tyre_friction for car, _ in keys]
    floors, without = [], []
    for (car, speed), found in zip(keys, find_thresholds(cases, FRICTION_CLIMB, runs, starts=starts), strict=True):
        if found.survived is None:
            without.append(f"{car.name} at {speed:g} m/s")
        else:
            floors += [Floor(car, speed, share, found.survived) for share in task.floors]
    if cars and not floors:
        raise SweepError(f"{', '.join(without)}: the published swing at full lock is clean on no floor")
    return floors, without


def _first(there: tuple[Member, ...], number: int, key: str) -> tuple[Member, ...]:
    if not 0 <= number <= len(there):
        raise SweepError(f"{key}: {number}; the ensemble has {len(there)}: allowed: 0 to {len(there)}")
    return there[:number]
