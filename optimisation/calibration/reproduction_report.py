"""The reproduction report: rows and runs as tables, replays, and a page in the style of the thesis' figures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.calibration.calibration_runs import RunStore, turn_of
from aerodima.optimisation.calibration.reproduction_claims import all_rows
from aerodima.optimisation.calibration.reproduction_evidence import (
    CLOSE,
    PAIRS,
    SURE,
    WIDEST,
    Basis,
    ClaimRow,
    Evidence,
    Verdict,
    gather,
    survival_section,
    survival_table,
)
from aerodima.optimisation.calibration.validation import as_table, compare
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import ProgressLine, silent
from aerodima.workbench.config.ensemble import BAND, Ensemble, weighted_quantiles
from aerodima.workbench.figures.figure_style import BLUE, GREY, ORANGE, VERMILION, new_figure, styled
from aerodima.workbench.metrics.published_values import SIGNALS, flip_bracket, metric_column, published_values
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
    Link,
    Noted,
    Page,
    Part,
    Plot,
    Section,
    Table,
    metric_name,
    metric_unit,
    write_files,
)
from aerodima.workbench.resources import published_table

VERDICTS: tuple[Verdict, ...] = ("reproduced", "direction only", "not reproduced", "not computable")
SHOWN = (
    "max_yaw_rate_rad_per_s",
    "average_yaw_rate_rad_per_s",
    "max_linear_acceleration_m_per_s2",
    "average_linear_acceleration_m_per_s2",
    "max_kohut_deg_m_per_s2",
    "average_kohut_deg_m_per_s2",
)


def reproduction_page(
    rows: Sequence[ClaimRow],
    evidence: Evidence,
    ensemble: Ensemble,
    replays: Mapping[str, str],
    survival: pd.DataFrame | None = None,
) -> Page:
    """The whole page.

    Args:
        rows: of the report.
        evidence: the runs behind them.
        ensemble: where the members come from.
        replays: words -> file beside the page.
        survival: shares over speed, as `survival_table` makes them.
    """
    method = ensemble.provenance.get("method", "not stated")
    lead = (
        f"{len(rows)} claims of the thesis beside {len(evidence.members)} of {len(ensemble.members)} cars of the "
        f"ensemble {ensemble.name!r}, drawn by weight. How it was made: {method}."
    )
    sections = [
        _verdicts(rows),
        *([] if survival is None else [survival_section(survival)]),
        Section("Figures", _figures(evidence)),
        Section("Every row", [_table(rows)]),
    ]
    if replays:
        sections.append(Section("Replays", [Bullets([Link(file, words) for words, file in replays.items()])]))
    return Page("What of the thesis is reproduced", lead, sections)


def _verdicts(rows: Sequence[ClaimRow]) -> Section:
    bases: list[Basis] = list(dict.fromkeys(row.basis for row in rows if row.basis))
    counted = Counter((row.verdict, row.basis) for row in rows)
    totals = Counter(row.verdict for row in rows)
    shown = [row for row in rows if row.basis in ("prediction", "calibrated to")]
    held, fitted = (counted["reproduced", basis] for basis in ("prediction", "calibrated to"))
    direction = sum(row.verdict == "direction only" for row in shown)
    predicted = sum(row.basis == "prediction" for row in shown)
    counts = [
        (verdict, *(str(counted[verdict, basis]) for basis in bases), str(totals[verdict])) for verdict in VERDICTS
    ]
    parts: list[Part] = [
        Finding(
            [
                f"Of {len(shown)} claims about runs of the car {held} are reproduced as predictions (of {predicted}), "
                f"{fitted} are reproduced because the cars were calibrated to them (of {len(shown) - predicted}), "
                f"which is no evidence, and {len(shown) - held - fitted} are not reproduced ({direction} of these in "
                "the direction of a change only).",
                "Arithmetic on printed numbers says nothing about the car.",
            ]
        ),
        Table(("verdict", *bases, "all"), counts),
        f"Reproduced: the published figure lies in the band of {BAND[2] - BAND[0]:.0%} of the weight and the "
        f"band is at most {WIDEST:.0%} of it wide, or the median is within {CLOSE:.0%}; a claim about an outcome "
        f"holds in at least {SURE:.0%} of the weight. Direction only: a change has the published sign in "
        f"{SURE:.0%} of the weight, not its size. Numbers are those of cars that survive the run, as the "
        f"published one did; where less than {SURE:.0%} of the weight does, nothing counts as reproduced.",
    ]
    return Section("Verdicts", parts)


def _table(rows: Sequence[ClaimRow]) -> Table:
    claim = "claim, with evidence or what is missing"
    header = ("place", claim, "unit", "published", "ours", "band", "verdict", "basis")
    cells = [
        (
            row.place,
            Noted(row.claim, row.evidence),
            row.unit,
            _number(row.published),
            _number(row.ours),
            "" if row.low is None else f"{_number(row.low)} to {_number(row.high)}",
            row.verdict,
            row.basis,
        )
        for row in rows
    ]
    marked = [place for place, row in enumerate(rows) if row.verdict == "not reproduced"]
    return Table(header, cells, marked)


def _figures(evidence: Evidence) -> list[Plot]:
    return [
        Plot(
            plot_metrics(evidence),
            "Bars: median and band of the ensemble; stars: Tables 7.1 to 7.4. "
            f"Simulated: {SIGNALS['simulated']}. Physical: {SIGNALS['physical']}.",
            "Six metrics of the four published runs beside the ensemble",
        ),
        Plot(
            plot_kohut(evidence),
            "Largest Kohut figure. Other robots as printed in Table 3.1.",
            "Kohut figures of robots",
        ),
        Plot(
            plot_acceleration(evidence),
            "Largest lateral acceleration, with the inertial tail of Dima as printed (section 2), another robot.",
            "Lateral acceleration beside Dima",
        ),
    ]


def plot_metrics(evidence: Evidence) -> Figure:
    """Six metrics of the four published runs."""
    with styled():
        drawing, axes = new_figure(10.5, 5.2, 2, 3)
        for axis, name in zip(axes.flat, SHOWN, strict=True):
            for place, row in enumerate(published_values()):
                turn, column = turn_of(row), metric_column(name, row.platform)
                _bar(axis, place, evidence.column(turn.tail_mode, turn.speed, column), evidence.weights)
                axis.plot(place, getattr(row.metrics, name), "*", color=VERMILION, markersize=12)
            labels = [f"{row.source[-3:]}\n{row.metrics.speed_m_per_s:g} m/s" for row in published_values()]
            axis.set_xticks(range(len(labels)), labels, fontsize=8)
            axis.set_title(f"{metric_name(name)} [{metric_unit(name)}]")
            axis.set_ylim(bottom=0)
    return drawing


def plot_kohut(evidence: Evidence) -> Figure:
    """Kohut of other robots and of the car."""
    robots = published_table("kohut_robots")
    none, swing = flip_bracket("tailless").survived, flip_bracket("tailed").survived
    with styled():
        drawing, axes = new_figure(8.0, 3.2)
        axis = axes[0, 0]
        axis.bar(range(len(robots)), robots.kohut_deg_m_per_s2, color=GREY)
        ours = (("none", none, "no tail"), ("swing", swing, "tail swings"))
        for place, (mode, speed, _) in enumerate(ours, len(robots)):
            _bar(axis, place, evidence.column(mode, speed, "max_kohut_deg_m_per_s2"), evidence.weights)
        names = [*robots.robot, *(f"ours, {words}\n{speed:g} m/s" for _, speed, words in ours)]
        axis.set_xticks(range(len(names)), [name.replace(" (", "\n(") for name in names], fontsize=8)
        axis.set_ylabel("Kohut [deg m/s²]")
    return drawing


def plot_acceleration(evidence: Evidence) -> Figure:
    """Largest lateral acceleration beside Dima's."""
    constants = published_table("constants").set_index("name").value_si
    without, with_tail = (float(constants[f"dima_lateral_acceleration_{k}"]) for k in ("no_tail", "with_tail"))
    none, swing = flip_bracket("tailless").survived, flip_bracket("tailed").survived
    name = metric_column("max_linear_acceleration_m_per_s2", "physical")
    with styled():
        drawing, axes = new_figure(6.4, 3.0)
        axis = axes[0, 0]
        axis.bar([0, 1], [without, with_tail], color=GREY)
        for place, (mode, speed) in enumerate((("none", none), ("swing", swing)), 2):
            _bar(axis, place, evidence.column(mode, speed, name), evidence.weights)
        words = ["Dima,\nno tail", "Dima,\ninertial tail", "ours,\nno tail", "ours,\ntail swings"]
        axis.set_xticks(range(4), words, fontsize=8)
        axis.set_ylabel("largest lateral\nacceleration, 5 Hz [m/s²]")
    return drawing


def _bar(axis: object, place: float, values: np.ndarray, weights: np.ndarray) -> None:
    low, median, high = weighted_quantiles(values, weights)
    axis.bar(place, median, width=0.6, color=BLUE, alpha=0.75)  # type: ignore[attr-defined]
    axis.plot([place, place], [low, high], color=ORANGE, linewidth=3)  # type: ignore[attr-defined]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


PAGE, TABLE, FIGURES, SURVIVAL = "index.html", "rows.csv", "figures.csv", "survival.csv"


def write_reproduction_report(
    ensemble: Ensemble,
    number: int,
    out: str | Path,
    engine: Engine,
    progress: ProgressLine = silent,
    *,
    replays: bool = True,
    force: bool = False,
    settings: tuple[str, ...] = (),
    survival: bool = False,
) -> Path:
    """Runs members drawn by weight, writes `rows.csv`, `figures.csv` and `index.html`; the path of the page.

    Args:
        number: of members; all of them if there are fewer.
        out: folder; runs that are in it are not run again.
        settings: overrides that all runs share, such as a shorter run.
        survival: also runs every tail mode at every speed of `reproduction_evidence.SPEEDS`; writes `survival.csv`.

    Raises:
        UserError: wrong number of members, one that makes no car, or the folder holds runs of other parameters.
    """
    out, members = Path(out), ensemble.drawn(number)
    for member in members:
        ensemble.scenario(member, "turn_swing")
    varied = {key for member in ensemble.members for key in member.values}
    fitted = ensemble.provenance.get("fitted", ())
    with RunStore(out, varied, force=force) as store:
        evidence = gather(members, fitted, store, engine, progress, settings, PAIRS if survival else ())
    rows = all_rows(evidence)
    compared = [compare(d, evidence.rows[d.turn.tail_mode, d.turn.speed], evidence.weights) for d in evidence.data]
    shares = survival_table(evidence) if survival else None
    tables = {TABLE: pd.DataFrame([row.as_row() for row in rows]), FIGURES: as_table(compared)}
    if shares is not None:
        tables[SURVIVAL] = shares
    write_files(out, tables)
    made = _replays(ensemble, evidence, out, progress, settings) if replays else {}
    write_files(out, {PAGE: reproduction_page(rows, evidence, ensemble, made, shares)})
    return out / PAGE


def _replays(
    ensemble: Ensemble, evidence: Evidence, out: Path, progress: ProgressLine, settings: tuple[str, ...]
) -> dict[str, str]:
    """Replays of the best member: both sides of the tailless bracket, the swung tail, the held one; words -> file."""
    from aerodima.workbench.report.replay_page import write_replay_html
    from aerodima.workbench.simulate.simulation import simulate

    none, swing = flip_bracket("tailless"), flip_bracket("tailed")
    shown = (
        ("none", none.survived),
        ("none", none.flipped),
        ("swing", swing.survived),
        ("held", evidence.held_speed),
    )
    made = {}
    for mode, speed in shown:
        name = f"replay_{mode}_{speed:.2f}.html"
        progress(f"{name} ...")
        overrides = [f"manoeuvre.speed={speed!r}", *settings]
        scenario = ensemble.scenario(ensemble.best, f"turn_{mode}", overrides)
        run = simulate(scenario)
        write_replay_html(run, out / name, force=True)
        made[f"tail {mode}, {speed:.2f} m/s: {metrics_of(run).outcome.result}"] = name
    return made
