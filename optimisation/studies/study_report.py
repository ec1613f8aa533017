"""What the table of a study says, and its page.

Survivors, thresholds with islands, bands over an ensemble and probabilities are read from the table of runs; the page
has the result, its plots (each also a PNG beside), the table and where it comes from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from aerodima.optimisation.sweep.rollover_threshold import first_loss
from aerodima.optimisation.sweep.run_study import CSV, TABLE, make_frame, run_study
from aerodima.optimisation.sweep.study import Study
from aerodima.optimisation.sweep.study_engine import RunEngine, tipped_before_turn
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.config.ensemble import weighted_quantiles
from aerodima.workbench.errors import SweepError
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
    Folded,
    Link,
    Page,
    Plot,
    Preformatted,
    Section,
    Table,
    write_files,
)

CONFIDENCE = 0.95
"""Of an interval of a probability (Clopper and Pearson)."""


def weights_of(frame: pd.DataFrame) -> np.ndarray:
    """Weight of each row: that of its ensemble member, 1 without an ensemble; shape (n,)."""
    return frame["weight"].to_numpy(float) if "weight" in frame.columns else np.ones(len(frame))


def ran(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows of runs that came to an outcome."""
    return frame[frame["outcome"].notna()]


def tipped(frame: pd.DataFrame) -> np.ndarray:
    """Which runs tipped over before their turn: rolled over, but no evidence about the turn; shape (n,)."""
    return np.array([tipped_before_turn(row) for row in frame.to_dict("records")], bool)


def survived_share(frame: pd.DataFrame) -> float:
    """Share of the weight that survived; NaN without a run."""
    frame = ran(frame)
    if frame.empty:
        return float("nan")
    return float(np.average(frame["outcome"] == "survived", weights=weights_of(frame)))


def by_value(frame: pd.DataFrame, factor: str) -> list[tuple[float, pd.DataFrame]]:
    """Value of a numeric factor and the rows that have it, in order of the value."""
    groups: Any = frame.groupby(factor)
    return [(float(value), rows) for value, rows in groups]


def band(frame: pd.DataFrame, column: str) -> tuple[float, float, float]:
    """`BAND` of a column over the rows, by their weights; three times the value for one row."""
    frame = ran(frame)
    low, middle, high = weighted_quantiles(frame[column].to_numpy(float), weights_of(frame))
    return float(low), float(middle), float(high)


@dataclass(frozen=True)
class Step:
    """From survival to the first flip along one factor; None where the range does not hold it.

    Attributes:
        survived: last value before the first flip.
        flipped: the first flip.
        islands: values beyond it that were survived.
        tipped: values at which the car tipped over before its turn; they are passed over.
    """

    survived: float | None
    flipped: float | None
    islands: tuple[float, ...]
    tipped: tuple[float, ...] = ()

    @property
    def words(self) -> str:
        """Short, for a table."""
        beyond = f"; survives again at {', '.join(f'{value:.4g}' for value in self.islands)}" if self.islands else ""
        if self.tipped:
            beyond += f"; tipped over before its turn at {', '.join(f'{value:.4g}' for value in self.tipped)}"
        if self.flipped is None:
            return f"no flip{beyond}" if self.survived is not None else f"no run{beyond}"
        if self.survived is None:
            return f"below {self.flipped:.4g}{beyond}"
        return f"{self.survived:.4g} to {self.flipped:.4g}{beyond}"

    def middle(self, low: float, high: float) -> float:
        """Of survived and flipped; an end of the range where the step lies beyond it, NaN where no run tells."""
        if self.survived is not None and self.flipped is not None:
            return 0.5 * (self.survived + self.flipped)
        if self.survived is None:
            return float("nan") if self.flipped is None else low
        return high if np.isclose(self.survived, high) else float("nan")


def step_along(frame: pd.DataFrame, factor: str) -> Step:
    """The step of the rows of one car along a factor; a value counts as survived if most of its weight did.

    Runs that tipped over before their turn are passed over.
    """
    over = tuple(value for value, _ in by_value(frame[tipped(frame)], factor))
    turned = by_value(ran(frame[~tipped(frame)]), factor)
    verdicts: dict[float, bool | None] = {value: survived_share(rows) >= 0.5 for value, rows in turned}
    survived, flipped = first_loss(verdicts)
    islands = (value for value, held in verdicts.items() if held and flipped is not None and value > flipped)
    return Step(survived, flipped, tuple(islands), over)


def steps_of_members(frame: pd.DataFrame, factor: str) -> tuple[list[Step], np.ndarray]:
    """The step of every member of an ensemble and the members' weights; one step of weight 1 without ensemble."""
    if "member" not in frame.columns:
        return [step_along(frame, factor)], np.ones(1)
    groups = [rows for _, rows in frame.groupby("member", sort=False)]
    return [step_along(rows, factor) for rows in groups], np.array([rows["weight"].iloc[0] for rows in groups])


@dataclass(frozen=True)
class Probability:
    """A share of runs with its interval.

    Attributes:
        value: weighted share.
        low: lower end of the 95 % interval (Clopper and Pearson, on the effective number of runs).
        high: upper end.
        runs: how many came to an outcome.
        effective: how many equally weighted runs they are worth.
    """

    value: float
    low: float
    high: float
    runs: int
    effective: float


def rollover_probability(frame: pd.DataFrame) -> Probability:
    """Share of the runs that flipped; NaN without runs.

    Members of an ensemble share their samples: the runs are worth no more than members, and no more than samples.
    """
    frame = ran(frame)
    if frame.empty:
        return Probability(float("nan"), 0.0, 1.0, 0, 0.0)
    weights = weights_of(frame)
    effective = float(weights.sum() ** 2 / np.sum(weights**2))
    if "member" in frame.columns and frame["member"].notna().any():
        members = frame.groupby("member")["weight"].agg(["first", "size"])
        worth = float(members["first"].sum() ** 2 / np.sum(members["first"] ** 2))
        effective = min(effective, worth, float(members["size"].max()))
    share = 1.0 - survived_share(frame)
    whole = max(1, round(effective))
    interval = binomtest(round(share * whole), whole).proportion_ci(CONFIDENCE, "exact")
    return Probability(share, float(interval.low), float(interval.high), len(frame), effective)


def table_cells(frame: pd.DataFrame, columns: Sequence[str]) -> list[list[str]]:
    """Rows of texts for a page: numbers to four digits, nothing where there is none."""
    return [[cell_text(value) for value in row] for row in frame[list(columns)].itertuples(index=False)]


def cell_text(value: Any) -> str:
    """One cell of a table."""
    if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)):
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


PAGE, FINDINGS = "index.html", "findings"
MOST_ROWS = 200
"""Rows of a table on the page; the files have all."""


@dataclass(frozen=True)
class Findings:
    """What the table of a study comes to.

    Attributes:
        rows: the result, one row per case; written as `findings.parquet` and `findings.csv`.
        sentences: what it says and what it does not.
        plots: with their names.
        columns: of the page's table of runs.
    """

    rows: list[dict[str, Any]]
    sentences: tuple[str, ...]
    plots: tuple[Plot, ...]
    columns: tuple[str, ...] = field(default=("block", "outcome", "peak_roll_rad"))


def make_report(
    study: Study,
    read: Callable[[pd.DataFrame], Findings],
    out: Path,
    engine: RunEngine,
    *,
    force: bool = False,
    progress: ProgressLine = silent,
) -> Path:
    """Runs a study as far as it has not been, and writes plots and page; the path of the page.

    Raises:
        SweepError: as for `run_study`; or no run came to an outcome.
    """
    frame = run_study(study, out, engine, force=force, progress=progress)
    if frame["outcome"].isna().all():
        raise SweepError(f"{out / TABLE}: none of the {len(frame)} runs came to an outcome; {frame['error'].iloc[0]}")
    found = read(frame)
    result = make_frame(found.rows)
    tables = {f"{FINDINGS}.csv": result, f"{FINDINGS}.parquet": result}
    write_files(out, {**tables, PAGE: _page(study, frame, found, result)}, error=SweepError)
    return out / PAGE


def _page(study: Study, frame: pd.DataFrame, found: Findings, result: pd.DataFrame) -> Page:
    failed = frame[frame["error"].fillna("") != ""]
    lead = f"{len(frame)} runs, {len(failed)} of which failed." if len(failed) else f"{len(frame)} runs, none failed."
    if over := int(tipped(frame).sum()):
        lead += f" {over} tipped over before their turn: they count as rolled over, but no threshold rests on them."
    if "member" in frame.columns:
        lead += f" Every case was run for {frame['member'].nunique()} members of the ensemble {study.ensemble!r}."
    columns = [name for name in found.columns if name in frame.columns]
    versions = {name: sorted(set(frame[name].dropna())) for name in frame.columns if name.startswith("version_")}
    files = (TABLE, CSV, f"{FINDINGS}.parquet", f"{FINDINGS}.csv", "study.json")
    all_runs: list[str | Link] = ["All runs with all columns:", *map(Link, files)]
    sections = [
        Section("Result", [Finding([Bullets(found.sentences)]), _table(result, list(result.columns))]),
        Section("Plots", found.plots),
        Section("Runs", [tuple(all_runs), Folded("Table", [_table(frame.head(MOST_ROWS), columns)])]),
        Section(
            "Where it comes from",
            [
                Bullets([f"{name.removeprefix('version_')}: {', '.join(v)}" for name, v in versions.items()]),
                Folded("Study", [Preformatted(study.model_dump_json(indent=1, by_alias=True))]),
            ],
        ),
    ]
    if len(failed):
        reasons = failed["error"].value_counts()
        sections.insert(3, Section("Failed runs", [Bullets([f"{n} x {text}" for text, n in reasons.items()])]))
    return Page(study.name, lead, sections)


def _table(frame: pd.DataFrame, columns: Sequence[str]) -> Table:
    return Table(columns, table_cells(frame, columns))
