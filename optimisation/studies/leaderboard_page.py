"""The leaderboard as tables (CSV, Markdown) and as one HTML page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.corner_page import markdown_table
from aerodima.optimisation.studies.study_report import table_cells
from aerodima.workbench.figures.figure_style import BLACK, BLUE, new_figure, styled
from aerodima.workbench.report.report_page import Finding, Folded, Page, Section, Table, write_files, zoomable

PAGE, TABLE = "leaderboard.html", "leaderboard.md"
RULES = (
    "Each law has the steering of one level that turns the course furthest in each case: nine amplitudes from 2 to 30 "
    "degrees at 2 ms, the best proved at 0.5 ms and lowered by 2.1 % at a time until it counts there. A run counts "
    "that is clean, with a peak roll of at most 0.35 rad and a sideslip of at most 0.1 rad at the exit: straight "
    "wheels and a yaw rate below 0.1 rad/s. A case without one is a gain of -100 %; course and exit are medians over "
    "the turns that count. The score is the median gain in course over the car without tail; in brackets its 95 % "
    "interval by bootstrap over the cars, too narrow with so few of them. Worst car: the lowest median over a car's "
    "own cases."
)
HEADER = [
    "law",
    "cases",
    "without a turn",
    "course [deg]",
    "over no tail",
    "worst car",
    "over published",
    "worst car",
    "exit [s]",
]


def score_cells(scores: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Header and rows for page and terminal."""
    rows = []
    for row in scores.to_dict("records"):
        cells = [str(row["law"]), f"{row['cases']:.0f}", f"{row['without_a_turn_that_counts']:.0f}"]
        cells.append(f"{np.degrees(row['median_course_change_rad']):.1f}")
        for label in ("no_tail", "published"):
            middle, low, high = (row[f"{end}gain_over_{label}"] for end in ("", "low_", "high_"))
            cells += [f"{middle:+.1%} ({low:+.1%} to {high:+.1%})", f"{row[f'worst_car_over_{label}']:+.1%}"]
        rows.append([*cells, f"{row['median_exit_time_s']:.2f}"])
    return list(HEADER), rows


def write_leaderboard(folder: Path, cases: pd.DataFrame, scores: pd.DataFrame, words: str) -> list[Path]:
    """Writes `cases.csv`, `scores.csv`, the table in Markdown, and the page, which is the last of the files."""
    markdown = "\n".join([words, "", *markdown_table(score_cells(scores)), "", RULES, ""])
    plot = zoomable(plot_scores(scores), "Bar: median; line: 95 % interval.", "Gain in course by law", "scores")
    everything = Table(list(cases.columns), table_cells(cases, list(cases.columns)))
    sections = [
        Section("Scores", [Finding([Table(*score_cells(scores))]), words, RULES, plot]),
        Section("Each case", [Folded("Table", [everything])]),
    ]
    page = Page("Leaderboard", "How much further laws of the tail turn cars that they have never seen.", sections)
    return write_files(folder, {"cases.csv": cases, "scores.csv": scores, TABLE: markdown, PAGE: page})


def plot_scores(scores: pd.DataFrame) -> Figure:
    """Median gain over no tail with its interval, the best law at the top."""
    with styled():
        image, grid = new_figure(9.0, 1.2 + 0.5 * len(scores))
        axes = grid[0, 0]
        ends = (f"{end}gain_over_no_tail" for end in ("", "low_", "high_"))
        middle, low, high = (100.0 * scores[name].to_numpy(float)[::-1] for name in ends)
        places = range(len(scores))
        axes.barh(places, middle, color=BLUE, height=0.5)
        axes.hlines(places, low, high, color=BLACK, linewidth=1.5)
        axes.set_yticks(places, list(scores["law"])[::-1])
        axes.set_xlabel("course over that without tail [%]")
    return image
