"""Task: the turn of a motion search: training cars on surfaces, a pulse of steering, and limits of
a turn that counts.

The friction of a surface is a multiple of the critical friction of the published swing at full
lock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import yaml
from pydantic import Field

from aerodima.optimisation.judge.candidate import THESIS, Candidate, require_unique
from aerodima.optimisation.studies.limit_search import LimitSearch
from aerodima.optimisation.studies.rollover_threshold import (
    FRICTION,
    SPEED,
    Case,
    find_thresholds,
)
from aerodima.optimisation.studies.runs import CachedRunner, step_settings
from aerodima.workbench.core.errors import SweepError, UserError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.core.yaml_files import (
    StrictModel,
    checked,
    find_file,
    parse_yaml,
    read_yaml,
)
from aerodima.workbench.scenario.ensemble import Member, load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario

SCHEMA = "aerodima/task/1"
PULSE = 0.5
"""Length of the steering unless another is asked for, s."""
RUN_OUT_TIME = 1.5
"""How long a run goes on after the steering, s."""
MAX_ROLL = 0.35
"""Outwards from the turn on, rad."""
MAX_SIDESLIP = 0.1
"""To either side at the exit, rad."""
SURFACE_SEARCH = LimitSearch(FRICTION, 0.3, 1.3, 0.05, 0.0125)
"""Scan of the friction coefficient; the last two numbers are its steps, coarse and fine."""


class Task(StrictModel):
    """Task of a motion search; a file of `models/tasks`.

    Attributes:
        scenario: of the turn, with its tail.
        ensemble: of cars, split by `seed`; `training` so many of the training cars.
        speeds: m/s.
        floors: friction over the critical friction of the published swing at full lock.
        pulse: length of the steering, s.
        steering: least and largest amplitude, degrees.
        most_roll, most_sideslip: of a turn that counts, rad: outwards, and to either side at the
            exit.
        step: of the plant in the search of a floor, s.
    """

    schema_: Literal["aerodima/task/1"] = Field(default="aerodima/task/1", alias="schema")
    scenario: str = "turn_fast"
    ensemble: str = "physical"
    seed: int = Field(default=1, ge=0)
    training: int = Field(default=4, ge=0)
    speeds: list[float] = Field(default=[4.5], min_length=1)
    floors: list[float] = Field(default=[1.1, 1.3], min_length=1)
    pulse: float = Field(default=PULSE, ge=0.1, le=2.0)
    steering: tuple[float, float] = (2.0, 30.0)
    most_roll: float = Field(default=MAX_ROLL, gt=0.0, le=1.5)
    most_sideslip: float = Field(default=MAX_SIDESLIP, gt=0.0, le=1.5)
    step: float = Field(default=0.002, gt=0.0, le=0.005)

    def model_post_init(self, _context: Any) -> None:
        """Raises `SweepError` for what no single value says: numbers named twice, a scenario
        without such a turn.
        """
        for name, values, low, high in (
            ("speed", self.speeds, 1.0, 8.0),
            ("floor", self.floors, 0.2, 3.0),
        ):
            require_unique([f"{value:g}" for value in values], name)
            for value in values:
                check_range(name, value, low, high, NO_UNIT, error=SweepError)
        low, high = self.steering
        if not 0.0 < low < high:
            raise SweepError(f"steering {low:g} to {high:g} degrees: must be 0 < first < second")
        try:
            full_lock = f"manoeuvre.steer_angle={math.radians(high)!r}"
            turn = load_scenario(self.scenario, [full_lock]).manoeuvre
        except UserError as error:
            raise SweepError(f"task: {error}") from None
        for key, expected in (("kind", "turn"), ("turns", 1)):
            given = getattr(turn, key)
            if given != expected:
                raise SweepError(f"{self.scenario}: manoeuvre.{key} {given}; must be {expected}")

    @property
    def training_cars(self) -> tuple[Member, ...]:
        """Cars that motions are searched on; SweepError for more than there are."""
        there = load_ensemble(self.ensemble).split(self.seed).training
        if self.training > len(there):
            raise SweepError(
                f"training: {self.training}; the ensemble has {len(there)}: must be 0 to "
                f"{len(there)}"
            )
        return there[: self.training]

    def settings(self, candidate: Candidate, car: Member, speed: float) -> tuple[str, ...]:
        """Returns the settings of a candidate's turns with a car and a speed (m/s), but for the
        surface.
        """
        own = car.settings_on(self.scenario)
        return (*own, *step_settings(self.step), *candidate.at(speed), f"{SPEED}={speed!r}")


@dataclass(frozen=True)
class TaskSurface:
    """Surface of a car at a speed, m/s, whose friction is `share` times the critical one."""

    car: Member
    speed: float
    share: float
    critical: float

    @property
    def friction(self) -> float:
        """Friction of tyres on the surface."""
        return float(f"{self.share * self.critical:.6g}")

    @property
    def setting(self) -> str:
        """Override that makes the surface."""
        return f"{FRICTION}={self.friction!r}"


def load_task(name_or_path: str, settings: Sequence[str] = ()) -> Task:
    """Loads a task of `models/tasks`, or of a file.

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
            raise SweepError(
                f"--set {setting}: must be KEY=VALUE; {nearest(key.strip(), known[1:])}"
            )
        try:
            data[key.strip()] = parse_yaml(text)
        except yaml.YAMLError:
            raise SweepError(f"--set {setting}: {text!r} is not a value") from None
    return checked(Task, data, str(path), SweepError, schema=SCHEMA)


def find_surfaces(
    task: Task, cars: Sequence[Member], runs: CachedRunner
) -> tuple[list[TaskSurface], list[str]]:
    """Finds the surfaces of cars, speeds and friction scales, and the cars and speeds that have
    none.

    Raises:
        UserError: none has a floor.
    """
    cases = []
    starts = []
    keys = []
    for car in cars:
        own = load_scenario(task.scenario, car.settings_on(task.scenario))
        for speed in task.speeds:
            keys.append((car, speed))
            cases.append(Case(THESIS.name, task.scenario, task.settings(THESIS, car, speed)))
            starts.append(own.car.tyre_friction)
    thresholds = find_thresholds(cases, SURFACE_SEARCH, runs, starts=starts)
    surfaces = []
    without = []
    for (car, speed), threshold in zip(keys, thresholds, strict=True):
        critical = threshold.survived
        if critical is None:
            without.append(f"{car.name} at {speed:g} m/s")
        else:
            surfaces += [TaskSurface(car, speed, share, critical) for share in task.floors]
    if cars and not surfaces:
        raise SweepError(
            f"{', '.join(without)}: the published swing at full lock is clean on no floor"
        )
    return surfaces, without
