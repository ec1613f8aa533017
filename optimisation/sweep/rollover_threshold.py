"""Where a car begins to roll over: highest speed survived at given grip, critical friction at given speed.

Survival is not monotone (design section 7): beyond the first speed at which the car flips there may be islands of
speeds that it survives again. So a range is scanned first, the step from survival to the first flip is then narrowed
down, and survivors beyond it are reported as islands instead of taken for the threshold.

The values that are run do not depend on the number of workers, so neither does the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.optimisation.sweep.study_engine import Engine, SerialEngine, SweepError
from aerodima.optimisation.sweep.study_task import RunTask, tipped_before_turn
from aerodima.workbench.config.scenario import load_scenario

SPEED, FRICTION = "manoeuvre.speed", "car.tyre_friction"
TIPPED = "tipped over before its turn"
"""Outcome of a run that says nothing about the turn: neither survival nor flip, passed over like one that failed."""
SECTIONS = 3
"""A bracket is cut into this many parts per round: two runs, one per core of a small computer."""


@dataclass(frozen=True)
class Search:
    """How a threshold is searched for.

    Attributes:
        factor: number of the scenario that is varied.
        low: start of the scan.
        high: its end.
        scan: largest step of the scan; an island narrower than that may be missed.
        tolerance: largest distance between the highest value survived and the first flipped.
    """

    factor: str
    low: float
    high: float
    scan: float
    tolerance: float

    def __post_init__(self) -> None:
        allowed = {
            "low": (self.low, self.low < self.high, f"below high, {self.high:g}"),
            "scan": (self.scan, 0.0 < self.scan <= self.high - self.low, f"above 0, up to {self.high - self.low:g}"),
            "tolerance": (self.tolerance, 0.0 < self.tolerance <= self.scan, f"above 0, up to scan, {self.scan:g}"),
        }
        for name, (value, fits, words) in allowed.items():
            if not fits or not math.isfinite(value):
                raise SweepError(f"threshold of {self.factor}: {name} {value:g}; allowed: {words}")

    def values(self) -> list[float]:
        """Of the scan, both ends included."""
        steps = math.ceil((self.high - self.low) / self.scan - 1e-9)
        return [_rounded(value) for value in np.linspace(self.low, self.high, steps + 1)]


SPEED_SEARCH = Search(SPEED, 2.5, 6.5, 0.25, 0.05)
FRICTION_SEARCH = Search(FRICTION, 0.4, 1.1, 0.05, 0.01)


@dataclass(frozen=True)
class Threshold:
    """What a search found. Values are in the unit of the factor.

    Attributes:
        search: how it was searched.
        survived: highest value below the first flip that was survived; None if the first value flipped.
        flipped: first value that flipped; None if none did.
        islands: (first, last) value survived of each stretch of the scan beyond the first flip.
        highest_survived: of all values that were run, islands included; None if none survived.
        outcomes: value -> `survived`, `flipped`, `TIPPED`, or `failed: ...`, of every run.
    """

    search: Search
    survived: float | None
    flipped: float | None
    islands: tuple[tuple[float, float], ...]
    highest_survived: float | None
    outcomes: dict[float, str]

    @property
    def found(self) -> bool:
        """Whether the threshold lies inside the range that was searched."""
        return self.survived is not None and self.flipped is not None

    @property
    def value(self) -> float:
        """Middle of survived and flipped; minus infinity below the range, infinity above it."""
        if self.survived is None:
            return -math.inf
        return math.inf if self.flipped is None else 0.5 * (self.survived + self.flipped)

    def as_row(self) -> dict[str, Any]:
        """Flat, for a table."""
        return {
            "factor": self.search.factor,
            "survived": self.survived,
            "first_flipped": self.flipped,
            "tolerance": self.search.tolerance,
            "scan": self.search.scan,
            "searched_from": self.search.low,
            "searched_to": self.search.high,
            "islands": "; ".join(f"{first:g} to {last:g}" for first, last in self.islands),
            "highest_survived": self.highest_survived,
            "runs": len(self.outcomes),
            "tipped_before_turn": sum(outcome == TIPPED for outcome in self.outcomes.values()),
            "failed_runs": sum(outcome.startswith("failed") for outcome in self.outcomes.values()),
        }


@dataclass(frozen=True)
class Case:
    """One car and manoeuvre whose threshold is wanted."""

    name: str
    scenario: str
    settings: tuple[str, ...] = ()


def critical_friction(
    scenario: str,
    settings: Sequence[str] = (),
    engine: Engine | None = None,
    *,
    tolerance: float = FRICTION_SEARCH.tolerance,
    low: float = FRICTION_SEARCH.low,
    high: float = FRICTION_SEARCH.high,
    scan: float = FRICTION_SEARCH.scan,
) -> Threshold:
    """Highest tyre friction that is survived at the scenario's speed, and the lowest that is not.

    Args:
        scenario: name or path.
        settings: overrides; the speed is among them or the scenario's.
        engine: where to run; None runs here, one after the other.
        tolerance: of the friction coefficient.
        low: friction at which the scan begins.
        high: friction at which it ends.
        scan: its step.
    """
    search = Search(FRICTION, low, high, scan, tolerance)
    return find_thresholds([Case("", scenario, tuple(settings))], search, engine)[0]


def highest_speed(
    scenario: str,
    settings: Sequence[str] = (),
    engine: Engine | None = None,
    *,
    tolerance: float = SPEED_SEARCH.tolerance,
    low: float = SPEED_SEARCH.low,
    high: float = SPEED_SEARCH.high,
    scan: float = SPEED_SEARCH.scan,
) -> Threshold:
    """Highest speed (m/s) that is survived with the scenario's friction, and the first at which it flips."""
    search = Search(SPEED, low, high, scan, tolerance)
    return find_thresholds([Case("", scenario, tuple(settings))], search, engine)[0]


def find_thresholds(
    cases: Sequence[Case],
    search: Search,
    engine: Engine | None = None,
    done: Callable[[int, int], None] | None = None,
) -> list[Threshold]:
    """The thresholds of several cases at once, so that all workers have something to do.

    Args:
        cases: what is searched.
        search: the same for all of them.
        engine: where to run; None runs here.
        done: told how many runs are finished, and how many are known to be needed so far.

    Raises:
        SweepError: a scenario cannot be resolved at all.
    """
    engine = engine or SerialEngine()
    for case in cases:
        load_scenario(case.scenario, list(case.settings))
    outcomes: list[dict[float, str]] = [{} for _ in cases]
    wanted = {place: search.values() for place in range(len(cases))}
    while wanted:
        _run(cases, search.factor, wanted, outcomes, engine, done)
        wanted = {place: values for place in wanted if (values := _next_values(outcomes[place], search.tolerance))}
    return [_threshold(search, found) for found in outcomes]


def _run(
    cases: Sequence[Case],
    factor: str,
    wanted: Mapping[int, Sequence[float]],
    outcomes: list[dict[float, str]],
    engine: Engine,
    done: Callable[[int, int], None] | None,
) -> None:
    places = [(place, value) for place, values in wanted.items() for value in values]
    before = sum(map(len, outcomes))
    count = 0

    def one_more(_: int, __: dict[str, Any]) -> None:
        nonlocal count
        count += 1
        if done is not None:
            done(before + count, before + len(places))

    tasks = [
        RunTask(f"{case.name} {value:g}", case.scenario, (*case.settings, f"{factor}={value!r}"))
        for case, value in ((cases[place], value) for place, value in places)
    ]
    for (place, value), row in zip(places, engine.rows(tasks, one_more), strict=True):
        outcomes[place][value] = TIPPED if tipped_before_turn(row) else row["outcome"] or f"failed: {row['error']}"


def _first_step(outcomes: Mapping[float, str]) -> tuple[float | None, float | None]:
    """Last value survived before the first flip, and that flip. Runs that failed or tipped over are passed over."""
    survived: float | None = None
    for value in sorted(outcomes):
        if outcomes[value] == "flipped":
            return survived, value
        if outcomes[value] == "survived":
            survived = value
    return survived, None


def _next_values(outcomes: Mapping[float, str], tolerance: float) -> list[float]:
    survived, flipped = _first_step(outcomes)
    if survived is None or flipped is None or flipped - survived <= tolerance + 1e-9:
        return []
    cuts = np.linspace(survived, flipped, SECTIONS + 1)[1:-1]
    return [value for cut in cuts if (value := _rounded(cut)) not in outcomes]


def _threshold(search: Search, outcomes: dict[float, str]) -> Threshold:
    survived, flipped = _first_step(outcomes)
    islands: list[tuple[float, float]] = []
    if flipped is not None:
        open_island = False
        for value in sorted(value for value in outcomes if value > flipped):
            if outcomes[value] == "survived":
                islands.append((islands.pop()[0] if open_island else value, value))
            open_island = outcomes[value] == "survived"
    highest = max((value for value, outcome in outcomes.items() if outcome == "survived"), default=None)
    ordered = {value: outcomes[value] for value in sorted(outcomes)}
    return Threshold(search, survived, flipped, tuple(islands), highest, ordered)


def _rounded(value: float) -> float:
    """Without the last bits of a division, so that tables and settings read well."""
    return float(f"{value:.9g}")
