"""Where a car begins to roll over: highest speed survived at given grip, critical friction at given
speed.

A scan searches for survival and reports survivors beyond the first flip as islands
(`limit_search`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from aerodima.optimisation.studies.limit_search import Bracket, LimitSearch
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
SURVIVAL = {"survived": True, "flipped": False}
"""Outcome -> whether the car stayed upright; no other one says."""
FRICTION_SEARCH = LimitSearch(FRICTION, 0.4, 1.1, 0.05, 0.01)
"""Scan of the friction coefficient; the last two numbers are its steps, coarse and fine."""
SEARCHES = {"speed": LimitSearch(SPEED, 2.5, 6.5, 0.25, 0.05), "friction": FRICTION_SEARCH}
"""Name -> scan."""


@dataclass(frozen=True)
class Threshold:
    """Result of a search. Values are in the unit of the factor.

    Attributes:
        search: how it was searched.
        survived: highest value held below the first loss; None if the first value was lost.
        lost: first value that was lost; None if none was.
        islands: (first, last) value held of each stretch of a scan beyond the first loss.
        rows: value -> row of its run, upwards.
    """

    search: LimitSearch
    survived: float | None
    lost: float | None
    islands: tuple[tuple[float, float], ...]
    rows: dict[float, Row]

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
    search = replace(FRICTION_SEARCH, **changes)
    return find_threshold(str(scenario), settings, search, CachedRunner(engine))


def is_clean(row: Facts) -> bool:
    """Tells whether a row of a run is that of clean survival."""
    return row["outcome"] == "survived" and bool(row["clean"])


def find_threshold(
    scenario: str, settings: Sequence[str], search: LimitSearch, runs: CachedRunner
) -> Threshold:
    """Scans for the threshold of survival of one car and manoeuvre.

    Args:
        scenario: name or path.
        settings: overrides.
        search: range and steps.
        runs: where they are made.

    Raises:
        ScenarioError: the scenario cannot be resolved at all.
    """
    load_scenario(scenario, settings)
    rows: dict[float, Row] = {}
    verdicts: dict[float, bool | None] = {}
    while values := search.next_values("scan", verdicts):
        tasks = [
            RunTask(f"{value:g}", scenario, (*settings, f"{search.factor}={value!r}"))
            for value in values
        ]
        for value, row in zip(values, runs.rows(tasks), strict=True):
            rows[value] = row
            verdicts[value] = SURVIVAL.get(_outcome(row))
    bracket = Bracket.from_verdicts(verdicts)
    beyond = sorted(value for value in rows if value > bracket.lost)
    islands = []
    for holds, stretch in groupby(beyond, lambda value: bool(verdicts[value])):
        island = list(stretch)
        if holds:
            islands.append((island[0], island[-1]))
    held, lost = (end if math.isfinite(end) else None for end in (bracket.held, bracket.lost))
    return Threshold(search, held, lost, tuple(islands), dict(sorted(rows.items())))


def _words(value: float | None) -> str:
    return "nowhere" if value is None else f"{value:g}"


def _outcome(row: Facts) -> str:
    if tipped_before_turn(row):
        return TIPPED
    return row["outcome"] or f"failed: {row['error']}"
