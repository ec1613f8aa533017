"""Summary of a comparison over its cars, as a table for the terminal and as a page: medians, gains
over the car without tail, and their intervals.
"""

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.runs import make_frame
from aerodima.optimisation.swerve.candidate import LOW_BALLAST, NO_TAIL
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.core.array_types import FloatArray, Pair, Texts
from aerodima.workbench.core.text_table import text_table
from aerodima.workbench.view.figure_style import BLUE, SKY, new_figure, styled
from aerodima.workbench.view.report_page import Page, Plot, Section, Table, percent

GROUP = ["plant", "tail", "floor", "aim", "speed_m_per_s"]
"""Columns that identify a comparison."""
PLACE = [*GROUP, "car"]
"""Columns that identify a swerve; every candidate has one row in each."""
RESAMPLES = 4000
"""Number of resamples of the cars in a bootstrap."""
_HEADER = ("candidate", "median", "cars", "over no tail", "95 %", "worst", "above low ballast")


def gains_over(table: pd.DataFrame, candidate: str) -> pd.Series:
    """Computes the gain of each row's value over that of a candidate in the same swerve, as a share
    of the size of the latter; NaN where either has none.
    """
    named = table[table["candidate"] == candidate].set_index(PLACE)["value"].rename("other")
    others = table.join(named, on=PLACE)["other"]
    return ((table["value"] - others) / others.abs()).rename("gain")


def summarise_swerves(table: pd.DataFrame, seed: int = 1) -> pd.DataFrame:
    """Makes a row per comparison and candidate: median value over the cars, how many cars have one,
    the median gain over the car without tail with its 95 % interval from a bootstrap over cars, the
    worst gain, and on how many cars the value is above that of low ballast (NaN if that was not
    compared).

    Args:
        table: table of `compare_swerves`.
        seed: seed of the bootstrap.
    """
    over_none = gains_over(table, NO_TAIL.name)
    over_ballast = gains_over(table, LOW_BALLAST.name)
    has_ballast = LOW_BALLAST.name in table["candidate"].unique()
    rows: list[Row] = []
    for names, own in table.groupby([*GROUP, "candidate"], sort=False):
        gains = over_none[own.index].dropna()
        low, high = median_interval(gains.to_numpy(dtype=np.float64), seed)
        above = float((over_ballast[own.index] > 0.0).sum()) if has_ballast else math.nan
        places: dict[str, Any] = dict(zip([*GROUP, "candidate"], names, strict=True))
        rows.append(
            {
                **places,
                "median": float(own["value"].median()),
                "cars": len(own),
                "with_value": int(own["value"].count()),
                "gain": float(gains.median()),
                "gain_low": low,
                "gain_high": high,
                "gain_worst": float(gains.min()),
                "above_low_ballast": above,
            }
        )
    return make_frame(rows)


def has_gain(summary: pd.DataFrame) -> bool:
    """Returns whether any tail has a median gain above 0; True if no tail was compared."""
    names = summary["candidate"]
    with_tail = summary[~names.str.startswith(NO_TAIL.name) & (names != LOW_BALLAST.name)]
    return with_tail.empty or bool((with_tail["gain"] > 0.0).any())


def median_interval(values: FloatArray, seed: int) -> Pair:
    """Computes the 95 % interval of the median over cars, which are resampled with replacement; NaN
    without a car.

    Args:
        values: value of each car (n,).
        seed: seed of the resampling.
    """
    if not values.size:
        return math.nan, math.nan
    drawn = np.random.default_rng(seed).integers(values.size, size=(RESAMPLES, values.size))
    low, high = np.quantile(np.median(values[drawn], axis=1), [0.025, 0.975])
    return float(low), float(high)


def swerve_lines(summary: pd.DataFrame) -> list[str]:
    """Makes a table for the terminal: a heading per comparison, a line per candidate."""
    rows: list[Texts] = []
    for names, own in summary.groupby(GROUP, sort=False):
        rows += [(_title(names),), *_cells(own)]
    return text_table(_HEADER, rows)


def swerve_page(table: pd.DataFrame, summary: pd.DataFrame) -> Page:
    """Makes a page with a table and a picture for every comparison."""
    sections = []
    for names, own in summary.groupby(GROUP, sort=False):
        title = _title(names)
        chosen = (table[GROUP] == list(names)).all(axis=1)
        words = "A dot for every car, a bar over the 95 % interval of their median"
        plot = Plot(swerve_figure(table[chosen], title), "", words)
        sections.append(Section(title, [plot, Table(_HEADER, _cells(own))]))
    cars = ", ".join(dict.fromkeys(table["car"]))
    lead = (
        f"Each candidate with its own best steering; cars {cars}. Values count where the car is "
        "straight at the start, upright to the end, and straight again there."
    )
    return Page("Swerves", lead, sections)


def _title(names: Any) -> str:
    plant, tail, floor, aim, speed = names
    return f"{aim} at {speed:g} m/s, {plant} cars, {tail} tail, friction {floor}"


def _cells(summary: pd.DataFrame) -> list[Texts]:
    return [
        (
            str(row["candidate"]),
            "–" if math.isnan(row["median"]) else f"{row['median']:.3g}",
            f"{row['with_value']:.0f} of {row['cars']:.0f}",
            _percent(row["gain"]),
            f"{_percent(row['gain_low'])} to {_percent(row['gain_high'])}",
            _percent(row["gain_worst"]),
            f"{row['above_low_ballast']:.0f}".replace("nan", "–"),
        )
        for row in summary.to_dict("records")
    ]


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else percent(share)


@styled()
def swerve_figure(table: pd.DataFrame, title: str) -> Figure:
    """Plots the gains over the car without tail in one comparison, a line per candidate: a dot for
    every car, a bar over the 95 % interval of their median.
    """
    gains = 100.0 * gains_over(table, NO_TAIL.name)
    candidates = [name for name in dict.fromkeys(table["candidate"]) if name != NO_TAIL.name][::-1]
    figure, axes = new_figure(9.0, 1.1 + 0.34 * len(candidates))
    axis = axes[0, 0]
    for index, candidate in enumerate(candidates):
        values = gains[table["candidate"] == candidate].dropna().to_numpy(dtype=np.float64)
        low, high = median_interval(values, seed=1)
        axis.barh(index, high - low, left=low, height=0.6, color=SKY)
        axis.plot(values, np.full(len(values), index), "o", color=BLUE, markersize=3)
    axis.axvline(0.0, color=BLUE, linewidth=0.8)
    axis.set_yticks(range(len(candidates)), candidates)
    axis.set_xlabel("gain over the same car without tail, %")
    axis.set_title(title)
    return figure
