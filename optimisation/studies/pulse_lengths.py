"""How long a turn a law is good for: gain in course over the length of the steering pulse, and where it ends."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.figures.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    new_figure,
    styled,
)

_STYLES = (
    (BLUE, "o"),
    (ORANGE, "s"),
    (GREEN, "D"),
    (VERMILION, "^"),
    (PURPLE, "v"),
    (SKY, "P"),
    (BLACK, "X"),
    (GREY, "*"),
)
WORDS = (
    "Median gain in course over the car without tail, and the worst car's median, by length of the pulse. The gain "
    "ends where the median falls to nothing for good, between two pulses on the line that joins them."
)


def gains_by_pulse(gained: pd.DataFrame) -> pd.DataFrame:
    """A row per candidate and pulse.

    Args:
        gained: cases with their `gain`.
    """
    rows = []
    for (name, pulse), own in gained.groupby(["candidate", "pulse_s"], sort=False):
        rows.append(
            {
                "candidate": name,
                "pulse_s": pulse,
                "number": len(own),
                "without_a_turn_that_counts": int(own["course_change_rad"].isna().sum()),
                "median_course_change_rad": float(own["course_change_rad"].median()),
                "median_gain": float(own["gain"].median()),
                "worst_car_gain": float(own.groupby("car")["gain"].median().min()),
            }
        )
    return make_frame(rows).sort_values(["candidate", "pulse_s"], kind="stable", ignore_index=True)


def end_of_gain(pulses: Sequence[float], gains: Sequence[float]) -> float:
    """Length from which on there is no gain, s: infinite where the longest pulse has one, 0 where none has.

    Args:
        pulses: rising (n), s.
        gains: of each (n).
    """
    gaining = [place for place, gain in enumerate(gains) if gain > 0.0]
    if not gaining:
        return 0.0
    last = gaining[-1]
    if last == len(pulses) - 1:
        return math.inf
    share = gains[last] / (gains[last] - gains[last + 1])
    return float(pulses[last] + share * (pulses[last + 1] - pulses[last]))


def pulse_rows(table: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Header and rows of `gains_by_pulse`: a column per pulse with median and worst car, then where the gain ends."""
    pulses = sorted(table["pulse_s"].unique())
    rows = []
    for name in dict.fromkeys(table["candidate"]):
        own = table[table["candidate"] == name].set_index("pulse_s")
        cells = [f"{own.at[p, 'median_gain']:+.1%} ({own.at[p, 'worst_car_gain']:+.1%})" for p in pulses]
        rows.append([str(name), *cells, _end_words(pulses, own["median_gain"].loc[pulses].to_numpy(float))])
    return ["candidate", *(f"{pulse:g} s" for pulse in pulses), "gain ends"], rows


def plot_pulses(table: pd.DataFrame) -> Figure:
    """Median gain over the length of the pulse, a line per candidate, a band down to the worst car."""
    with styled():
        image, grid = new_figure(9.0, 5.0)
        axes = grid[0, 0]
        for (colour, marker), name in zip(_STYLES * len(table), dict.fromkeys(table["candidate"]), strict=False):
            own = table[table["candidate"] == name]
            median, worst = (100.0 * own[column].to_numpy(float) for column in ("median_gain", "worst_car_gain"))
            axes.plot(own["pulse_s"], median, color=colour, marker=marker, label=str(name))
            axes.fill_between(own["pulse_s"], worst, median, color=colour, alpha=0.12, linewidth=0.0)
        axes.axhline(0.0, color=GREY, linewidth=1.0)
        axes.set_xlabel("length of the pulse [s]")
        axes.set_ylabel("course over that without tail [%]")
        axes.legend()
    return image


def _end_words(pulses: Sequence[float], gains: FloatArray) -> str:
    end = end_of_gain(pulses, np.nan_to_num(gains, nan=-1.0).tolist())
    if end == 0.0:
        return "has none"
    return f"beyond {pulses[-1]:g} s" if math.isinf(end) else f"{end:.2f} s"
