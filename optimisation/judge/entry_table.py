"""Summary of the entry speeds of many cars: medians, gains over others, their intervals."""

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from aerodima.optimisation.judge.candidate import HELD, LOW_BALLAST, NO_TAIL, THESIS
from aerodima.optimisation.judge.entry_rule import ERROR
from aerodima.optimisation.judge.entry_speed import NO_REFERENCE, NOT_CONFIRMED
from aerodima.optimisation.studies.runs import make_frame
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.core.array_types import FloatArray

SPEED = "entry_speed_m_per_s"
CASE = ["manoeuvre", "car", "floor"]
"""Columns that name a case; every candidate has one row in each."""
REFERENCES: Mapping[str, tuple[str, ...]] = {
    "no_tail": (NO_TAIL.name,),
    "low_mass": (LOW_BALLAST.name,),
    "better_tail": (HELD.name, THESIS.name),
}
"""Candidates that gains are over, each time the fastest of these candidates in the same case."""
UNKNOWN = (ERROR, NO_REFERENCE, NOT_CONFIRMED)
"""Beginnings of `ended_by` where an entry speed is not known."""
RESAMPLES = 4000
"""Draws of cars in a bootstrap."""


def known_speeds(table: pd.DataFrame) -> pd.Series:
    """Returns entry speeds (rows of the table), m/s; NaN where there is none or it is not known."""
    return table[SPEED].mask(_is_unknown(table))


def _is_unknown(table: pd.DataFrame) -> pd.Series:
    return table["ended_by"].astype(str).str.startswith(UNKNOWN)


def entry_gains(table: pd.DataFrame, over: tuple[str, ...]) -> pd.Series:
    """Computes the gain in entry speed of each row over the fastest of other candidates in the same
    case; index as the table's.

    A candidate that completes the manoeuvre at no speed has the gain -1. NaN where the entry speed
    of either is not known: a run has no outcome, the fine step confirmed no speed, or there was no
    reference.

    Args:
        table: of `find_entry_speeds`.
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
        table: of `find_entry_speeds`.
        seed: of the bootstrap.
    """
    gains = {label: entry_gains(table, over) for label, over in REFERENCES.items()}
    rows = []
    for (manoeuvre, candidate), own in table.groupby(["manoeuvre", "candidate"], sort=False):
        ended_by = own["ended_by"].fillna("").astype(str)
        row: Row = {
            "manoeuvre": manoeuvre,
            "candidate": candidate,
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
            row[f"gain_over_{label}"] = float(medians.median())
            row[f"worst_over_{label}"] = float(medians.min())
            row[f"low_over_{label}"] = low
            row[f"high_over_{label}"] = high
            row[f"cars_over_{label}"] = int(cars.size)
        rows.append(row)
    return make_frame(rows)


def has_gain(summary: pd.DataFrame) -> bool:
    """Returns whether a tail enters faster than the car without one; True when none was judged."""
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
