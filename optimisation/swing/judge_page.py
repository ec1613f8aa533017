"""The tables and the page of a judgement, and its middle case driven once more: paths, and replays in step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.swing.candidate import NO_TAIL
from aerodima.optimisation.swing.judge import Judgement, gains, middle_case
from aerodima.optimisation.swing.task import CASE, Task
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.figures.figure_style import BLUE, GREY, new_figure, styled
from aerodima.workbench.figures.run_figures import RUN_STYLES
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.report.replay_page import replays_in_step
from aerodima.workbench.report.report_page import Finding, Folded, Page, Plot, Section, Table, write_files, zoomable
from aerodima.workbench.text_table import shown_value

PAGE = "judge.html"
MARKS = 0.25
"""Between two marks on a path, s."""
SHOWN_AFTER = 1.0
"""How long a run that is shown goes on after the steering, s."""
MOST_SHOWN = 6
"""Candidates that are driven again: those with the largest courses, and the car without tail."""

GAIN, WHOLE, DECIMALS = "{:+.1%}".format, "{:.0f}".format, "{:.2f}".format


def _degrees(value: float) -> str:
    return f"{math.degrees(value):.1f}"


SUMMARY: dict[str, tuple[str, Callable[[Any], str]]] = {
    "candidate": ("candidate", str),
    "number": ("cases", WHOLE),
    "without_a_turn_that_counts": ("without a turn", WHOLE),
    "median_steering_deg": ("steering [deg]", DECIMALS),
    "median_course_change_rad": ("course [deg]", _degrees),
    "gain_over_no_tail": ("over no tail", GAIN),
    "worst_car_over_no_tail": ("worst car over no tail", GAIN),
    "gain_over_published": ("over published", GAIN),
    "worst_car_over_published": ("worst car over published", GAIN),
    "median_exit_heading_change_rad": ("heading [deg]", _degrees),
    "median_average_linear_acceleration_m_per_s2": ("mean a_y [m/s2]", DECIMALS),
    "median_exit_time_s": ("exit [s]", DECIMALS),
    "median_exit_speed_m_per_s": ("exit speed [m/s]", DECIMALS),
    "median_peak_roll_rad": ("peak roll [deg]", _degrees),
    "median_two_wheel_time_s": ("on two wheels [s]", DECIMALS),
}
"""Column of the summary -> its words on page and terminal, and how a value is written."""


def write_judgement(out: Path, task: Task, found: Judgement, *, replays: bool = True) -> list[Path]:
    """Writes `cases.csv`, `summary.csv` and the page; returns the files."""
    tables = {"cases.csv": found.cases, "summary.csv": found.summary}
    sections = _case_sections(task, found) if replays else []
    return write_files(out, {**tables, PAGE: judge_page(task, found, sections)}, force=True)


def judge_page(task: Task, found: Judgement, shown: list[Section]) -> Page:
    """The page, with the sections of the case that is shown."""
    names = dict.fromkeys(found.summary["cases"])
    own = [[name for name in names if kind in name] for kind in ("m/s", "x")]
    parts = [name for names in own if len(names) > 1 for name in names]
    plot = zoomable(plot_gains(found), "Dots: cases; bar: median.", "Gain in course over the car without tail", "gains")
    asked = [[key, str(value)] for key, value in task.model_dump(by_alias=True).items()]
    asked += [["without a floor", words] for words in found.without_floor]
    sections = [
        Section("All cases", [Finding([Table(*summary_cells(found.summary))]), plot]),
        *shown,
        *(Section(f"Cases of {part}", [Table(*summary_cells(found.summary, part))]) for part in parts),
        Section("Task", [Folded("Numbers of the task", [Table(["key", "value"], asked)])]),
        Section("Each case", [Folded("Table", [frame_table(found.cases)])]),
    ]
    return Page(
        "Who turns the car further", "Course turned by a short pulse of steering, each with its own best.", sections
    )


def summary_cells(summary: pd.DataFrame, cases: str = "all") -> tuple[list[str], list[list[str]]]:
    """Header and rows of the summary over some of the cases."""
    rows = summary.loc[summary["cases"] == cases, list(SUMMARY)].itertuples(index=False)
    forms = [form for _, form in SUMMARY.values()]
    cells = [["-" if pd.isna(value) else form(value) for form, value in zip(forms, row, strict=True)] for row in rows]
    return [words for words, _ in SUMMARY.values()], cells


def plot_gains(found: Judgement) -> Figure:
    """Gain in course over the car without tail, a row per candidate."""
    table = gains(found.cases, NO_TAIL.name)
    names = [who.name for who in found.candidates if who.name != NO_TAIL.name]
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


def plot_paths(runs: Mapping[str, RunLog]) -> Figure:
    """Paths of the centre of mass from the steering command on, with the heading there along the first axis."""
    with styled():
        image, grid = new_figure(8.0, 4.2)
        axes = grid[0, 0]
        for (name, run_log), (colour, line) in zip(runs.items(), cycle(RUN_STYLES), strict=False):
            begin = run_log.scenario["manoeuvre"]["turn_start"]
            late = run_log.time >= begin
            yaw = float(run_log.signal("yaw_truth_rad")[late][0])
            points = run_log.vector("com", "truth_m")[late, :2]
            ahead = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
            x, y = ahead @ (points - points[0]).T
            axes.plot(x, y, color=colour, linestyle=line, label=name)
            time = run_log.time[late] - begin
            marks = np.searchsorted(time, np.arange(MARKS, time[-1] + 1e-9, MARKS))
            axes.plot(x[marks], y[marks], ".", color=colour)
        axes.set_aspect("equal")
        axes.set_xlabel("ahead [m]")
        axes.set_ylabel("to the left [m]")
        axes.legend()
    return image


def _case_sections(task: Task, found: Judgement) -> list[Section]:
    """The section that shows the middle case; empty where no case can be shown."""
    case = middle_case(found.cases)
    if case is None:
        return []
    first, others = (case[(case["candidate"] == NO_TAIL.name) == one] for one in (True, False))
    rows = pd.concat([first, others.nlargest(MOST_SHOWN - 1, "course_change_rad")]).to_dict("records")
    runs = {row["candidate"]: _drive_again(task, found, row) for row in rows}
    names = [f"{row['candidate']}: {math.degrees(row['course_change_rad']):.0f}°" for row in rows]
    header = [*CASE, "friction"]
    paths = Plot(
        plot_paths(dict(zip(names, runs.values(), strict=True))),
        f"From above, from the steering command on; a mark every {MARKS:g} s.",
        "Paths of the candidates over one another",
    )
    which = Table(header, [[_cell_text(rows[0][name]) for name in header]])
    return [Section("The case with the median gain", [which, paths, replays_in_step(list(runs.values()), names)])]


def _drive_again(task: Task, found: Judgement, row: Mapping[Any, Any]) -> RunLog:
    """The run of a row of the table, at the fine step, with everything logged."""
    from aerodima.workbench.simulate.simulation import simulate  # loads Drake

    who = next(one for one in found.candidates if one.name == row["candidate"])
    run = task.run(task.steered_turn(who, row), task.fine_step, SHOWN_AFTER)
    return simulate(load_scenario(run.scenario, run.settings))


def frame_table(frame: pd.DataFrame) -> Table:
    """All of a table, numbers to four digits."""
    rows = [[_cell_text(value) for value in row] for row in frame.itertuples(index=False)]
    return Table(list(frame.columns), rows)


def _cell_text(value: Any) -> str:
    """Nothing where there is none."""
    return "" if pd.isna(value) else shown_value(value)
