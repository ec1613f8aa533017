"""Other people's tails: what is published of them beside what our simulation makes of it, with a verdict per figure.

`models/published/other_tails.csv` has the figures with their sources, `models/other_tails` the parameters. A figure is
reproduced when ours lies within 10 % of it (the rule of the reproduction report) or, where it is zero, within what the
table names; a figure whose inputs had to be assumed also has a band, which may not be wider than half of it. A change
(in %) of the published sign and another size is met in its direction only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import pandas as pd

from aerodima.optimisation.studies.other_tail_systems import SYSTEMS, Measured
from aerodima.optimisation.studies.reproduction_evidence import CLOSE, WIDEST, Basis, ClaimRow, Verdict, missing_row
from aerodima.optimisation.studies.tail_map import Tail, known_tails, map_section
from aerodima.workbench.atomic_write import make_folder, refuse_existing
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.published_values import flip_bracket
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.report.report_page import Bullets, Finding, Noted, Page, Section, Table, write_files
from aerodima.workbench.resources import published_rows

PAGE, TABLE = "index.html", "other_tails.csv"
FILE = "other_tails"
"""Of `models/published`."""


@dataclass(frozen=True)
class TailFigure:
    """One published figure of somebody else's tail.

    Attributes:
        system: whose it is.
        row: claim, published, ours, verdict, basis.
        simulated: ours is read off a simulated motion, not off the geometry.
        read_in: where the figure was read.
    """

    system: str
    row: ClaimRow
    simulated: bool
    read_in: str

    @property
    def error(self) -> float | None:
        """Ours less the published figure, over it; None without either, or where it is zero."""
        if self.row.published in (None, 0.0) or self.row.ours is None:
            return None
        return (self.row.ours - self.row.published) / abs(self.row.published)

    def as_row(self) -> dict[str, Any]:
        """For the CSV."""
        percent = None if self.error is None else 100.0 * self.error
        own = {"system": self.system, "simulated": self.simulated, "error_percent": percent, "read_in": self.read_in}
        return own | self.row.as_row()


def measure_dima() -> dict[str, Measured]:
    """Largest lateral acceleration of our car without tail and with the built one.

    Each at the highest speed that the simulated car of the thesis survived so.
    """
    name = "max_linear_acceleration_m_per_s2"
    found = []
    for scenario, speed in (
        ("turn_none", flip_bracket("tailless").survived),
        ("turn_swing", flip_bracket("tailed").survived),
    ):
        found.append(getattr(metrics_of(_run(scenario, speed)).filtered, name))
    return {"dima_acceleration": Measured(found[0]), "dima_gain": Measured(100.0 * (found[1] / found[0] - 1.0))}


def _run(scenario: str, speed: float) -> Any:
    from aerodima.workbench.simulate.simulation import simulate

    return simulate(load_scenario(scenario, [f"manoeuvre.speed={speed!r}"]))


MEASURES = {**SYSTEMS, "Dima": measure_dima}
"""System -> what measures its figures."""


def measure_all(progress: ProgressLine = silent) -> dict[str, Measured]:
    """Figure -> ours, of all systems."""
    found: dict[str, Measured] = {}
    for system, measure in MEASURES.items():
        progress(f"{system} ...")
        found |= measure()
    return found


def tail_figures(measured: Mapping[str, Measured]) -> list[TailFigure]:
    """Every row of the published table, beside ours.

    Raises:
        UserError: a figure of the table that nothing measures, or one measured that is not in it; names it.
    """
    rows = published_rows(FILE)
    told = [row["id"] for row in rows if row["id"]]
    if odd := sorted(set(told) ^ set(measured)):
        raise UserError(f"models/published/{FILE}.csv: {', '.join(odd)}: every figure needs a published and our value")
    return [_figure(row, measured) for row in rows]


def _figure(row: Mapping[str, str], measured: Mapping[str, Measured]) -> TailFigure:
    if not row["id"]:
        missing = missing_row(row["source"], row["claim"], row["missing"])
        return TailFigure(row["system"], missing, False, row["read_in"])
    ours, published = measured[row["id"]], float(row["published"])
    within = float(row["within"]) if row["within"] else CLOSE * abs(published)
    verdict = verdict_on(published, ours, within, change=row["unit"] == "%")
    basis = _basis(row)
    claim = ClaimRow(
        row["source"],
        row["claim"],
        row["unit"],
        published,
        ours.value,
        ours.low,
        ours.high,
        verdict,
        row["note"],
        basis,
    )
    return TailFigure(row["system"], claim, row["simulated"] == "yes", row["read_in"])


def _basis(row: Mapping[str, str]) -> Basis:
    basis: Basis
    for basis in get_args(Basis):
        if basis and basis == row["basis"]:
            return basis
    allowed = ", ".join(filter(None, get_args(Basis)))
    raise UserError(f"models/published/{FILE}.csv: {row['id']}: basis {row['basis']!r}; allowed: {allowed}")


def verdict_on(published: float, ours: Measured, within: float, *, change: bool = False) -> Verdict:
    """Whether a figure is met, and the band of what was assumed does not leave everything open.

    Args:
        published: theirs.
        ours: with its band.
        within: difference that is allowed.
        change: the figure is a change, whose sign alone counts for something.
    """
    open_end = ours.low is not None and ours.high is not None and ours.high - ours.low > WIDEST * abs(published)
    if abs(ours.value - published) <= within and not open_end:
        return "reproduced"
    return "direction only" if change and ours.value * published > 0.0 else "not reproduced"


def write_other_tails(out: Path, progress: ProgressLine = silent, *, force: bool = False) -> Path:
    """Measures all figures and writes `other_tails.csv` and `index.html` with the map; the path of the page.

    Args:
        out: folder.
        progress: told which system is simulated.
        force: replace files that exist.

    Raises:
        UserError: the folder cannot be made, a file exists and may not be replaced, or the published table is wrong.
    """
    for name in (TABLE, PAGE):
        refuse_existing(out / name, force, UserError)
    make_folder(out, UserError)
    figures = tail_figures(measure_all(progress))
    progress("map over size and speed ...")
    page = other_tails_page(figures, known_tails())
    table = pd.DataFrame([figure.as_row() for figure in figures])
    write_files(out, {TABLE: table, PAGE: page}, force=force)
    return out / PAGE


def summary(figures: list[TailFigure]) -> str:
    """What the figures come to, in a sentence."""
    held = [figure for figure in figures if figure.row.published is not None]
    counts = Counter((figure.row.basis, figure.row.verdict) for figure in held)
    simulated = sum(figure.simulated for figure in held)
    predicted, fitted = (sum(counts[basis, v] for v in get_args(Verdict)) for basis in ("prediction", "calibrated to"))
    return (
        f"{len(held)} figures of {len({figure.system for figure in held})} systems, {simulated} of them read off a "
        f"simulated motion. Of {predicted} predictions {counts['prediction', 'reproduced']} are reproduced; of "
        f"{fitted} that follow from what was put in {counts['calibrated to', 'reproduced']}, which is no evidence."
    )


def other_tails_page(figures: list[TailFigure], tails: list[Tail]) -> Page:
    """The page: what it comes to, a table per system, the map, what could not be held."""
    rule = (
        f"Reproduced: within {CLOSE:.0%} of the published figure (where that is zero, within what the table names), "
        f"and the band over what had to be assumed is at most {WIDEST:.0%} of it wide. Direction only: a change of the "
        "published sign and another size. Prediction: nothing of the figure was put in."
    )
    held = [figure for figure in figures if figure.row.published is not None]
    systems = dict.fromkeys(figure.system for figure in held)
    sections = [
        Section("Verdicts", [Finding([summary(figures)]), rule]),
        *(Section(system, [_table([f for f in held if f.system == system])]) for system in systems),
        map_section(tails),
        Section("What could not be held", [Bullets([_told(f) for f in figures if f.row.published is None])]),
    ]
    lead = "What others have published of their tails beside what this simulation makes of the same inputs."
    return Page("Other people's tails", lead, sections)


def _told(figure: TailFigure) -> str:
    row = figure.row
    return f"{figure.system}: {row.claim} ({row.place}; read in {figure.read_in}). Missing: {row.evidence}."


def _table(figures: list[TailFigure]) -> Table:
    header = ("figure, its source, what ours rests on", "unit", "theirs", "ours", "band", "error", "verdict", "basis")
    cells = []
    for figure in figures:
        row, (theirs, ours, band, error) = figure.row, numbers(figure)
        kind = f"{row.basis}, simulated" if figure.simulated else row.basis
        what = Noted(row.claim, f"{row.place}, read in {figure.read_in}; {row.evidence}")
        cells.append((what, row.unit, theirs, ours, band, error, row.verdict, kind))
    marked = [place for place, figure in enumerate(figures) if figure.row.verdict != "reproduced"]
    return Table(header, cells, marked)


def numbers(figure: TailFigure) -> tuple[str, str, str, str]:
    """Theirs, ours, band and error of a figure as they are printed."""
    row = figure.row
    band = "" if row.low is None or row.high is None else f"{row.low:.3g} to {row.high:.3g}"
    error = (
        "" if figure.error is None else f"{100.0 * figure.error:+.1f} %".replace("-0.0", "0.0").replace("+0.0", "0.0")
    )
    ours = f"{row.ours:.3f}".replace("-0.000", "0.000") if row.published == 0.0 else f"{row.ours:.4g}"
    return f"{row.published:g}", ours, band, error


def document_rows(figures: list[TailFigure]) -> Iterator[str]:
    """Rows of the table of docs/other_tails.md."""
    for figure in figures:
        if figure.row.published is None:
            continue
        theirs, ours, band, error = numbers(figure)
        kind = f"{figure.row.basis}{', simulated' if figure.simulated else ''}"
        shown = f"{ours} ({band})" if band else ours
        unit = "" if figure.row.unit == "1" else f" {figure.row.unit}"
        words = f"{figure.system}: {figure.row.claim}"
        verdict = figure.row.verdict if figure.row.verdict == "reproduced" else f"**{figure.row.verdict}**"
        yield f"| {words} | {theirs}{unit} | {shown}{unit} | {error} | {verdict} | {kind} |"
