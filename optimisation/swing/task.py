"""Task: the turn of a motion search: training cars on floors, a pulse of steering, and limits of a
turn that counts.

A floor is a multiple of the critical friction of the published swing at full lock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import yaml
from pydantic import Field

from aerodima.optimisation.judge.candidate import THESIS, Candidate, refuse_twice
from aerodima.optimisation.studies.rollover_threshold import (
    FRICTION,
    SPEED,
    Case,
    Search,
    find_thresholds,
)
from aerodima.optimisation.studies.runs import Runs, step_settings
from aerodima.workbench.core.errors import SweepError, UserError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.yaml_files import StrictModel, checked, find_file, read_yaml
from aerodima.workbench.scenario.ensemble import Member, load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario

SCHEMA = "aerodima/task/1"
PULSE = 0.5
"""Length of the steering unless another is asked for, s."""
AFTER = 1.5
"""How long a run goes on after the steering, s."""
MOST_ROLL = 0.35
"""Outwards from the turn on, rad."""
MOST_SIDESLIP = 0.1
"""To either side at the exit, rad."""
FRICTION_CLIMB = Search(FRICTION, 0.3, 1.3, 0.05, 0.0125)
"""Scan of the friction coefficient; the last two numbers are its steps, coarse and fine."""


class Task(StrictModel):
    """What is asked; a file of `models/tasks`.

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
    ensemble: str = "car"
    seed: int = Field(default=1, ge=0)
    training: int = Field(default=4, ge=0)
    speeds: list[float] = Field(default=[4.5], min_length=1)
    floors: list[float] = Field(default=[1.1, 1.3], min_length=1)
    pulse: float = Field(default=PULSE, ge=0.1, le=2.0)
    steering: tuple[float, float] = (2.0, 30.0)
    most_roll: float = Field(default=MOST_ROLL, gt=0.0, le=1.5)
    most_sideslip: float = Field(default=MOST_SIDESLIP, gt=0.0, le=1.5)
    step: float = Field(default=0.002, gt=0.0, le=0.005)

    def model_post_init(self, _context: Any) -> None:
        """Raises `SweepError` for what no single value says: numbers named twice, a scenario
        without such a turn.
        """
        for name, values, low, high in (
            ("speed", self.speeds, 1.0, 8.0),
            ("floor", self.floors, 0.2, 3.0),
        ):
            refuse_twice([f"{value:g}" for value in values], name)
            for value in values:
                if not low <= value <= high:
                    raise SweepError(f"{name} {value:g}: allowed: {low:g} to {high:g}")
        least, largest = self.steering
        if not 0.0 < least < largest:
            raise SweepError(
                f"steering {least:g} to {largest:g} degrees: allowed: 0 < first < second"
            )
        try:
            turn = load_scenario(
                self.scenario, [f"manoeuvre.steer_angle={math.radians(largest)!r}"]
            ).manoeuvre
        except UserError as error:
            raise SweepError(f"task: {error}") from None
        if turn.kind != "turn":
            raise SweepError(f"{self.scenario}: manoeuvre.kind {turn.kind}; allowed: turn")
        if turn.turns != 1:
            raise SweepError(f"{self.scenario}: manoeuvre.turns {turn.turns}; allowed: 1")

    @property
    def training_cars(self) -> tuple[Member, ...]:
        """Cars that motions are searched on; SweepError for more than there are."""
        there = load_ensemble(self.ensemble).split(self.seed).training
        if self.training > len(there):
            raise SweepError(
                f"training: {self.training}; the ensemble has {len(there)}: allowed: 0 to "
                f"{len(there)}"
            )
        return there[: self.training]

    def settings(self, who: Candidate, car: Member, speed: float) -> tuple[str, ...]:
        """Settings of a candidate's turns with a car and a speed (m/s), but for the floor."""
        own = car.settings_on(self.scenario)
        return (*own, *step_settings(self.step), *who.at(speed), f"{SPEED}={speed!r}")


@dataclass(frozen=True)
class Floor:
    """A case: `share` times the critical friction is the friction of the floor. speed: m/s."""

    car: Member
    speed: float
    share: float
    critical: float

    @property
    def friction(self) -> float:
        """Friction of tyres on the floor."""
        return float(f"{self.share * self.critical:.6g}")

    @property
    def setting(self) -> str:
        """The override that makes the floor."""
        return f"{FRICTION}={self.friction!r}"


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
            raise SweepError(
                f"--set {setting}: allowed is KEY=VALUE; {nearest(key.strip(), known[1:])}"
            )
        try:
            data[key.strip()] = yaml.safe_load(text)
        except yaml.YAMLError:
            raise SweepError(f"--set {setting}: {text!r} is not a value") from None
    return checked(Task, data, str(path), SweepError, schema=SCHEMA)


def find_floors(task: Task, cars: Sequence[Member], runs: Runs) -> tuple[list[Floor], list[str]]:
    """Floors of cars, speeds and shares, and the cars and speeds that have none.

    Raises:
        UserError: none has a floor.
    """
    keys = [(car, speed) for car in cars for speed in task.speeds]
    cases = [Case(THESIS.name, task.scenario, task.settings(THESIS, *key)) for key in keys]
    starts = [
        load_scenario(task.scenario, car.settings_on(task.scenario)).car.tyre_friction
        for car, _ in keys
    ]
    floors = []
    without = []
    for (car, speed), found in zip(
        keys, find_thresholds(cases, FRICTION_CLIMB, runs, starts=starts), strict=True
    ):
        if found.survived is None:
            without.append(f"{car.name} at {speed:g} m/s")
        else:
            floors += [Floor(car, speed, share, found.survived) for share in task.floors]
    if cars and not floors:
        raise SweepError(
            f"{', '.join(without)}: the published swing at full lock is clean on no floor"
        )
    return floors, without
