"""Where a car begins to roll over: highest speed survived at given grip, critical friction at given
speed.

A scan searches for survival and reports survivors beyond the first flip as islands; a climb
searches for clean runs on a grid, on which different controllers meet (`limit_search`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from aerodima.optimisation.studies.limit_search import Bracket, LimitSearch, Start, run_rounds
from aerodima.optimisation.studies.runs import CachedRunner, RunTask, tipped_before_turn
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.core.file_reading import Facts
from aerodima.workbench.scenario.scenario import load_scenario

SPEED = "manoeuvre.speed"
FRICTION = "car.tyre_friction"
TIPPED = "tipped over before its turn"
"""Outcome of a run that says nothing about the turn: neither survival nor flip, passed over like
one that failed."""
FRICTION_SEARCH = LimitSearch(FRICTION, 0.4, 1.1, 0.05, 0.01)
"""Scan of the friction coefficient; the last two numbers are its steps, coarse and fine."""
SEARCHES = {"speed": LimitSearch(SPEED, 2.5, 6.5, 0.25, 0.05), "friction": FRICTION_SEARCH}
"""Name -> scan."""
Judge = Callable[[Any], bool | None]
"""Whether the result of a run counts as held or as lost; None says nothing."""


@dataclass(frozen=True)
class Threshold:
    """Result of a search. Values are in the unit of the factor.

    Attributes:
        search: how it was searched.
        survived: highest value held below the first loss; None if the first value was lost.
        lost: first value that was lost; None if none was.
        islands: (first, last) value held of each stretch of a scan beyond the first loss.
        rows: value -> result of its run, upwards.
    """

    search: LimitSearch
    survived: float | None
    lost: float | None
    islands: tuple[tuple[float, float], ...]
    rows: dict[float, Any]

    @property
    def found(self) -> bool:
        """Whether the threshold lies inside the range that was searched."""
        return self.survived is not None and self.lost is not None

    @property
    def value(self) -> float:
        """Middle of survived and lost; minus infinity below the range, infinity above it."""
        if self.survived is None:
            return -math.inf
        if self.lost is None:
            return math.inf
        return 0.5 * (self.survived + self.lost)

    @property
    def outcomes(self) -> dict[float, str]:
        """Value -> `survived`, `flipped`, `TIPPED` or `failed: ...` of each run of a scenario."""
        return {value: _outcome(row) for value, row in self.rows.items()}

    @property
    def summary(self) -> dict[str, str]:
        """One row of a table, in words."""
        outcomes = self.outcomes.items()
        tipped = [f"{value:g}" for value, outcome in outcomes if outcome == TIPPED]
        failed = [f"{value:g}: {words}" for value, words in outcomes if words.startswith("failed")]
        islands = [f"{first:g} to {last:g}" for first, last in self.islands]
        return {
            "factor": self.search.factor,
            "survives up to": _words(self.survived),
            "flips at": _words(self.lost),
            "tolerance": f"{self.search.tolerance:g}",
            "runs": str(len(self.rows)),
            "survives again": "; ".join(islands) or "nowhere",
            TIPPED: ", ".join(tipped) or "never",
            "failed": ", ".join([str(len(failed)), *failed[:1]]),
        }


@dataclass(frozen=True)
class Case:
    """One car and manoeuvre whose threshold is wanted."""

    name: str
    scenario: str
    settings: tuple[str, ...] = ()


def critical_friction(
    scenario: str | Path,
    settings: Sequence[str] = (),
    engine: Engine | None = None,
    **changes: Any,
) -> Threshold:
    """Searches the highest tyre friction that is survived at the scenario's speed.

    Args:
        scenario: name or path.
        settings: overrides; the speed is among them or the scenario's.
        engine: where to run; None runs here, one after the other.
        changes: of `FRICTION_SEARCH`: `low`, `high`, `scan`, `tolerance`.
    """
    case = Case("", str(scenario), tuple(settings))
    search = replace(FRICTION_SEARCH, **changes)
    return find_thresholds([case], search, CachedRunner(engine))[0]


def is_clean(row: Facts) -> bool:
    """Tells whether a row of a run is that of clean survival."""
    return row["outcome"] == "survived" and bool(row["clean"])


def find_thresholds(
    cases: Sequence[Case],
    search: LimitSearch,
    runs: CachedRunner,
    starts: Sequence[float] | None = None,
) -> list[Threshold]:
    """Searches the thresholds of several cases at once, so that all workers are busy.

    Args:
        cases: what is searched.
        search: range and steps of all of them.
        runs: where they are made.
        starts: where the climb of each case over clean runs begins; None scans for survival.

    Raises:
        SweepError: the scenario of a scan cannot be resolved at all.
    """

    def run(wanted: Sequence[tuple[int, float]]) -> list[Row]:
        tasks = []
        for index, value in wanted:
            case = cases[index]
            settings = (*case.settings, f"{search.factor}={value!r}")
            tasks.append(RunTask(f"{case.name} {value:g}", case.scenario, settings))
        return runs.rows(tasks)

    if starts is not None:
        return search_thresholds(search, starts, run, is_clean)
    for case in cases:
        load_scenario(case.scenario, case.settings)
    return search_thresholds(search, ["scan"] * len(cases), run, _survival)


def search_thresholds(
    search: LimitSearch,
    starts: Sequence[Start],
    run: Callable[[Sequence[tuple[int, float]]], Sequence[Any]],
    judge: Judge,
) -> list[Threshold]:
    """Searches the limits of several candidates at once.

    Args:
        search: range and steps of all of them.
        starts: how, or where, each begins.
        run: evaluates (index of the candidate, value), in order.
        judge: of a result; in a climb never None.
    """
    rows: list[dict[float, Any]] = [{} for _ in starts]
    verdicts: list[dict[float, bool | None]] = [{} for _ in starts]

    def record(index: int, value: float, row: Any) -> None:
        rows[index][value] = row
        verdicts[index][value] = judge(row)

    def next_values(index: int) -> list[float]:
        return search.next_values(starts[index], verdicts[index])

    run_rounds(range(len(starts)), next_values, run, record)
    return [
        _threshold(search, dict(sorted(own.items())), known)
        for own, known in zip(rows, verdicts, strict=True)
    ]


def _threshold(
    search: LimitSearch, rows: dict[float, Any], verdicts: Mapping[float, bool | None]
) -> Threshold:
    bracket = Bracket.from_verdicts(verdicts)
    beyond = [value for value in rows if value > bracket.lost]
    islands = []
    for holds, stretch in groupby(beyond, lambda value: bool(verdicts[value])):
        values = list(stretch)
        if holds:
            islands.append((values[0], values[-1]))
    ends = [end if math.isfinite(end) else None for end in (bracket.held, bracket.lost)]
    return Threshold(search, ends[0], ends[1], tuple(islands), rows)


def _words(value: float | None) -> str:
    return "nowhere" if value is None else f"{value:g}"


def _outcome(row: Facts) -> str:
    if tipped_before_turn(row):
        return TIPPED
    return row["outcome"] or f"failed: {row['error']}"


def _survival(row: Facts) -> bool | None:
    return {"survived": True, "flipped": False}.get(_outcome(row))
