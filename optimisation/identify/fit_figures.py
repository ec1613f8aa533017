"""Figures of fits: estimates with their intervals, measured and modelled curves."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from aerodima.optimisation.identify.fit_result import FitResult, short_name
from aerodima.workbench.view.figure_style import BLUE, GREY, SKY, VERMILION, new_figure, styled

_MAX_CURVES = 12
"""Largest number of panels in a figure."""
_MAX_NAMED = 16
"""Largest number of fits whose names stand below the axis."""


def figures_of(results: Sequence[FitResult]) -> dict[str, Figure]:
    """Draw all figures of a report by name.

    They are the estimates of more than one fit, and the curves of the first ones.
    """
    figures = {}
    if len(results) > 1:
        figures["estimates"] = plot_estimates(results)
    curves = [result for result in results if result.curves]
    if curves:
        figures["curves"] = plot_curves(*curves)
    return figures


@styled()
def plot_estimates(results: Sequence[FitResult]) -> Figure:
    """Draw the free parameters over the fits, with intervals, as far as they are determined."""
    free: dict[str, str] = {}
    for result in results:
        free |= {e.name: e.unit for e in result.free if not e.name.startswith("start_")}
    figure, grid = new_figure(10.0, 1.9 * len(free) + 1.2, len(free), sharex=True)
    axes = grid[:, 0]
    for ax, name in zip(axes, free, strict=True):
        points = []
        for index, result in enumerate(results):
            for e in result.free:
                if e.name == name and math.isfinite(e.upper - e.lower):
                    points.append((index, e.value, e.value - e.lower, e.upper - e.value))
        if points:
            indices, values, low, high = np.array(points).T
            widths = np.maximum([low, high], 0.0)
            ax.errorbar(
                indices, values, yerr=widths, fmt="o", ms=3.5, capsize=2, color=BLUE, ecolor=SKY
            )
            ax.ticklabel_format(axis="y", useOffset=False)
        else:
            text = ax.text(0.5, 0.5, "not determined in any fit", transform=ax.transAxes)
            text.set(ha="center", color=VERMILION)
            ax.set_yticks([])
        ax.set_ylabel(name if free[name] == "1" else f"{name} [{free[name]}]", fontsize=8)
    _name_fits(axes[-1], results)
    figure.suptitle("estimates with their 95 % intervals", fontsize=10)
    return figure


def _name_fits(ax: Axes, results: Sequence[FitResult]) -> None:
    """Label the fits along the x axis: by name while there is room, else by their index."""
    ax.set_xlim(-0.5, len(results) - 0.5)
    if len(results) > _MAX_NAMED:
        ax.set_xlabel("fit, in the order of the table (from 0)")
        return
    ax.set_xticks(
        range(len(results)),
        [short_name(result.name) for result in results],
        rotation=20,
        ha="right",
    )
    ax.tick_params(axis="x", labelsize=8)


@styled()
def plot_curves(*results: FitResult) -> Figure:
    """Draw measurement and model, such as a swing's angle, and below the residual, for each fit."""
    curves = []
    for result in results:
        for name, curve in result.curves.items():
            curves.append((f"{short_name(result.name)}: {name}", curve))
    curves = curves[:_MAX_CURVES]
    columns = min(3, len(curves))
    rows = math.ceil(len(curves) / columns)
    figure = Figure(figsize=(5.0 * columns, 4.2 * rows))
    grid = figure.add_gridspec(rows, columns)
    for number, (title, curve) in enumerate(curves):
        pair = grid[number // columns, number % columns].subgridspec(2, 1, height_ratios=(3, 1))
        upper = figure.add_subplot(pair[0])
        lower = figure.add_subplot(pair[1], sharex=upper)
        x, measured, model = (np.asarray(curve[key]) for key in ("x", "measured", "model"))
        x_label, y_label = curve["labels"]
        mark = "." if len(x) <= 200 else "-"
        upper.plot(x, measured, mark, color=GREY, lw=2.4, label="measured")
        upper.plot(x, model, lw=1.3, color=BLUE, linestyle="--", label="model")
        upper.tick_params(labelbottom=False)
        upper.set_title(title, fontsize=9)
        upper.set_ylabel(y_label)
        upper.legend(fontsize=8)
        lower.plot(x, measured - model, mark, ms=3, lw=0.8, color=GREY)
        lower.axhline(0.0, color=GREY, lw=0.8)
        lower.set_ylabel(f"residual, {y_label.rpartition(', ')[2]}", fontsize=8)
        lower.tick_params(axis="y", labelsize=7)
        lower.set_xlabel(x_label)
        lower.xaxis.set_major_locator(MaxNLocator(5))
    return figure
