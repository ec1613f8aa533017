"""One page per study: what it shows, its plots (each also a PNG beside), its table and where it comes from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from aerodima.optimisation.studies.study_reading import table_cells, tipped
from aerodima.optimisation.sweep.run_study import Say, run_study
from aerodima.optimisation.sweep.study import Study
from aerodima.optimisation.sweep.study_engine import Engine, SweepError
from aerodima.optimisation.sweep.study_store import CSV, TABLE, make_frame
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
    engine: Engine,
    *,
    force: bool = False,
    say: Say | None = None,
) -> Path:
    """Runs a study as far as it has not been, and writes plots and page; the path of the page.

    Raises:
        SweepError: as for `run_study`; or no run came to an outcome.
    """
    frame = run_study(study, out, engine, force=force, say=say)
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
    versions = {name: sorted(set(frame[name])) for name in frame.columns if name.startswith("version_")}
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
