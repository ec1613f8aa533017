"""Page, picture and terminal table of entry speeds."""

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.judge.entry_table import SPEED
from aerodima.workbench.core.text_table import text_table
from aerodima.workbench.view.figure_style import BLUE, SKY, new_figure, styled
from aerodima.workbench.view.report_page import Bullets, Finding, Page, Plot, Section, Table

UNKNOWN = "–"
"""Stands for a number that is not known."""
_HEADER = (
    "candidate",
    "m/s",
    "course [deg]",
    "none",
    "unknown",
    "ceiling",
    "over no tail",
    "95 % of cars drawn again",
    "worst car",
    "over low mass",
    "over held or published",
    "most end by",
)


def entry_lines(summary: pd.DataFrame) -> list[str]:
    """Makes a table for the terminal: each manoeuvre is a heading, and every candidate has a line
    below it.
    """
    rows: list[tuple[str, ...]] = []
    for manoeuvre, own in summary.groupby("manoeuvre", sort=False):
        rows += [(str(manoeuvre),), *_cells(own)]
    return text_table(_HEADER, rows)


def entry_page(table: pd.DataFrame, summary: pd.DataFrame) -> Page:
    """Makes a page: the fastest candidate of each manoeuvre first, then a table and a picture for
    every manoeuvre.
    """
    fastest = []
    sections = []
    for manoeuvre, own in summary.groupby("manoeuvre", sort=False):
        best = own.sort_values("median_m_per_s", ascending=False, kind="stable").iloc[0]
        words = "none"
        if not math.isnan(best["median_m_per_s"]):
            words = f"{best['candidate']}, {best['median_m_per_s']:.2f} m/s"
        fastest.append(f"{manoeuvre}: {words}")
        figure = entry_figure(table[table["manoeuvre"] == manoeuvre])
        words = (
            f"Entry speeds in the manoeuvre {manoeuvre}: a dot for every car, a bar at the median"
        )
        table_of = Table(_HEADER, _cells(own))
        sections.append(Section(str(manoeuvre), [Plot(figure, "", words), table_of]))
    cars = ", ".join(dict.fromkeys(table["car"]))
    surfaces = ", ".join(dict.fromkeys(table["floor"]))
    lead = (
        f"Highest speeds at which manoeuvres are completed without tip-up; cars {cars} on "
        f"floors {surfaces}"
    )
    highest = Section("Highest median", [Finding([Bullets(fastest)])])
    return Page("Entry speeds", lead, [highest, *sections])


def _cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    return [_row_cells(row) for row in summary.to_dict("records")]


def _row_cells(row: dict[Any, Any]) -> tuple[str, ...]:
    low, high, gain, worst, over_low_mass, over_tails = (
        _known(100.0 * row[key], "{:+.1f} %")
        for key in (
            "low_over_no_tail",
            "high_over_no_tail",
            "gain_over_no_tail",
            "worst_over_no_tail",
            "gain_over_low_mass",
            "gain_over_better_tail",
        )
    )
    return (
        str(row["candidate"]),
        _known(row["median_m_per_s"], "{:.2f}"),
        _known(math.degrees(row["median_course_rad"]), "{:.0f}"),
        f"{row['without_entry']:.0f} of {row['number']:.0f}",
        f"{row['unknown']:.0f}",
        f"{row['at_ceiling']:.0f}",
        gain,
        low if low == UNKNOWN else f"{low} to {high}",
        worst,
        over_low_mass,
        over_tails,
        row["ended_by"],
    )


def _known(value: float, words: str) -> str:
    return UNKNOWN if math.isnan(value) else words.format(value)


@styled()
def entry_figure(table: pd.DataFrame) -> Figure:
    """Plots the entry speeds of all cars in one manoeuvre by surface, a line per candidate, with
    the median as a bar.
    """
    surfaces = list(dict.fromkeys(table["floor"]))
    candidates = list(dict.fromkeys(table["candidate"]))[::-1]
    height = (0.9 + 0.34 * len(candidates)) * len(surfaces)
    figure, axes = new_figure(9.0, height, len(surfaces), sharex=True, sharey=True)
    for axis, surface in zip(axes[:, 0], surfaces, strict=True):
        own = table[table["floor"] == surface]
        for index, candidate in enumerate(candidates):
            values = own.loc[own["candidate"] == candidate, SPEED].to_numpy(dtype=np.float64)
            if np.isfinite(values).any():
                axis.barh(index, np.nanmedian(values), height=0.6, color=SKY)
            axis.plot(values, np.full(len(values), index), "o", color=BLUE, markersize=3)
        axis.set_yticks(range(len(candidates)), candidates)
        axis.set_ylabel(f"friction {surface}")
    axes[0, 0].set_title(table["manoeuvre"].iloc[0])
    axes[-1, 0].set_xlabel("m/s")
    return figure
