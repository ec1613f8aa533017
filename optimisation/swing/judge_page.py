"""The corner study as one piece of work: store, runs, and its tables (CSV, Markdown) with one HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.candidates import NO_TAIL, THESIS, Candidate
from aerodima.optimisation.studies.corner_case import case_sections
from aerodima.optimisation.studies.corner_plan import (
    MOST_BACK,
    MOST_ROLL,
    MOST_SIDESLIP,
    SHOWN,
    STEP_BACK,
    CornerPlan,
)
from aerodima.optimisation.studies.corner_result import Corner
from aerodima.optimisation.studies.corner_study import CornerRuns
from aerodima.optimisation.studies.disturbed_turns import disturbed_words, survival_cells
from aerodima.optimisation.studies.law_training import LawFamily
from aerodima.optimisation.studies.pulse_lengths import WORDS, gains_by_pulse, plot_pulses, pulse_rows
from aerodima.optimisation.studies.study_store import drop_stale, open_runs
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RememberingEngine, RunEngine
from aerodima.workbench.batch.row_store import saying_how_to_go_on
from aerodima.workbench.batch.worker_record import ProgressLine, silent
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.figures.figure_style import BLUE, GREY, new_figure, styled
from aerodima.workbench.report.report_page import Finding, Folded, Page, Section, Table, write_files, zoomable

PAGE, TABLE = "corner.html", "corner.md"
SOMETIMES = ("laws.csv", "pulses.csv", "disturbed.csv", "survival.csv")
"""Tables of what was asked for beside the cases."""


def make_corner(
    out: Path,
    plan: CornerPlan,
    chosen: Mapping[str, Candidate | LawFamily],
    laws: Sequence[Candidate],
    test: Sequence[Member],
    training: Sequence[Member],
    engine: RunEngine,
    *,
    force: bool = False,
    progress: ProgressLine = silent,
    show_case: bool = False,
) -> tuple[Corner, pd.DataFrame, list[Path]]:
    """Runs what the folder does not hold yet, and writes tables and page; `CornerRuns.measure` has the arguments.

    With `show_case` the page shows the case in the middle: paths, and replays in step.

    Returns:
        What was measured, its summary, and the files.

    Raises:
        UserError: the folder is in use, or holds the runs of other parameters or versions; a case has no floor.
    """
    with open_runs(out, force=force) as store:
        remembering = RememberingEngine(engine, store, progress)
        with saying_how_to_go_on(progress, lambda: f"{len(store.rows)} runs"):
            corner = CornerRuns(plan, remembering).measure(chosen, laws, test, training)
        progress(f"{remembering.ran} runs made, the others were there")
    summary = summarise_corner(corner.cases, corner.candidates)
    tables = {"cases.csv": corner.cases, "summary.csv": summary}
    tables |= {"laws.csv": corner.laws} if len(corner.laws) else {}
    left_out = "".join(f" Left out: {words}." for words in corner.without_floor)
    words = how_measured(plan, test, training) + left_out
    markdown = "\n".join([words, "", *markdown_table(summary_cells(summary)), ""])
    if len(plan.pulses) > 1:
        table = corner_pulses(corner.cases)
        tables |= {"pulses.csv": table}
        markdown += "\n".join(["", WORDS, "", *markdown_table(pulse_rows(table)), ""])
    if len(corner.disturbed):
        tables |= {"disturbed.csv": corner.disturbed, "survival.csv": corner.survival}
        survival = markdown_table(survival_cells(corner.survival))
        markdown += "\n".join(["", disturbed_words(corner.disturbed), "", *survival, ""])
    drop_stale(out, SOMETIMES, tables)
    case = case_sections(plan, corner.candidates, test, corner.cases) if show_case and not plan.reduced else []
    page = corner_page(corner, summary, words, case)
    return corner, summary, write_files(out, {**tables, TABLE: markdown, PAGE: page})


def gains(cases: pd.DataFrame, over: str, value: str = "course_change_rad") -> pd.DataFrame:
    """The cases with `gain` of a value over that of another candidate in the same case.

    A candidate without a run that counts has turned nothing: its gain is -1; without one of the other there is none.
    """
    key = ["car", "speed_m_per_s", "floor", "pulse_s"]
    other = cases[cases["candidate"] == over].set_index(key)[value].rename("other")
    joined = cases.join(other, on=key)
    ratio = joined[value].fillna(0.0) / joined["other"]
    return joined.assign(gain=np.where(joined["other"].isna(), np.nan, ratio - 1.0))


def summarise_corner(cases: pd.DataFrame, candidates: Sequence[Candidate]) -> pd.DataFrame:
    """A row per candidate over all cases, then over those of each speed, floor and pulse, with medians.

    The worst car is that of the lowest median over its own cases.
    """
    speeds, floors = (sorted(cases[name].unique()) for name in ("speed_m_per_s", "floor"))
    parts = {"all": cases["floor"] > 0.0}
    parts |= {f"{speed:g} m/s": cases["speed_m_per_s"] == speed for speed in speeds}
    parts |= {f"floor x {floor:g}": cases["floor"] == floor for floor in floors}
    parts |= {f"pulse of {pulse:g} s": cases["pulse_s"] == pulse for pulse in sorted(cases["pulse_s"].unique())}
    references = {"no_tail": NO_TAIL.name, "published": THESIS.name}
    gained = {label: gains(cases, name) for label, name in references.items()}
    rows = []
    for part, inside in parts.items():
        for who in candidates:
            chosen = inside & (cases["candidate"] == who.name)
            own = cases[chosen]
            row: dict[str, Any] = {"cases": part, "candidate": who.name, "number": len(own)}
            row["without_a_turn_that_counts"] = int(own["course_change_rad"].isna().sum())
            row |= {f"median_{name}": float(own[name].median()) for name in ("steering_deg", *SHOWN[:4], *SHOWN[5:8])}
            for label, table in gained.items():
                mine = table[chosen]
                row[f"gain_over_{label}"] = float(mine["gain"].median())
                row[f"worst_car_over_{label}"] = float(mine.groupby("car")["gain"].median().min())
            if "fixed_course_change_rad" in cases:
                table = gains(cases, NO_TAIL.name, "fixed_course_change_rad")
                mine = table[chosen]
                row["fixed_without_a_turn_that_counts"] = int(mine["fixed_course_change_rad"].isna().sum())
                row["fixed_gain_over_no_tail"] = float(mine["gain"].median())
            times = [name for name in cases.columns if name.startswith("time_to_")]
            rows.append(row | {f"median_{name}": float(own[name].median()) for name in times})
    return make_frame(rows)


COLUMNS = {
    "candidate": "candidate",
    "number": "cases",
    "without_a_turn_that_counts": "without a turn",
    "median_steering_deg": "steering [deg]",
    "median_course_change_rad": "course [deg]",
    "gain_over_no_tail": "over no tail",
    "worst_car_over_no_tail": "worst car over no tail",
    "gain_over_published": "over published",
    "worst_car_over_published": "worst car over published",
    "median_exit_heading_change_rad": "heading [deg]",
    "median_average_linear_acceleration_m_per_s2": "mean a_y [m/s2]",
    "median_exit_time_s": "exit [s]",
    "median_exit_speed_m_per_s": "exit speed [m/s]",
    "median_peak_roll_rad": "peak roll [deg]",
    "median_two_wheel_time_s": "on two wheels [s]",
}
TRAINING = (
    "The published law and those that did best on reduced cars, on the full training cars at 2 ms, each with its best "
    "steering. Worth: course over that of the published law, half the mean over the cases, half that of the worst car. "
    "The law of the largest worth takes part."
)
FIXED = {
    "fixed_without_a_turn_that_counts": "without a turn, fixed steering",
    "fixed_gain_over_no_tail": "over no tail, fixed steering",
}
"""Of the summary, with the words of page and terminal; those of fixed steering and the times to courses follow."""


def summary_cells(summary: pd.DataFrame, cases: str = "all") -> tuple[list[str], list[list[str]]]:
    """Header and rows of the summary over some of the cases."""
    times = [name for name in summary.columns if name.startswith("median_time_to_")]
    shown = COLUMNS | {name: words for name, words in FIXED.items() if name in summary}
    shown |= {name: f"to {name.split('_')[3]} deg [s]" for name in times}
    own = summary[summary["cases"] == cases]
    return list(shown.values()), [[_cell(name, row[name]) for name in shown] for row in own.to_dict("records")]


def markdown_table(cells: tuple[list[str], list[list[str]]]) -> list[str]:
    """Lines of a header and rows."""
    header, rows = cells
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]


def corner_page(corner: Corner, summary: pd.DataFrame, how: str, case: Sequence[Section] = ()) -> Page:
    """What was measured, as a page, with the sections of a case that is shown."""
    own = {kind: [name for name in dict.fromkeys(summary["cases"]) if kind in name] for kind in ("m/s", "x", "pulse")}
    parts = [name for names in own.values() if len(names) > 1 for name in names]
    plot = zoomable(
        plot_gains(corner), "Dots: cases; bar: median.", "Gain in course over the car without tail", "gains"
    )
    by_part = [Section(f"Cases of {part}", [Table(*summary_cells(summary, part))]) for part in parts]
    longer = []
    if len(own["pulse"]) > 1:
        table = corner_pulses(corner.cases)
        lines = zoomable(
            plot_pulses(table), "Line: median; band: to the worst car.", "Gain over the length of the pulse", "pulses"
        )
        longer = [Section("How long a turn", [Finding([Table(*pulse_rows(table))]), WORDS, lines])]
    sections = [
        *longer,
        Section("All cases", [Finding([Table(*summary_cells(summary))]), how, plot]),
        *case,
        *by_part,
        Section("Each case", [Folded("Table", [_whole(corner.cases)])]),
    ]
    if len(corner.disturbed):
        survival = Table(*survival_cells(corner.survival))
        sections.insert(-1, Section("Disturbed runs", [Finding([survival]), disturbed_words(corner.disturbed)]))
    if len(corner.laws):
        sections.append(Section("Laws on the training cars", [TRAINING, _whole(corner.laws)]))
    return Page(
        "Who turns the car further", "Course turned by a short pulse of steering, each with its own best.", sections
    )


def corner_pulses(cases: pd.DataFrame) -> pd.DataFrame:
    """`gains_by_pulse` over the car without tail, which is left out."""
    table = gains(cases, NO_TAIL.name)
    return gains_by_pulse(table[table["candidate"] != NO_TAIL.name])


def plot_gains(corner: Corner) -> Figure:
    """Gain in course over the car without tail, a row per candidate."""
    table = gains(corner.cases, NO_TAIL.name)
    names = [who.name for who in corner.candidates if who.name != NO_TAIL.name]
    with styled():
        image, grid = new_figure(9.0, 1.2 + 0.5 * len(names))
        axes = grid[0, 0]
        for place, name in enumerate(reversed(names)):
            values = 100.0 * table[table["candidate"] == name]["gain"].to_numpy(float)
            axes.barh(place, np.nanmedian(values) if np.isfinite(values).any() else 0.0, color=BLUE, height=0.5)
            axes.plot(values, np.full(values.size, place), ".", color=GREY)
        axes.set_yticks(range(len(names)), list(reversed(names)))
        axes.set_xlabel("course over that without tail [%]")
    return image


def _whole(frame: pd.DataFrame) -> Table:
    rows = [[_cell_text(value) for value in row] for row in frame.itertuples(index=False)]
    return Table(list(frame.columns), rows)


def _cell_text(value: Any) -> str:
    """Numbers to four digits, nothing where there is none."""
    if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)):
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _cell(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    if value != value:
        return "-"
    if name == "number" or "without" in name:
        return f"{value:.0f}"
    if "_over_" in name:
        return f"{value:+.1%}"
    return f"{np.degrees(value):.1f}" if name.endswith("_rad") else f"{value:.2f}"


def how_measured(plan: CornerPlan, test: Sequence[Member], training: Sequence[Member]) -> str:
    """What was run, and which turns count, in words."""
    search, words = plan.search, "Reduced cars; nothing is proved on the full one. " if plan.reduced else ""
    low, high = (f"{np.degrees(angle):g}" for angle in (search.low, search.high))
    back = 1.0 - search.angle(0) / search.angle(STEP_BACK)
    return words + (
        f"Scenario {plan.scenario}; test cars {', '.join(car.name for car in test)}; training cars for laws "
        f"{', '.join(car.name for car in training) or 'none'}; speeds {_listed(plan.speeds)} m/s; floors "
        f"{_listed(plan.floors)} times the critical friction of the published swing at full lock; pulse "
        f"{_listed(plan.pulses)} s. "
        f"A run counts that is clean, with a peak roll of at most {MOST_ROLL:g} rad and a sideslip of at most "
        f"{MOST_SIDESLIP:g} rad at the exit. Steering from {low} to {high} degrees: {search.runs} runs of each shape "
        f"({_shapes(plan)}) at {1000 * plan.step:g} ms for each candidate and case; the best is proved at "
        f"{1000 * plan.fine_step:g} ms, {back:.1%} less each time it does not count there, at most {MOST_BACK} times. "
        "Gains are medians over the cases, -100 % in one without a turn that counts; all other columns are medians "
        "over the turns that count. The worst car is that of the lowest median gain over its own cases."
    )


def _shapes(plan: CornerPlan) -> str:
    words = (f"{ratio:g} times that for {hold:g} s first" if hold else "one level" for ratio, hold in plan.shapes)
    return "; ".join(words)


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
