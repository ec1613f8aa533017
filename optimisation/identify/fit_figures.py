"""Figures of fits: estimates with their intervals, residuals, measured and modelled curves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from aerodima.optimisation.identify.fit_pipeline import FitResult, parameter_names, short_name
from aerodima.workbench.figures.figure_style import BLUE, GREY, SKY, VERMILION, new_figure, styled
from aerodima.workbench.figures.run_figures import RUN_STYLES

_MOST_CURVES = 12
"""Panels of the figure in which logs with one curve each are drawn together."""
_MOST_FIGURES = 8
"""Logs with several curves have a figure of their own; that many are drawn."""
_MOST_NAMED = 16
_EXACT = 1e-9
"""Residuals below this are rounding."""
_MODEL_STYLES = (RUN_STYLES[2], *RUN_STYLES[1:2], RUN_STYLES[0], *RUN_STYLES[3:])
"""Blue dots first, vermilion dashes over them: told apart without colour."""


def figures_of(results: Sequence[FitResult]) -> dict[str, Figure]:
    """All figures of a report by name: curves, and of more than one fit estimates and residuals."""
    figures = {}
    if len(results) > 1:
        figures["estimates"] = plot_estimates(results)
        figures["residuals"] = _residuals_figure(results)
    single = [result for result in results if len(result.curves) == 1]
    if single:
        figures["curves"] = _curves_figure([(r, name, curve) for r in single for name, curve in r.curves.items()])
    several = [result for result in results if len(result.curves) > 1]
    for number, result in enumerate(several[:_MOST_FIGURES], start=1):
        figures[f"curves_{number}_{short_name(result.name)}"] = plot_curves(result)
    return figures


def plot_curves(result: FitResult) -> Figure:
    """Measured and model of one fit: a panel per curve that the fit kept, such as the angle and each reaction."""
    return _curves_figure([(None, name, curve) for name, curve in result.curves.items()], short_name(result.name))


@styled()
def plot_estimates(results: Sequence[FitResult]) -> Figure:
    """Every free parameter over the fits, with its interval; what is not determined is left out."""
    free = {e.name for result in results for e in result.free if not e.name.startswith("start_")}
    names = [name for name in parameter_names(results) if name in free]
    units = {e.name: e.unit for result in results for e in result.free}
    figure, grid = new_figure(10.0, 1.9 * len(names) + 1.2, len(names), sharex=True)
    axes = grid[:, 0]
    for ax, name in zip(axes, names, strict=True):
        found = [(i, e) for i, result in enumerate(results) for e in result.free if e.name == name and e.identifiable]
        if found:
            x = [i for i, _ in found]
            values = np.array([e.value for _, e in found])
            low = np.maximum(values - [e.lower for _, e in found], 0.0)
            high = np.maximum([e.upper for _, e in found] - values, 0.0)
            ax.errorbar(x, values, yerr=[low, high], fmt="o", ms=3.5, capsize=2, color=BLUE, ecolor=SKY)
            ax.ticklabel_format(axis="y", useOffset=False)
        else:
            ax.text(0.5, 0.5, "not determined in any fit", transform=ax.transAxes, ha="center", color=VERMILION)
            ax.set_yticks([])
        ax.set_ylabel(name if units[name] == "1" else f"{name} [{units[name]}]", fontsize=8)
    _name_fits(axes[-1], results)
    figure.suptitle("estimates with their 95 % intervals", fontsize=10)
    return figure


def _name_fits(ax: Axes, results: Sequence[FitResult]) -> None:
    """The fits along the x axis: by name while there is room, else by their place in the table."""
    ax.set_xlim(-0.5, len(results) - 0.5)
    if len(results) > _MOST_NAMED:
        ax.set_xlabel("fit, in the order of the table (from 0)")
        return
    ax.set_xticks(range(len(results)), [short_name(result.name) for result in results], rotation=20, ha="right")
    ax.tick_params(axis="x", labelsize=8)


@styled()
def _residuals_figure(results: Sequence[FitResult]) -> Figure:
    """Root mean square per channel and fit; a channel that a fit meets exactly has no mark."""
    channels = list(dict.fromkeys(name for result in results for name in result.residual_rms))
    figure, grid = new_figure(10.0, 3.6)
    ax = grid[0, 0]
    for channel in channels:
        rms = [result.residual_rms.get(channel, math.nan) for result in results]
        y = [value if value > _EXACT else math.nan for value in rms]
        ax.plot(range(len(results)), y, "o" if len(results) < 100 else ".", ms=4, label=channel)
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    if high < 10.0 * low:  # less than a decade would have no numbers along the axis
        ax.set_ylim(low / 3.0, 3.0 * high)
    _name_fits(ax, results)
    ax.set_ylabel("rms residual, SI unit of the channel")
    if channels:
        ax.legend(ncols=len(channels), fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


@styled()
def _curves_figure(curves: Sequence[tuple[FitResult | None, str, Mapping[str, Any]]], title: str = "") -> Figure:
    """Measured and model, one panel per curve, named after the log if that is told.

    Below a panel with measured values stands what the last model leaves of them.
    """
    more, curves = len(curves) - _MOST_CURVES, curves[:_MOST_CURVES]
    columns = min(3, len(curves))
    rows = math.ceil(len(curves) / columns)
    figure = Figure(figsize=(5.0 * columns, 4.2 * rows))
    grid = figure.add_gridspec(rows, columns)
    for number, (result, name, curve) in enumerate(curves):
        place = grid[number // columns, number % columns]
        x, models = np.asarray(curve["x"]), _models(curve)
        x_label, y_label = curve.get("labels", ("x", name))
        if "measured" in curve and models:
            pair = place.subgridspec(2, 1, height_ratios=(3, 1))
            upper = figure.add_subplot(pair[0])
            lower = figure.add_subplot(pair[1], sharex=upper)
            upper.tick_params(labelbottom=False)
            _draw_residual(lower, x, curve, models[-1], y_label)
        else:
            upper = lower = figure.add_subplot(place)
        if "measured" in curve:
            upper.plot(x, curve["measured"], _mark(x), color=GREY, lw=2.4, label="measured")
        for label, (colour, line) in zip(models, cycle(_MODEL_STYLES)):
            upper.plot(x, curve[label], lw=1.3, color=colour, linestyle=line, label=label)
        upper.set_title(name if result is None else f"{short_name(result.name)}: {name}", fontsize=9)
        lower.set_xlabel(x_label)
        lower.xaxis.set_major_locator(MaxNLocator(5))
        upper.set_ylabel(y_label)
        upper.legend(fontsize=8)
    if title or more > 0:
        figure.suptitle(title or f"the first {_MOST_CURVES} of {_MOST_CURVES + more} logs")
    return figure


def _models(curve: Mapping[str, Any]) -> list[str]:
    return [label for label in curve if label not in ("x", "measured", "labels")]


def _mark(x: np.ndarray) -> str:
    """Few samples as points, many as a line."""
    return "." if len(x) <= 200 else "-"


def _draw_residual(ax: Axes, x: np.ndarray, curve: Mapping[str, Any], model: str, y_label: str) -> None:
    """Measured minus model, in the unit of the curve."""
    residual = np.asarray(curve["measured"]) - np.asarray(curve[model])
    ax.plot(x, residual, _mark(x), ms=3, lw=0.8, color=GREY)
    ax.axhline(0.0, color=GREY, lw=0.8)
    unit = y_label.rpartition(", ")[2] if ", " in y_label else ""
    ax.set_ylabel("residual" + (f", {unit}" if unit else ""), fontsize=8)
    ax.tick_params(axis="y", labelsize=7)
