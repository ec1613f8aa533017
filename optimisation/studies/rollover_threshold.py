"""Where a car begins to roll over: highest speed survived at given grip, critical friction at given
speed.

Survival is not monotone (design section 7): beyond the first value at which the car is lost there
may be islands that it survives again. A threshold is therefore the end of an unbroken row from
below, found in one of two ways, for many cars at once. A scan runs the whole range, narrows the
step from survival to the first flip down, and reports survivors beyond it as islands. A climb
begins where the car is expected to hold, goes up in strides until a run is not clean (down first,
if the first one is not), and narrows the last stride to its grid, on which different controllers
meet.

The values that are run do not depend on the number of workers, so neither does the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from aerodima.optimisation.studies.runs import Runs, RunTask, tipped_before_turn
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.scenario import load_scenario

SPEED = "manoeuvre.speed"
FRICTION = "car.tyre_friction"
TIPPED = "tipped over before its turn"
"""Outcome of a run that says nothing about the turn: neither survival nor flip, passed over like
one that failed."""
SECTIONS = 3
"""Parts of a bracket per round of a scan: two runs, one per core of a small computer."""

Start = float | Literal["scan", "bisect"]
"""Value at which a climb begins, or another way to search."""
Judge = Callable[[Any], bool | None]
"""Whether what a run came to counts as survived, or as lost; None says nothing about the turn."""


@dataclass(frozen=True)
class Search:
    """How a threshold is searched for.

    Attributes:
        factor: number of the scenario that is varied.
        low: lowest value; the grid of a climb begins here.
        high: the highest.
        scan: largest step of a scan, in which a narrower island may be missed; first stride of a
            climb.
        tolerance: largest distance between the highest value survived and the first lost; grid of a
            climb.
    """

    factor: str
    low: float
    high: float
    scan: float
    tolerance: float

    def __post_init__(self) -> None:
        allowed = {
            "low": (self.low, self.low <= self.high, f"below high, {self.high:g}, or equal to it"),
            "scan": (self.scan, self.scan > 0.0, "above 0"),
            "tolerance": (
                self.tolerance,
                0.0 < self.tolerance <= self.scan,
                f"above 0, up to scan, {self.scan:g}",
            ),
        }
        for name, (value, fits, words) in allowed.items():
            if not fits or not math.isfinite(value):
                raise SweepError(f"threshold of {self.factor}: {name} {value:g}; allowed: {words}")

    def index(self, value: float) -> int:
        """Place of a value on the grid, within its ends; the lower one of two."""
        return min(max(math.floor((value - self.low) / self.tolerance + 1e-9), 0), self._last)

    def value(self, index: int) -> float:
        """The value at a place of the grid."""
        return rounded(self.low + index * self.tolerance)

    def following(
        self, start: Start, survived: float | None, lost: float | None, rows: Mapping[float, Any]
    ) -> list[float]:
        """What is run next, from what was found so far; nothing at the end."""
        if start == "scan":
            return self._scanned(survived, lost, rows)
        held = None if survived is None else self.index(survived)
        ended = None if lost is None else self.index(lost)
        stride = max(1, round(self.scan / self.tolerance))
        if start == "bisect":
            below = -1 if held is None else held
            above = self._last + 1 if ended is None else ended
            place = (below + above) // 2
        elif held is None:
            if ended is None:
                place = self.index(start)
            else:
                place = max(ended - stride, 0)
        elif ended is None:
            place = min(held + stride, self._last)
        else:
            place = (held + ended) // 2
        value = self.value(place)
        if place < 0 or value in rows:
            return []
        return [value]

    def _scanned(
        self, survived: float | None, lost: float | None, rows: Mapping[float, Any]
    ) -> list[float]:
        if not rows:
            steps = math.ceil((self.high - self.low) / self.scan - 1e-9)
            return [rounded(value) for value in np.linspace(self.low, self.high, steps + 1)]
        if survived is None or lost is None or lost - survived <= self.tolerance + 1e-9:
            return []
        cuts = np.linspace(survived, lost, SECTIONS + 1)[1:-1]
        values = map(rounded, cuts)
        return [value for value in values if value not in rows]

    @property
    def _last(self) -> int:
        return round((self.high - self.low) / self.tolerance)


FRICTION_SEARCH = Search(FRICTION, 0.4, 1.1, 0.05, 0.01)
"""Scan of the friction coefficient; the last two numbers are its steps, coarse and fine."""
SEARCHES = {"speed": Search(SPEED, 2.5, 6.5, 0.25, 0.05), "friction": FRICTION_SEARCH}
"""Name -> scan."""


@dataclass(frozen=True)
class Threshold:
    """What a search found. Values are in the unit of the factor.

    Attributes:
        search: how it was searched.
        survived: highest value below the first loss that was survived; None if the first value was
            lost.
        lost: first value that was lost; None if none was.
        islands: (first, last) value survived of each stretch of a scan beyond the first loss.
        rows: value -> what its run came to, upwards.
    """

    search: Search
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
        failed = [
            f"{value:g}: {outcome}" for value, outcome in outcomes if outcome.startswith("failed")
        ]
        return {
            "factor": self.search.factor,
            "survives up to": "nowhere" if self.survived is None else f"{self.survived:g}",
            "flips at": "nowhere" if self.lost is None else f"{self.lost:g}",
            "tolerance": f"{self.search.tolerance:g}",
            "runs": str(len(self.rows)),
            "survives again": "; ".join(f"{first:g} to {last:g}" for first, last in self.islands)
            or "nowhere",
            TIPPED: ", ".join(f"{value:g}" for value, outcome in outcomes if outcome == TIPPED)
            or "never",
            "failed": f"{len(failed)}" + "".join(f", {words}" for words in failed[:1]),
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
    """Highest tyre friction that is survived at the scenario's speed, and the lowest that is not.

    Args:
        scenario: name or path.
        settings: overrides; the speed is among them or the scenario's.
        engine: where to run; None runs here, one after the other.
        changes: of `FRICTION_SEARCH`: `low`, `high`, `scan`, `tolerance`.
    """
    case = Case("", str(scenario), tuple(settings))
    return find_thresholds([case], replace(FRICTION_SEARCH, **changes), Runs(engine))[0]


def is_clean(row: Mapping[str, Any]) -> bool:
    """Whether a row of a run is that of clean survival."""
    return row["outcome"] == "survived" and bool(row["clean"])


def find_thresholds(
    cases: Sequence[Case],
    search: Search,
    runs: Runs,
    done: Callable[[int, int], None] | None = None,
    starts: Sequence[float] | None = None,
) -> list[Threshold]:
    """The thresholds of several cases at once, so that all workers have something to do.

    Args:
        cases: what is searched.
        search: the same for all of them.
        runs: where they are made.
        done: receives how many runs are finished, and how many are known to be needed so far.
        starts: where the climb of each case over clean runs begins; None scans for survival.

    Raises:
        SweepError: the scenario of a scan cannot be resolved at all.
    """
    finished = needed = 0

    def one_more(_place: int, _row: Row) -> None:
        nonlocal finished
        finished += 1
        if done is not None:
            done(finished, needed)

    def run(wanted: Sequence[tuple[int, float]]) -> list[Row]:
        nonlocal needed
        needed += len(wanted)
        tasks = []
        for place, value in wanted:
            case = cases[place]
            settings = (*case.settings, f"{search.factor}={value!r}")
            tasks.append(RunTask(f"{case.name} {value:g}", case.scenario, settings))
        return runs.rows(tasks, one_more)

    if starts is not None:
        return search_rows(search, starts, run, is_clean)
    for case in cases:
        load_scenario(case.scenario, case.settings)
    return search_rows(search, ["scan"] * len(cases), run, _survival)


def search_rows(
    search: Search,
    starts: Sequence[Start],
    run: Callable[[Sequence[tuple[int, float]]], Sequence[Any]],
    judge: Judge,
) -> list[Threshold]:
    """Several searches at once.

    Args:
        search: the same for all of them.
        starts: how, or where, each begins.
        run: what the runs of (number of the search, value) come to, in order.
        judge: of that; in a climb never None.
    """
    rows: list[dict[float, Any]] = [{} for _ in starts]
    while True:
        wanted = []
        for place, (start, found) in enumerate(zip(starts, rows, strict=True)):
            survived, lost = first_loss(_verdicts(found, judge))
            following = search.following(start, survived, lost, found)
            wanted += [(place, value) for value in following]
        if not wanted:
            break
        for (place, value), row in zip(wanted, run(wanted), strict=True):
            rows[place][value] = row
    return [_threshold(search, dict(sorted(found.items())), judge) for found in rows]


def first_loss(verdicts: Mapping[float, bool | None]) -> tuple[float | None, float | None]:
    """Last value survived before the first loss, and that loss.

    A value without verdict is passed over.
    """
    lost = min((value for value, verdict in verdicts.items() if verdict is False), default=None)
    survived = (
        value for value, verdict in verdicts.items() if verdict and (lost is None or value < lost)
    )
    return max(survived, default=None), lost


def _verdicts(rows: Mapping[float, Any], judge: Judge) -> dict[float, bool | None]:
    return {value: judge(row) for value, row in rows.items()}


def _threshold(search: Search, rows: dict[float, Any], judge: Judge) -> Threshold:
    verdicts = _verdicts(rows, judge)
    survived, lost = first_loss(verdicts)
    islands: list[tuple[float, float]] = []
    open_island = False
    for value, survives in verdicts.items():
        if lost is None or value <= lost:
            continue
        if survives:
            first = islands.pop()[0] if open_island else value
            islands.append((first, value))
        open_island = bool(survives)
    return Threshold(search, survived, lost, tuple(islands), rows)


def _outcome(row: Mapping[str, Any]) -> str:
    if tipped_before_turn(row):
        return TIPPED
    return row["outcome"] or f"failed: {row['error']}"


def _survival(row: Mapping[str, Any]) -> bool | None:
    return {"survived": True, "flipped": False}.get(_outcome(row))


def rounded(value: float) -> float:
    """Without the last bits of a division, so that tables and settings read well."""
    return float(f"{value:.9g}")
