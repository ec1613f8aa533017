"""What entry speeds of many cars come to: medians, gains over others, how sure they are."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.judge.candidate import HELD, LOW_BALLAST, NO_TAIL, THESIS
from aerodima.optimisation.judge.entry_rule import ERROR
from aerodima.optimisation.judge.entry_speed import NO_REFERENCE, NOT_CONFIRMED
from aerodima.optimisation.studies.runs import make_frame
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.text_table import text_table
from aerodima.workbench.view.figure_style import BLUE, SKY, new_figure, styled
from aerodima.workbench.view.report_page import Bullets, Finding, Page, Plot, Section, Table

SPEED = "entry_speed_m_per_s"
CASE = ["manoeuvre", "car", "floor"]
"""Columns that name a case; every candidate has one row in each."""
REFERENCES: Mapping[str, tuple[str, ...]] = {
    "no_tail": (NO_TAIL.name,),
    "low_mass": (LOW_BALLAST.name,),
    "better_tail": (HELD.name, THESIS.name),
}
"""What gains are over, each time the fastest of these candidates in the same case."""
UNKNOWN = (ERROR, NO_REFERENCE, NOT_CONFIRMED)
"""How `ended_by` begins where an entry speed is not known."""
RESAMPLES = 4000
"""Draws of cars in a bootstrap."""
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


def known_speeds(table: pd.DataFrame) -> pd.Series:
    """Returns entry speeds (rows of the table), m/s; NaN where there is none or it is not known."""
    return table[SPEED].mask(_is_unknown(table))


def _is_unknown(table: pd.DataFrame) -> pd.Series:
    return table["ended_by"].astype(str).str.startswith(UNKNOWN)


def entry_gains(table: pd.DataFrame, over: tuple[str, ...]) -> pd.Series:
    """Computes the gain in entry speed of each row over the fastest of other candidates in the same
    case; index as the table's.

    A candidate that completes the manoeuvre at no speed has the gain -1. NaN where the entry speed
    of either is not known: a run came to nothing, the fine step bore no speed out, or there was no
    reference.

    Args:
        table: of `climb`.
        over: names of the other candidates; those that the table lacks are left out.
    """
    speeds = known_speeds(table)
    references = table.assign(known=speeds)[table["candidate"].isin(over)]
    fastest = references.groupby(CASE)["known"].max().rename("other")
    other = table.join(fastest, on=CASE)["other"]
    never = table[SPEED].isna() & ~_is_unknown(table)
    ratio = speeds.mask(never, 0.0) / other
    return (ratio - 1.0).rename("gain")


def summarise_entries(table: pd.DataFrame, seed: int = 1) -> pd.DataFrame:
    """Makes a row per manoeuvre and candidate, in the order of the table.

    A car's gain is its median over the floors. For each reference of `REFERENCES`: `gain_over_...`,
    the median over the cars; `worst_over_...`, that of the worst car; `low_over_...` and
    `high_over_...`, the ends of the 95 % interval of the median, from a bootstrap over the cars;
    `cars_over_...`, how many cars have a gain. NaN where none has.

    Args:
        table: of `climb`.
        seed: of the bootstrap.
    """
    gains = {label: entry_gains(table, over) for label, over in REFERENCES.items()}
    rows = []
    for (manoeuvre, who), own in table.groupby(["manoeuvre", "candidate"], sort=False):
        ended_by = own["ended_by"].fillna("").astype(str)
        row: Row = {
            "manoeuvre": manoeuvre,
            "candidate": who,
            "number": len(own),
            "without_entry": int(own[SPEED].isna().sum()),
            "at_ceiling": int(own["at_ceiling"].sum()),
            "unknown": int(_is_unknown(own).sum()),
            "ended_by": ended_by.mode().iloc[0],
            "median_m_per_s": float(known_speeds(own).median()),
            "median_course_rad": float(own["course_change_rad"].median()),
        }
        for label, gain in gains.items():
            medians = gain[own.index].groupby(own["car"]).median()
            cars = medians.dropna().to_numpy(dtype=np.float64)
            low, high = median_interval(cars, seed)
            middle = math.nan
            worst = math.nan
            if cars.size:
                middle = float(np.median(cars))
                worst = float(cars.min())
            row[f"gain_over_{label}"] = middle
            row[f"worst_over_{label}"] = worst
            row[f"low_over_{label}"] = low
            row[f"high_over_{label}"] = high
            row[f"cars_over_{label}"] = int(cars.size)
        rows.append(row)
    return make_frame(rows)


def has_gain(summary: pd.DataFrame) -> bool:
    """Whether a tail enters faster than the car without one; True when none was judged."""
    without = summary["candidate"].isin([NO_TAIL.name, LOW_BALLAST.name])
    with_tail = summary[~without]
    if with_tail.empty:
        return True
    return bool((with_tail["gain_over_no_tail"] > 0.0).any())


def median_interval(cars: FloatArray, seed: int) -> tuple[float, float]:
    """Computes the 95 % interval of the median over cars, which are drawn again with replacement;
    NaN without a car.

    Args:
        cars: a value of each (n,).
        seed: of the draws.
    """
    if not cars.size:
        return math.nan, math.nan
    generator = np.random.default_rng(seed)
    drawn = generator.integers(cars.size, size=(RESAMPLES, cars.size))
    medians = np.median(cars[drawn], axis=1)
    low, high = np.quantile(medians, [0.025, 0.975])
    return float(low), float(high)


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
        speed = best["median_m_per_s"]
        if math.isnan(speed):
            fastest.append(f"{manoeuvre}: none")
        else:
            fastest.append(f"{manoeuvre}: {best['candidate']}, {speed:.2f} m/s")
        figure = entry_figure(table[table["manoeuvre"] == manoeuvre])
        words = (
            f"Entry speeds in the manoeuvre {manoeuvre}: a dot for every car, a bar at the median"
        )
        table_of = Table(_HEADER, _cells(own))
        sections.append(Section(str(manoeuvre), [Plot(figure, "", words), table_of]))
    cars = ", ".join(dict.fromkeys(table["car"]))
    floors = ", ".join(dict.fromkeys(table["floor"]))
    lead = (
        f"Highest speeds at which manoeuvres are completed without tip-up; cars {cars} on "
        f"floors {floors}"
    )
    highest = Section("Highest median", [Finding([Bullets(fastest)])])
    return Page("Entry speeds", lead, [highest, *sections])


def _cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    return [_row_cells(row) for row in summary.to_dict("records")]


def _row_cells(row: dict[Any, Any]) -> tuple[str, ...]:
    speed = row["median_m_per_s"]
    course = row["median_course_rad"]
    low = row["low_over_no_tail"]
    interval = "–"
    if not math.isnan(low):
        interval = f"{_percent(low)} to {_percent(row['high_over_no_tail'])}"
    return (
        str(row["candidate"]),
        "–" if math.isnan(speed) else f"{speed:.2f}",
        "–" if math.isnan(course) else f"{math.degrees(course):.0f}",
        f"{row['without_entry']:.0f} of {row['number']:.0f}",
        f"{row['unknown']:.0f}",
        f"{row['at_ceiling']:.0f}",
        _percent(row["gain_over_no_tail"]),
        interval,
        _percent(row["worst_over_no_tail"]),
        _percent(row["gain_over_low_mass"]),
        _percent(row["gain_over_better_tail"]),
        row["ended_by"],
    )


@styled()
def entry_figure(table: pd.DataFrame) -> Figure:
    """Plots the entry speeds of all cars by surface and manoeuvre, a line per candidate, with the
    median as a bar.
    """
    names = list(dict.fromkeys(table["manoeuvre"]))
    floors = list(dict.fromkeys(table["floor"]))
    who = list(dict.fromkeys(table["candidate"]))[::-1]
    height = (0.9 + 0.34 * len(who)) * len(floors)
    figure, axes = new_figure(9.0, height, len(floors), len(names), sharex=True, sharey=True)
    for axis, (floor, name) in zip(axes.flat, itertools.product(floors, names), strict=True):
        own = table[(table["manoeuvre"] == name) & (table["floor"] == floor)]
        for index, candidate in enumerate(who):
            speeds = own.loc[own["candidate"] == candidate, SPEED]
            values = speeds.to_numpy(dtype=np.float64)
            if np.isfinite(values).any():
                axis.barh(index, np.nanmedian(values), height=0.6, color=SKY)
            axis.plot(values, np.full(len(values), index), "o", color=BLUE, markersize=3)
        axis.set_yticks(range(len(who)), who)
    for top, bottom, name in zip(axes[0], axes[-1], names, strict=True):
        top.set_title(name)
        bottom.set_xlabel("m/s")
    for axis, floor in zip(axes[:, 0], floors, strict=True):
        axis.set_ylabel(f"friction {floor}")
    return figure


def _percent(share: float) -> str:
    if math.isnan(share):
        return "–"
    return f"{100.0 * share:+.1f} %"
