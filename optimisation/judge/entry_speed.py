"""Entry speed: the highest speed at which a car, on a surface and with a tail, completes a
manoeuvre (`entry_rule`).

A tail must turn as much as the car without one: its mean lateral acceleration is compared with the
largest that the candidate without tail reaches up to its own entry speed, so that a tail gains
nothing by keeping the car from turning.

Climbs (`entry_search`) are driven at the ordinary step of the plant; the speed that is found is
confirmed at the fine one, and lowered until it is. What is run depends on neither the engine nor
the other climbs, but for the reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import pandas as pd

from aerodima.optimisation.judge.candidate import NO_TAIL, Candidate, require_unique
from aerodima.optimisation.judge.entry_rule import MIN_LATERAL_SHARE, Rule, failed_rule
from aerodima.optimisation.judge.entry_search import EntrySearch
from aerodima.optimisation.studies.limit_search import rounded, run_rounds
from aerodima.optimisation.studies.rollover_threshold import SPEED
from aerodima.optimisation.studies.runs import (
    FINE_STEP,
    CachedRunner,
    RunTask,
    make_frame,
    step_settings,
)
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.car.laws import steady_speed
from aerodima.workbench.car.reduced.rollout import STEP
from aerodima.workbench.core.file_reading import Facts
from aerodima.workbench.scenario.ensemble import Member
from aerodima.workbench.scenario.scenario import load_scenario

NOT_CONFIRMED = "not proved"
"""Begins `ended_by` of a climb whose speed the fine step confirmed nowhere in `MAX_STEP_BACKS`
tries."""
NO_REFERENCE = "no reference"
"""Ends a climb with nothing to compare: the car without tail has no entry speed there."""


@dataclass(frozen=True)
class Manoeuvre:
    """Manoeuvre of a suite.

    Attributes:
        name: in tables.
        scenario: name or path.
        settings: overrides of it.
        rule: condition beside staying upright.
        drivers: overrides of drivers; a speed is completed where one of them completes it.
    """

    name: str
    scenario: str
    settings: tuple[str, ...] = ()
    rule: Rule = "lateral"
    drivers: tuple[tuple[str, ...], ...] = ((),)


@dataclass(frozen=True)
class Surface:
    """Surface that is driven on.

    Attributes:
        name: in tables.
        settings: that make it; none of them leaves the friction to the car.
    """

    name: str
    settings: tuple[str, ...] = ()


Case = tuple[Member, Surface]
"""A car on a surface."""


class _Run(NamedTuple):
    """Result of a run: failed rule, mean lateral acceleration, m/s2, change of course, rad (NaN
    without), driver.
    """

    failed: str
    lateral: float
    course: float = math.nan
    driver: str = ""


@dataclass
class _Climb:
    """One climb: candidate, manoeuvre and case, and its runs by the step of the plant, s, and by
    speed, m/s.

    The drivers of a manoeuvre try a speed in turn, the last one that completed a speed first.
    """

    manoeuvre: Manoeuvre
    candidate: Candidate
    car: Member
    surface: Surface
    search: EntrySearch
    min_lateral: float = -math.inf
    runs: dict[float, dict[float, _Run]] = field(default_factory=lambda: {STEP: {}, FINE_STEP: {}})
    driver: int = 0
    attempts: int = 0

    @cached_property
    def without_tail(self) -> tuple[str, ...]:
        """Settings of car, manoeuvre and surface."""
        car = self.car.settings_on(self.manoeuvre.scenario)
        return (*car, *self.manoeuvre.settings, *self.surface.settings)

    @cached_property
    def ballast(self) -> tuple[str, ...]:
        """Settings that the candidate has for this car."""
        if self.candidate.ballast is None:
            return ()
        return self.candidate.ballast(load_scenario(self.manoeuvre.scenario, self.without_tail))

    def below_top_speed(self) -> _Climb:
        """Returns the same climb, its ceiling no higher than the drive gets."""
        drive = load_scenario(self.manoeuvre.scenario, self.without_tail).drive
        search = self.search
        top = rounded(search.fine * math.floor(steady_speed(1.0, drive) / search.fine + 1e-9))
        return replace(self, search=replace(search, ceiling=min(search.ceiling, top)))

    def task(self, speed: float, step: float) -> RunTask:
        """Returns the run at a speed, m/s, with a step of the plant, s."""
        manoeuvre = self.manoeuvre
        candidate = self.candidate
        driver = manoeuvre.drivers[self.driver]
        tail = (*candidate.at(speed), *self.ballast)
        settings = (*self.without_tail, *driver, *step_settings(step), *tail, f"{SPEED}={speed!r}")
        names = (manoeuvre.name, candidate.name, self.car.name, self.surface.name, f"{speed:g}")
        return RunTask(" ".join(names), manoeuvre.scenario, settings, law=candidate.law)

    def record(self, speed: float, step: float, row: Facts) -> None:
        """Keeps the result of a run if it is completed, or no driver is left."""
        lateral = _number(row.get("lateral_acceleration_m_per_s2"))
        course = _number(row.get("course_change_rad"))
        drivers = self.manoeuvre.drivers
        failed = failed_rule(row, self.manoeuvre.rule, lateral, self.min_lateral)
        run = _Run(failed, lateral, course, " ".join(drivers[self.driver]))
        self.attempts += 1
        if failed:
            self.driver = (self.driver + 1) % len(drivers)
        if not failed or self.attempts == len(drivers):
            self.runs[step][speed] = run
            self.attempts = 0

    def failures(self, step: float) -> dict[float, str]:
        """Returns speed, m/s -> failed rule of the runs at a step of the plant, s."""
        return {speed: run.failed for speed, run in self.runs[step].items()}

    def next_speeds(self, step: float) -> list[float]:
        """Returns the next speed at a step of the plant, m/s; none at the end."""
        failures = self.failures(step)
        if step == FINE_STEP:
            return self.search.next_confirmations(self.coarse_speed, failures)
        if math.isnan(self.min_lateral):
            return []
        return self.search.next_speeds(failures)

    @property
    def coarse_speed(self) -> float | None:
        """Entry speed at the ordinary step, m/s."""
        return self.search.entry_speed(self.failures(STEP))

    @property
    def entry_speed(self) -> float | None:
        """Entry speed that the fine step confirms, m/s."""
        failures = self.failures(FINE_STEP)
        return next((speed for speed, failed in failures.items() if not failed), None)

    @property
    def max_lateral(self) -> float:
        """Largest mean lateral acceleration at the completed speeds up to the entry speed, m/s2;
        NaN without one.
        """
        entry = self.entry_speed
        if entry is None:
            return math.nan
        values = [self.runs[FINE_STEP][entry].lateral]
        for speed, run in self.runs[STEP].items():
            if speed <= entry and not run.failed:
                values.append(run.lateral)
        return max(values)

    def ended_by(self) -> str:
        """Returns what ended the climb, see `find_entry_speeds`."""
        if math.isnan(self.min_lateral):
            return NO_REFERENCE
        ended_by = self.search.ended_by(self.failures(STEP))
        for failed in self.failures(FINE_STEP).values():
            ended_by = failed or ended_by
        if self.entry_speed is None and self.coarse_speed is not None:
            return f"{NOT_CONFIRMED}: {ended_by}"
        return ended_by

    def as_row(self) -> Row:
        """Returns the row of the table, see `find_entry_speeds`."""
        entry = self.entry_speed
        run = _Run("", math.nan)
        if entry is not None:
            run = self.runs[FINE_STEP][entry]
        return {
            "manoeuvre": self.manoeuvre.name,
            "candidate": self.candidate.name,
            "car": self.car.name,
            "floor": self.surface.name,
            "entry_speed_m_per_s": _number(entry),
            "at_ceiling": entry == self.search.ceiling,
            "ended_by": self.ended_by(),
            "figure_m_per_s2": run.lateral,
            "course_change_rad": run.course,
            "proved": entry is not None,
            "found_m_per_s": _number(self.coarse_speed),
            "driver": run.driver,
            "runs": sum(map(len, self.runs.values())),
        }


def find_entry_speeds(
    manoeuvres: Sequence[Manoeuvre],
    candidates: Sequence[Candidate],
    cases: Sequence[Case],
    runs: CachedRunner,
    search: EntrySearch | None = None,
) -> pd.DataFrame:
    """Finds the entry speeds of every candidate in every manoeuvre and case; the car without tail
    is always among them.

    It climbs first, since the others are compared with its lateral acceleration; they climb
    together.

    Args:
        manoeuvres: what is driven.
        candidates: tails.
        cases: cars with their surfaces.
        runs: where they are made; each run is made once.
        search: of all of them, by default `EntrySearch()`.

    Returns:
        A row per climb: manoeuvre, candidate, car, floor; `entry_speed_m_per_s` as confirmed at the
        fine step, NaN without; `at_ceiling`; `ended_by`, what failed first (`failed_rule`), or,
        where the fine step lowered the speed, what failed last there; at the entry speed
        `figure_m_per_s2`, mean lateral acceleration, and `course_change_rad` of a turn; `proved`;
        `found_m_per_s` at the ordinary step; number of `runs`. A run without outcome fails and is
        named.

    Raises:
        UserError: a name twice, or a car that a scenario does not load.
    """
    require_unique([one.name for one in manoeuvres], "manoeuvre")
    require_unique([one.name for one in candidates], "candidate")
    require_unique([f"{car.name} on {surface.name}" for car, surface in cases], "case")
    search = search or EntrySearch()
    references = []
    for manoeuvre in manoeuvres:
        for car, surface in cases:
            climb = _Climb(manoeuvre, NO_TAIL, car, surface, search)
            references.append(climb.below_top_speed())
    _drive(references, runs, NO_TAIL.name)
    climbs = []
    with_tail = []
    for reference in references:
        climbs.append(reference)
        min_lateral = -math.inf
        if reference.manoeuvre.rule == "lateral":
            min_lateral = MIN_LATERAL_SHARE * reference.max_lateral
        for candidate in candidates:
            if candidate.name != NO_TAIL.name:
                case = (reference.car, reference.surface, reference.search)
                climb = _Climb(reference.manoeuvre, candidate, *case, min_lateral)
                climbs.append(climb)
                with_tail.append(climb)
    _drive(with_tail, runs, "tails")
    return make_frame([climb.as_row() for climb in climbs])


def _drive(climbs: Sequence[_Climb], runs: CachedRunner, stage: str) -> None:
    """Drives climbs to their end, then confirms them: one run of each at a time."""

    def drive(step: float) -> None:
        run_rounds(
            climbs,
            lambda climb: climb.next_speeds(step),
            lambda wanted: runs.rows([climb.task(speed, step) for climb, speed in wanted]),
            lambda climb, speed, row: climb.record(speed, step, row),
        )

    runs.stage = stage
    drive(STEP)
    runs.stage = f"{stage}, fine step"
    drive(FINE_STEP)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
