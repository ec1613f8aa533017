"""Figures of a calibration: posterior of the parameters, sensitivities, validation, directions."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from aerodima.optimisation.calibration.identifiability import FLIP_SPEED, Direction
from aerodima.optimisation.calibration.validation import Validated
from aerodima.workbench.figures.figure_style import BLUE, GREY, ORANGE, VERMILION, new_figure, styled
from aerodima.workbench.report.number_words import metric_name

COLUMNS = 5
BINS = 12
"""Panels per row; bars per histogram."""


def plot_posterior(parameters: pd.DataFrame, members: pd.DataFrame) -> Figure:
    """One small histogram per parameter over its prior range: weight of the members, best value as a line.

    Args:
        parameters: rows with parameter, prior_low, prior_high, best.
        members: column `weight`, and one per parameter.
    """
    rows = int(np.ceil(len(parameters) / COLUMNS))
    with styled():
        figure, axes = new_figure(10.5, 1.75 * rows, rows, COLUMNS)
        for place, axis in enumerate(axes.flat):
            if place >= len(parameters):
                axis.set_visible(False)
                continue
            row = parameters.iloc[place]
            edges = np.linspace(row.prior_low, row.prior_high, BINS + 1)
            axis.hist(members[row.parameter], edges, weights=members["weight"], color=BLUE, alpha=0.75)
            axis.axhline(1.0 / BINS, color=GREY, linestyle=":", linewidth=1.2)
            axis.axvline(row.best, color=VERMILION, linewidth=1.8)
            axis.set_xlim(row.prior_low, row.prior_high)
            axis.set_title(row.parameter, fontsize=8.5)
            axis.set_yticks([])
            axis.set_xticks([row.prior_low, row.prior_high])
            axis.grid(False)
    return figure


def plot_group(members: pd.DataFrame, half_track: NDArray[np.float64]) -> Figure:
    """The two combinations that decide: friction against height of the centre of mass over half the track (m)."""
    with styled():
        figure, axes = new_figure(5.2, 3.6)
        axis = axes[0, 0]
        ratio = members["car.com_height"] / half_track
        size = 25 + 900 * members["weight"]
        axis.scatter(members["car.tyre_friction"], ratio, s=size, color=BLUE, alpha=0.55, linewidth=0)
        friction = np.linspace(members["car.tyre_friction"].min(), members["car.tyre_friction"].max(), 50)
        group = float(np.average(members["car.tyre_friction"] * ratio, weights=members["weight"]))
        axis.plot(friction, group / friction, color=VERMILION, label=f"friction × height / half track = {group:.3f}")
        axis.set_xlabel("tyre friction")
        axis.set_ylabel("height of centre of mass / half track")
        axis.legend()
    return figure


def plot_sensitivities(table: pd.DataFrame) -> Figure:
    """Heat map: change of each target over its own largest change, numbers in the unit of the target."""
    names = [name for name in table.columns if name != "parameter"]
    values = table[names].to_numpy(float)
    scaled = values / np.maximum(np.abs(values).max(axis=0), 1e-12)
    with styled():
        figure, axes = new_figure(1.6 + 1.35 * len(names), 0.34 * len(table) + 1.4)
        axis = axes[0, 0]
        axis.imshow(scaled, cmap="RdBu_r", vmin=-1.2, vmax=1.2, aspect="auto")
        for (row, column), value in np.ndenumerate(values):
            axis.text(column, row, f"{value:+.3f}", ha="center", va="center", fontsize=7.5)
        axis.set_xticks(range(len(names)), [_wrapped(_target_name(name)) for name in names], fontsize=8)
        axis.set_yticks(range(len(table)), table["parameter"], fontsize=8)
        axis.xaxis.tick_top()
        axis.grid(False)
    return figure


def plot_validation(validated: Sequence[Validated]) -> Figure:
    """Band of the ensemble over the published figure, per place and metric; orange where it is no evidence."""
    sources = list(dict.fromkeys(v.source for v in validated))
    with styled():
        figure, axes = new_figure(12.0, 3.4, 1, len(sources))
        for axis, source in zip(axes.flat, sources, strict=True):
            rows = [v for v in validated if v.source == source]
            for place, v in enumerate(rows):
                colour = BLUE if v.is_test else ORANGE
                low, median, high = (value / v.published for value in (v.low, v.median, v.high))
                axis.plot([low, high], [place, place], color=colour, linewidth=5, alpha=0.5, solid_capstyle="butt")
                axis.plot(median, place, "|", color=colour, markersize=12, markeredgewidth=2)
            axis.axvline(1.0, color=VERMILION)
            axis.set_title(source)
            axis.set_xlabel("ensemble / published")
            axis.set_yticks(range(len(rows)), [metric_name(v.metric) for v in rows], fontsize=8)
            axis.invert_yaxis()
    return figure


def plot_directions(found: Sequence[Direction]) -> Figure:
    """Variance after over before the calibration for every combination, best determined first."""
    with styled():
        figure, axes = new_figure(6.2, 3.0)
        axis = axes[0, 0]
        axis.bar(range(1, len(found) + 1), [d.ratio for d in found], color=BLUE)
        axis.axhline(1.0, color=VERMILION, label="nothing learnt")
        axis.set_yscale("log")
        axis.set_xlabel("combination of parameters")
        axis.set_ylabel("variance after / before")
        axis.legend()
    return figure


def _target_name(name: str) -> str:
    source, _, metric = name.rpartition(" ")
    return "flip speed [m/s]" if name == FLIP_SPEED else f"{source}: {metric_name(metric)}"


def _wrapped(text: str) -> str:
    words = text.split()
    half = (len(words) + 1) // 2
    return " ".join(words[:half]) + "\n" + " ".join(words[half:])
