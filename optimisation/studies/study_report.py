"""One page per study: what it shows, its plots (each also a PNG beside), its table and where it comes from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.study_reading import table_cells, tipped
from aerodima.optimisation.sweep.run_study import Say, run_study
from aerodima.optimisation.sweep.study import Study
from aerodima.optimisation.sweep.study_engine import Engine, SweepError
from aerodima.optimisation.sweep.study_store import CSV, TABLE, make_frame
from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.figures.figure_style import png
from aerodima.workbench.report import report_page as html

PAGE, FINDINGS = "index.html", "findings"
MOST_ROWS = 200
"""Rows of a table on the page; the files have all."""


@dataclass(frozen=True)
class Picture:
    """One plot of a page.

    Attributes:
        name: of its PNG, without ending.
        figure: the plot.
        caption: below it.
        alternative: what it shows, for those who cannot see it.
    """

    name: str
    figure: Figure
    caption: str
    alternative: str


@dataclass(frozen=True)
class Findings:
    """What the table of a study comes to.

    Attributes:
        rows: the result, one row per case; written as `findings.parquet` and `findings.csv`.
        sentences: what it says and what it does not.
        pictures: the plots.
        columns: of the page's table of runs.
    """

    rows: list[dict[str, Any]]
    sentences: tuple[str, ...]
    pictures: tuple[Picture, ...]
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
    for picture in found.pictures:
        _write(out / f"{picture.name}.png", partial(_write_png, picture.figure))
    result = make_frame(found.rows)
    _write(out / f"{FINDINGS}.csv", lambda path: result.to_csv(path, index=False))
    _write(out / f"{FINDINGS}.parquet", lambda path: result.to_parquet(path, index=False))
    text = _page(study, frame, found, result)
    _write(out / PAGE, lambda path: path.write_text(text, encoding="utf-8"))
    return out / PAGE


def _write_png(figure: Figure, path: Path) -> None:
    path.write_bytes(png(figure))


def _write(path: Path, write: Callable[[Path], Any]) -> None:
    write_atomically(path, write, True, SweepError)


def _page(study: Study, frame: pd.DataFrame, found: Findings, result: pd.DataFrame) -> str:
    failed = frame[frame["error"].fillna("") != ""]
    lead = f"{len(frame)} runs, {len(failed)} of which failed." if len(failed) else f"{len(frame)} runs, none failed."
    if over := int(tipped(frame).sum()):
        lead += f" {over} tipped over before their turn: they count as rolled over, but no threshold rests on them."
    if "member" in frame.columns:
        lead += f" Every case was run for {frame['member'].nunique()} members of the ensemble {study.ensemble!r}."
    pictures = [html.picture(f"{p.name}.png", p.caption, p.alternative) for p in found.pictures]
    columns = [name for name in found.columns if name in frame.columns]
    shown = frame.head(MOST_ROWS)
    versions = {name: sorted(set(frame[name])) for name in frame.columns if name.startswith("version_")}
    links = [html.link(name, name) for name in (TABLE, CSV, f"{FINDINGS}.parquet", f"{FINDINGS}.csv", "study.json")]
    sections = [
        html.Section("result", "Result", (_sentences(found.sentences), _table(result, list(result.columns)))),
        html.Section("plots", "Plots", tuple(pictures)),
        html.Section(
            "runs",
            "Runs",
            (html.paragraph("All runs with all columns:", *links), html.folded("Table", _table(shown, columns))),
        ),
        html.Section(
            "provenance",
            "Where it comes from",
            (
                html.bullets(f"{name.removeprefix('version_')}: {', '.join(v)}" for name, v in versions.items()),
                html.folded("Study", html.preformatted(study.model_dump_json(indent=1, by_alias=True))),
            ),
        ),
    ]
    if len(failed):
        reasons = failed["error"].value_counts()
        sections.insert(
            3, html.Section("failed", "Failed runs", (html.bullets(f"{n} x {text}" for text, n in reasons.items()),))
        )
    return html.page(study.name, lead, sections)


def _sentences(sentences: Sequence[str]) -> html.Markup:
    return html.finding(html.bullets(sentences))


def _table(frame: pd.DataFrame, columns: Sequence[str]) -> html.Markup:
    numbers = [place for place, name in enumerate(columns) if frame[name].dtype == "float64"]
    return html.table(columns, table_cells(frame, columns), numbers)
