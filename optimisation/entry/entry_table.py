"""What entry speeds of many cars come to: medians, gains over other candidates, and how sure they
are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.entry.entry_speed import ERROR, NO_REFERENCE, NOT_PROVED
from aerodima.optimisation.sweep.runs import make_frame
from aerodima.optimisation.swing.candidate import HELD, LOW_BALLAST, NO_TAIL, THESIS
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.figures.figure_style import BLUE, SKY, new_figure, styled
from aerodima.workbench.report.report_page import Bullets, Finding, Page, Plot, Section, Table
from aerodima.workbench.text_table import text_table

SPEED = "entry_speed_m_per_s"
CASE = ["manoeuvre", "car", "floor"]
"""Columns that name a case; every candidate has one row in each."""
REFERENCES: Mapping[str, tuple[str, ...]] = {
    "no_tail": (NO_TAIL.name,),
    "low_mass": (LOW_BALLAST.name,),
    "better_tail": (HELD.name, THESIS.name),
}
"""What gains are over, each time the fastest of these candidates in the same case."""
UNKNOWN = (ERROR, NO_REFERENCE, NOT_PROVED)
"""How `ended_by` begins where an entry speed is not known."""
RESAMPLES = 4000
"""Draws of cars in a bootstrap."""
_HEADER = (
    *(
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
    ),
    *("over held or published", "most end by"),
)


def known_speeds(table: pd.DataFrame) -> pd.Series:
    """Entry speeds (rows of the table), m/s; NaN where there is none or it is not known."""
    return table[SPEED].mask(table["ended_by"].astype(str).str.startswith(UNKNOWN))


def entry_gains(table: pd.DataFrame, over: tuple[str, ...]) -> pd.Series:
    """Gain in entry speed of each row over the fastest of other candidates in the same case; index
    as the table's.

    A candidate that completes the manoeuvre at no speed has the gain -1. NaN where the entry speed
    of either is not known: a run came to nothing, the fine step bore no speed out, or there was no
    reference.

    Args:
        table: of `climb`.
        over: names of the other candidates; those that the table lacks are left out.
    """
    speeds = known_speeds(table)
    other = (
        table.assign(known=speeds)[table["candidate"].isin(over)]
        .groupby(CASE)["known"]
        .max()
        .rename("other")
    )
    never = table[SPEED].isna() & ~table["ended_by"].astype(str).str.startswith(UNKNOWN)
    ratio = speeds.mask(never, 0.0) / table.join(other, on=CASE)["other"]
    return (ratio - 1.0).rename("gain")


def summarise_entries(table: pd.DataFrame, seed: int = 1) -> pd.DataFrame:
    """A row per manoeuvre and candidate, in the order of the table.

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
        row: dict[str, Any] = {"manoeuvre": manoeuvre, "candidate": who, "number": len(own)}
        row |= {
            "without_entry": int(own[SPEED].isna().sum()),
            "at_ceiling": int(own["at_ceiling"].sum()),
        }
        row["unknown"] = int(own["ended_by"].astype(str).str.startswith(UNKNOWN).sum())
        row["ended_by"] = own["ended_by"].fillna("").astype(str).mode().iloc[0]
        row["median_m_per_s"] = float(known_speeds(own).median())
        row["median_course_rad"] = float(own["course_change_rad"].median())
        for label, gain in gains.items():
            cars = gain[own.index].groupby(own["car"]).median().dropna().to_numpy(dtype=np.float64)
            low, high = median_interval(cars, seed)
            row |= {f"gain_over_{label}": float(np.median(cars)) if cars.size else math.nan}
            row |= {f"worst_over_{label}": float(cars.min()) if cars.size else math.nan}
            row |= {
                f"low_over_{label}": low,
                f"high_over_{label}": high,
                f"cars_over_{label}": int(cars.size),
            }
        rows.append(row)
    return make_frame(rows)


def has_gain(summary: pd.DataFrame) -> bool:
    """Whether a candidate with a tail enters faster than the car without one; True when none was
    judged.
    """
    with_tail = summary[~summary["candidate"].isin([NO_TAIL.name, LOW_BALLAST.name])]
    return with_tail.empty or bool((with_tail["gain_over_no_tail"] > 0.0).any())


def median_interval(cars: FloatArray, seed: int) -> tuple[float, float]:
    """Ends of the 95 % interval of the median over cars, which are drawn again with replacement;
    NaN without a car.

    Args:
        cars: a value of each (n,).
        seed: of the draws.
    """
    if not cars.size:
        return math.nan, math.nan
    drawn = np.random.default_rng(seed).integers(cars.size, size=(RESAMPLES, cars.size))
    low, high = np.quantile(np.median(cars[drawn], axis=1), [0.025, 0.975])
    return float(low), float(high)


def entry_lines(summary: pd.DataFrame) -> list[str]:
    """Lines of a table for the terminal: each manoeuvre is a heading, and every candidate has a
    line below it.
    """
    rows: list[tuple[str, ...]] = []
    for manoeuvre, own in summary.groupby("manoeuvre", sort=False):
        rows += [(str(manoeuvre),), *_cells(own)]
    return text_table(_HEADER, rows)


def entry_page(table: pd.DataFrame, summary: pd.DataFrame) -> Page:
    """A page: the fastest candidate of each manoeuvre first, then a table and a picture for every
    manoeuvre.
    """
    fastest = []
    sections = []
    for manoeuvre, own in summary.groupby("manoeuvre", sort=False):
        best = own.sort_values("median_m_per_s", ascending=False, kind="stable").iloc[0]
        none = math.isnan(best["median_m_per_s"])
        fastest.append(
            f"{manoeuvre}: "
            + ("none" if none else f"{best['candidate']}, {best['median_m_per_s']:.2f} m/s")
        )
        figure = entry_figure(table[table["manoeuvre"] == manoeuvre])
        plot = Plot(
            figure,
            "",
            f"Entry speeds in the manoeuvre {manoeuvre}: a dot for every car, a bar at the median",
        )
        sections.append(Section(str(manoeuvre), [plot, Table(_HEADER, _cells(own))]))
    cars, floors = (", ".join(dict.fromkeys(table[key])) for key in ("car", "floor"))
    lead = (
        f"Highest speeds at which manoeuvres are completed without tip-up; cars {cars} on "
        f"floors {floors}"
    )
    return Page(
        "Entry speeds", lead, [Section("Highest median", [Finding([Bullets(fastest)])]), *sections]
    )


def _cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    return [
        (
            str(row["candidate"]),
            "–" if math.isnan(row["median_m_per_s"]) else f"{row['median_m_per_s']:.2f}",
            "–"
            if math.isnan(row["median_course_rad"])
            else f"{math.degrees(row['median_course_rad']):.0f}",
            f"{row['without_entry']:.0f} of {row['number']:.0f}",
            f"{row['unknown']:.0f}",
            f"{row['at_ceiling']:.0f}",
            _percent(row["gain_over_no_tail"]),
            "–"
            if math.isnan(row["low_over_no_tail"])
            else f"{_percent(row['low_over_no_tail'])} to {_percent(row['high_over_no_tail'])}",
            _percent(row["worst_over_no_tail"]),
            _percent(row["gain_over_low_mass"]),
            _percent(row["gain_over_better_tail"]),
            row["ended_by"],
        )
        for row in summary.to_dict("records")
    ]


@styled()
def entry_figure(table: pd.DataFrame) -> Figure:
    """Entry speeds of all cars by floor and manoeuvre, a line per candidate, with the median as a
    bar.
    """
    names, floors = (list(dict.fromkeys(table[key])) for key in ("manoeuvre", "floor"))
    who = list(dict.fromkeys(table["candidate"]))[::-1]
    height = (0.9 + 0.34 * len(who)) * len(floors)
    figure, axes = new_figure(9.0, height, len(floors), len(names), sharex=True, sharey=True)
    for axis, (floor, name) in zip(axes.flat, itertools.product(floors, names), strict=True):
        own = table[(table["manoeuvre"] == name) & (table["floor"] == floor)]
        speeds = [own.loc[own["candidate"] == one, SPEED].to_numpy(dtype=np.float64) for one in who]
        for index, values in enumerate(speeds):
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
