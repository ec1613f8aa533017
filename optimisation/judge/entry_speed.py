"""Entry speed: the highest speed at which a car, on a floor and with a tail, completes a manoeuvre.

A manoeuvre is completed where no two wheels of one side are more than `TWO_WHEELS` above the ground
at a time, nothing but wheels touches it from the start of the steering on (the anti-ramp board:
while the car is steered; it catches a car that gathers speed again), and the car survives. On a
path, the path is kept to its end. Elsewhere the car goes straight again: it yaws at most
`EXIT_YAW_RATE` at the end of the run, unless it is steered there. And the mean lateral acceleration
of the course, while the car is steered, is at least `LEAST_SHARE` of the most that the candidate
without tail reaches up to its own entry speed, so that a tail gains nothing by keeping the car from
turning.

A climb begins at a low speed and goes up in steps to the first failure, goes down first if the
start itself fails, and halves its last step. The lateral acceleration is small at low speeds, so
that every climb begins below the limit. Too low a value is therefore a failure only above a speed
at which the manoeuvre was completed; below that the climb passes it, as neither completed nor
failed.

Climbs are driven at the ordinary step of the plant; the speed that is found is proved at the fine
one, and lowered until it is borne out. What is run depends on neither the engine nor the other
climbs, but for the reference.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import pandas as pd

from aerodima.optimisation.judge.candidate import NO_TAIL, Candidate, refuse_twice
from aerodima.optimisation.studies.rollover_threshold import SPEED, rounded
from aerodima.optimisation.studies.runs import FINE_STEP, Runs, RunTask, make_frame, step_settings
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.car.chassis_actuators import steady_speed
from aerodima.workbench.car.verdict import EXIT_YAW_RATE, TWO_WHEELS
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import Member
from aerodima.workbench.scenario.scenario import load_scenario

LEAST_SHARE = 0.9
"""Share of the tailless car's lateral acceleration that a candidate must reach."""
STEP = 0.002
"""Step of the plant in a climb, s."""
MOST_BACK = 8
"""How often a speed is lowered at most when the fine step does not bear it out."""
OFF_PATH = "off_path_m"
"""Column of a run on a path: how far it leaves its lane, m, not above 0 where it keeps to it."""
PATH_END = "path_end_reached"
"""Column of a run on a path: whether it gets to the end."""
ERROR = "error: "
"""Begins what failed in a run that came to nothing."""
NOT_PROVED = "not proved"
"""Begins what ended a climb whose speed the fine step bore out nowhere in `MOST_BACK` tries."""
NO_REFERENCE = "no reference"
"""Ends a climb with nothing to compare: the car without tail has no entry speed there."""


@dataclass(frozen=True)
class Manoeuvre:
    """What is driven.

    Attributes:
        name: in tables.
        scenario: name or path.
        settings: overrides of it.
        rule: what the manoeuvre asks beside staying upright: enough lateral acceleration, or a path
            that is kept.
        drivers: overrides of drivers; a speed is completed where one of them completes it.
    """

    name: str
    scenario: str
    settings: tuple[str, ...] = ()
    rule: Literal["lateral", "path"] = "lateral"
    drivers: tuple[tuple[str, ...], ...] = ((),)


@dataclass(frozen=True)
class EntryFloor:
    """A floor: its name in tables, and the settings that make it; none of them leaves the friction
    to the car.
    """

    name: str
    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class EntrySearch:
    """How an entry speed is searched for; all in m/s, and all but `fine` multiples of `fine`.

    Attributes:
        start: first speed of a climb.
        step: between two speeds on the way.
        fine: to which the entry speed is found.
        ceiling: highest speed that is tried.
        lowest: that is tried.

    Raises:
        SweepError: a speed that is no multiple, or speeds out of order.
    """

    start: float = 2.0
    step: float = 0.1
    fine: float = 0.05
    ceiling: float = 8.0
    lowest: float = 1.0

    def __post_init__(self) -> None:
        fine = self.fine
        if not 0.0 < fine <= self.step or not 0.0 < self.lowest <= self.start <= self.ceiling:
            raise SweepError(
                f"start {self.start:g}, step {self.step:g}, ceiling {self.ceiling:g} m/s: allowed: "
                f"step from {fine:g} m/s on, and {self.lowest:g} <= start <= ceiling"
            )
        for name in ("start", "step", "ceiling", "lowest"):
            value = getattr(self, name)
            if not math.isclose(value, rounded(fine * round(value / fine)), rel_tol=1e-9):
                raise SweepError(
                    f"entry speed: {name} {value:g}; allowed: multiples of fine, {fine:g}"
                )

    def following(self, found: Mapping[float, str]) -> float | None:
        """Next speed of a climb, m/s; None at its end.

        Args:
            found: speed, m/s -> what failed there (`failed_rule`), empty where the manoeuvre was
                completed.
        """
        passed, lost = self.bracket(found)
        if not found:
            speed = self.start
        elif lost is None:
            speed = min(max(found) + self.step, self.ceiling)
        elif passed is None:
            speed = max(lost - self.step, self.lowest)
        else:
            speed = passed + self.fine * (round((lost - passed) / self.fine) // 2)
        following = rounded(speed)
        return None if following in found else following

    def bracket(self, found: Mapping[float, str]) -> tuple[float | None, float | None]:
        """Last speed before the first failure, and that of the failure, m/s; `lateral` fails above
        a completion.
        """
        passed = None
        completed = False
        for speed in sorted(found):
            failed = found[speed]
            if failed and (completed or failed != "lateral"):
                return passed, speed
            passed = speed
            completed = completed or not failed
        return passed, None

    def entry(self, found: Mapping[float, str]) -> float | None:
        """Entry speed of a climb that has ended, m/s; None if completed at no speed."""
        passed, _ = self.bracket(found)
        if passed is None or found[passed]:
            return None
        return passed

    def ended_by(self, found: Mapping[float, str]) -> str:
        """What ended a climb; `lateral` where the lateral acceleration was always too low, empty at
        the ceiling.
        """
        passed, lost = self.bracket(found)
        failed = "" if lost is None else found[lost]
        if passed is not None and found[passed] and not failed.startswith(ERROR):
            return "lateral"  # it was never enough
        return failed

    def proving(self, entry: float | None, found: Mapping[float, str]) -> float | None:
        """Next speed that is tried at the fine step, m/s; None at the end.

        Args:
            entry: that the climb found, m/s, if any.
            found: what failed at the fine step, as in `following`.
        """
        if entry is None or len(found) > MOST_BACK or "" in found.values():
            return None
        speed = rounded(entry - self.fine * len(found))
        return speed if speed >= self.lowest else None


def failed_rule(
    row: Mapping[str, Any], rule: Literal["lateral", "path"], figure: float, least: float
) -> str:
    """First rule that a run breaks; empty where it breaks none.

    It is `two wheels`, `ground: PART`, `flipped`, `path`, `end of the path` (too slow), `exit`,
    `lateral` or `error: ...`.

    Args:
        row: of the run.
        rule: of its manoeuvre.
        figure: mean lateral acceleration of the run, m/s2; NaN where it has none.
        least: that is enough, m/s2; -inf for the candidate without tail.
    """
    if row["outcome"] is None:
        return f"{ERROR}{row['error']}"
    lacking = [name for name in ("side_lift_m", "touched_when_steered") if row.get(name) is None]
    if rule == "path":
        lacking += [name for name in (OFF_PATH, PATH_END) if name not in row]
    if lacking:
        return f"{ERROR}the row has no {', '.join(lacking)}"
    broken = {
        "two wheels": row["side_lift_m"] > TWO_WHEELS,
        f"ground: {row['touched_when_steered']}": bool(row["touched_when_steered"]),
        "flipped": row["outcome"] != "survived",
    }
    if rule == "path":
        off = row[OFF_PATH]
        broken["path"] = off is None or not off <= 0.0
        broken["end of the path"] = not row[PATH_END]
    else:
        last = row.get("last_yaw_rate_rad_per_s")
        broken["exit"] = last is not None and not abs(last) <= EXIT_YAW_RATE
        broken["lateral"] = not figure >= least
    return next((name for name, is_broken in broken.items() if is_broken), "")


class _Run(NamedTuple):
    """What failed in a run, mean lateral acceleration, m/s2, change of course, rad (NaN without),
    and its driver.
    """

    failed: str
    figure: float
    course: float = math.nan
    driver: str = ""


@dataclass
class _Climb:
    """One climb: who drives what and where, and its runs by speed, m/s, at the ordinary and at the
    fine step.

    The drivers of a manoeuvre try a speed in turn, the last one that completed a speed first.
    """

    manoeuvre: Manoeuvre
    who: Candidate
    car: Member
    floor: EntryFloor
    search: EntrySearch
    least: float = -math.inf
    coarse: dict[float, _Run] = field(default_factory=dict)
    fine: dict[float, _Run] = field(default_factory=dict)
    driver: int = 0
    failures: int = 0

    @cached_property
    def without_tail(self) -> tuple[str, ...]:
        """Settings of car, manoeuvre and floor."""
        return (
            *self.car.settings_on(self.manoeuvre.scenario),
            *self.manoeuvre.settings,
            *self.floor.settings,
        )

    @cached_property
    def ballast(self) -> tuple[str, ...]:
        """Settings that the candidate has for this car."""
        if self.who.ballast is None:
            return ()
        return self.who.ballast(load_scenario(self.manoeuvre.scenario, self.without_tail))

    def below_top_speed(self) -> _Climb:
        """The same, its ceiling no higher than the drive gets."""
        drive = load_scenario(self.manoeuvre.scenario, self.without_tail).drive
        fine = self.search.fine
        top = rounded(fine * math.floor(steady_speed(1.0, drive) / fine + 1e-9))
        return replace(self, search=replace(self.search, ceiling=min(self.search.ceiling, top)))

    def task(self, speed: float, step: float) -> RunTask:
        """A run at a speed, m/s, with a step of the plant, s."""
        tail = (*self.who.at(speed), *self.ballast)
        driver = self.manoeuvre.drivers[self.driver]
        settings = (*self.without_tail, *driver, *step_settings(step), *tail, f"{SPEED}={speed!r}")
        name = f"{self.manoeuvre.name} {self.who.name} {self.car.name} {self.floor.name} {speed:g}"
        return RunTask(name, self.manoeuvre.scenario, settings, law=self.who.law)

    def note(self, kept: dict[float, _Run], speed: float, row: Mapping[str, Any]) -> None:
        """Keeps what the row of a run comes to if it is completed, or no driver is left."""
        figure = _number(row.get("lateral_acceleration_m_per_s2"))
        course = _number(row.get("course_change_rad"))
        drivers = self.manoeuvre.drivers
        failed = failed_rule(row, self.manoeuvre.rule, figure, self.least)
        run = _Run(failed, figure, course, " ".join(drivers[self.driver]))
        self.failures += 1
        if failed:
            self.driver = (self.driver + 1) % len(drivers)
        if not failed or self.failures == len(drivers):
            kept[speed] = run
            self.failures = 0

    def climbing(self) -> float | None:
        """Next speed at the ordinary step, m/s."""
        if math.isnan(self.least):
            return None
        return self.search.following(_failures(self.coarse))

    def proving(self) -> float | None:
        """Next speed at the fine step, m/s."""
        return self.search.proving(self.found, _failures(self.fine))

    @property
    def found(self) -> float | None:
        """Entry speed at the ordinary step, m/s."""
        return self.search.entry(_failures(self.coarse))

    @property
    def proved(self) -> float | None:
        """Entry speed that the fine step bears out, m/s."""
        return next((speed for speed, run in self.fine.items() if not run.failed), None)

    @property
    def figure(self) -> float:
        """Mean lateral acceleration at the entry speed, m/s2; NaN without one."""
        proved = self.proved
        if proved is None:
            return math.nan
        return self.fine[proved].figure

    @property
    def most(self) -> float:
        """Largest mean lateral acceleration at the completed speeds up to the entry speed, m/s2;
        NaN without one.
        """
        proved = self.proved
        if proved is None:
            return math.nan
        figures = [self.figure]
        for speed, run in self.coarse.items():
            if speed <= proved and not run.failed:
                figures.append(run.figure)
        return max(figures)

    def as_row(self) -> Row:
        """The row of the table, see `climb`."""
        failures = [run.failed for run in self.fine.values() if run.failed]
        if failures:
            ended_by = failures[-1]
        else:
            ended_by = self.search.ended_by(_failures(self.coarse))
        found = self.found
        proved = self.proved
        if proved is None:
            run = _Run("", math.nan)
            if found is not None:
                ended_by = f"{NOT_PROVED}: {ended_by}"
        else:
            run = self.fine[proved]
        if math.isnan(self.least):
            ended_by = NO_REFERENCE
        return {
            "manoeuvre": self.manoeuvre.name,
            "candidate": self.who.name,
            "car": self.car.name,
            "floor": self.floor.name,
            "entry_speed_m_per_s": _number(proved),
            "at_ceiling": proved == self.search.ceiling,
            "ended_by": ended_by,
            "figure_m_per_s2": run.figure,
            "course_change_rad": run.course,
            "proved": proved is not None,
            "found_m_per_s": _number(found),
            "driver": run.driver,
            "runs": len(self.coarse) + len(self.fine),
        }


def climb(
    manoeuvres: Sequence[Manoeuvre],
    candidates: Sequence[Candidate],
    cases: Sequence[tuple[Member, EntryFloor]],
    runs: Runs,
    search: EntrySearch | None = None,
) -> pd.DataFrame:
    """Entry speeds of every candidate in every manoeuvre, car and floor; the car without tail is
    always among them.

    It climbs first, since its figures are what the others are held to; they climb together.

    Args:
        manoeuvres: what is driven.
        candidates: tails.
        cases: cars with their floors.
        runs: where they are made; each run is made once.
        search: of all of them, by default `EntrySearch()`.

    Returns:
        A row per climb: manoeuvre, candidate, car, floor; `entry_speed_m_per_s` as the fine step
        bears it out, NaN without; `at_ceiling`; `ended_by`, what failed first (`failed_rule`), or,
        where the fine step lowered the speed, what failed last there; at the entry speed
        `figure_m_per_s2`, mean lateral acceleration, and `course_change_rad` of a turn; `proved`;
        `found_m_per_s` at the ordinary step; number of `runs`. A run that comes to nothing fails
        and is named.

    Raises:
        UserError: a name twice, or a car that a scenario does not load.
    """
    refuse_twice([one.name for one in manoeuvres], "manoeuvre")
    refuse_twice([one.name for one in candidates], "candidate")
    refuse_twice([f"{car.name} on {floor.name}" for car, floor in cases], "case")
    search = search or EntrySearch()
    places = [(manoeuvre, car, floor) for manoeuvre in manoeuvres for car, floor in cases]
    references = [
        _Climb(what, NO_TAIL, car, floor, search).below_top_speed() for what, car, floor in places
    ]
    _drive(references, runs, NO_TAIL.name)
    climbs = []
    others = []
    for reference in references:
        if reference.manoeuvre.rule == "lateral":
            share = LEAST_SHARE * reference.most
        else:
            share = -math.inf
        own = [
            replace(reference, who=who, least=share, coarse={}, fine={}, driver=0)
            for who in candidates
            if who.name != NO_TAIL.name
        ]
        climbs += [reference, *own]
        others += own
    _drive(others, runs, "tails")
    return make_frame([one.as_row() for one in climbs])


def _drive(climbs: Sequence[_Climb], runs: Runs, stage: str) -> None:
    """Drives climbs to their end, then their proofs: one run of each at a time; many climbs keep
    all workers busy.
    """

    def rounds(
        following: Callable[[_Climb], float | None], step: float, kept: Literal["coarse", "fine"]
    ) -> None:
        while True:
            speeds = [(one, following(one)) for one in climbs]
            wanted = [(one, speed) for one, speed in speeds if speed is not None]
            if not wanted:
                return
            rows = runs.rows([one.task(speed, step) for one, speed in wanted])
            for (one, speed), row in zip(wanted, rows, strict=True):
                one.note(getattr(one, kept), speed, row)

    runs.stage = stage
    rounds(_Climb.climbing, STEP, "coarse")
    runs.stage = f"{stage}, fine step"
    rounds(_Climb.proving, FINE_STEP, "fine")


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _failures(found: Mapping[float, _Run]) -> dict[float, str]:
    return {speed: run.failed for speed, run in found.items()}
