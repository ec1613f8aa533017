"""Pictures of a coefficient set: curves with percentile bands, and what was measured."""

import math
import textwrap
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.workbench.aero.coefficient_files import CoefficientSet, PolarTable
from aerodima.workbench.aero.section_laws import NormalForceLaw, TwoSidedLaw
from aerodima.workbench.view.figure_style import (
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

_COLOURS = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
_LABELS = {"cd": "drag coefficient $C_D$", "cl": "lift coefficient $C_L$"}


@styled()
def plot_coefficients(coefficients: CoefficientSet) -> Figure:
    """Draws one set: $C_N$ over the speed, or $C_D$ and $C_L$ over the angle."""
    plot = _plot_polar if coefficients.law_kind == "polar" else _plot_speed
    figure = plot(coefficients)
    figure.suptitle(coefficients.name)
    figure.supxlabel(textwrap.fill(coefficients.source, 120), fontsize=7, color=GREY)
    return figure


def _plot_speed(coefficients: CoefficientSet) -> Figure:
    figure, grid = new_figure(7.5, 5.0)
    axes = grid[0, 0]
    low, high = coefficients.speed_range
    right = 1.1 * max(high, coefficients.quasi_steady_limit)
    speed = np.linspace(0.0, right, 400)
    law = coefficients.law()
    if isinstance(law, TwoSidedLaw):
        axes.plot([0.0, right], [law.along_normal] * 2, label="hollow side to the wind")
        axes.plot([0.0, right], [law.against_normal] * 2, label="round side to the wind")
    else:
        assert isinstance(law, NormalForceLaw)
        curve = law.coefficient
        values = [curve(float(place)) if callable(curve) else curve for place in speed]
        axes.plot(speed, values, color=BLUE, label="used by the law (edge value held outside)")
    nodes = coefficients.nodes
    if "cn" in nodes:
        label = "weighted average of the single fits"
        axes.plot(nodes.speed_m_per_s, nodes.cn, "o", color=BLUE, label=label)
    if "cn_p10" in nodes:
        axes.fill_between(
            nodes.speed_m_per_s,
            nodes.cn_p10,
            nodes.cn_p90,
            color=BLUE,
            alpha=0.2,
            label="percentiles 10 to 90",
        )
    axes.set(
        xlabel="relative speed [m/s]",
        ylabel="normal-force (drag) coefficient $C_N$",
        xlim=(0.0, right),
    )
    axes.set_ylim(0.0, 1.1 * axes.dataLim.ymax)
    axes.axvspan(0.0, low, color="0.9", zorder=0, label="not measured")
    axes.axvspan(high, right, color="0.9", zorder=0)
    limit = coefficients.quasi_steady_limit
    axes.axvline(limit, color=GREY, linestyle=":", linewidth=1.0, label="quasi-steady limit")
    axes.legend(loc="lower center", fontsize=8)
    return figure


def _plot_polar(coefficients: CoefficientSet) -> Figure:
    figure, grid = new_figure(11.0, 4.5, 1, 2)
    for axes, name in zip(grid[0], ("cd", "cl"), strict=True):
        if isinstance(coefficients, PolarTable):
            _plot_curves(axes, coefficients, name)
        else:
            axes.text(0.5, 0.5, f"{_LABELS[name]} = {getattr(coefficients, name)}", ha="center")
            axes.set_axis_off()
    return figure


def _plot_curves(axes: Axes, coefficients: PolarTable, name: str) -> None:
    table = coefficients.table(name)
    highest = max(coefficients.nodes.angle_rad.max(), coefficients.range.angle_rad[1])
    angles = np.linspace(0.0, highest, 200)
    groups = coefficients.nodes.groupby("speed_m_per_s")
    for (speed, nodes), colour in zip(groups, cycle(_COLOURS), strict=False):
        curve = [table(speed, angle) for angle in angles]
        axes.plot(np.degrees(angles), curve, color=colour, label=f"{speed:g} m/s")
        measured = nodes[nodes.status == "measured"]
        degrees = np.degrees(measured.angle_rad)
        axes.plot(degrees, measured[name], "o", color=colour)
        seeds = nodes[nodes.status == "seed"]
        axes.plot(
            np.degrees(seeds.angle_rad), seeds[name], "o", color=colour, fillstyle="none", alpha=0.6
        )
        if f"{name}_p10" in measured:
            axes.fill_between(
                degrees,
                measured[f"{name}_p10"],
                measured[f"{name}_p90"],
                color=colour,
                alpha=0.2,
            )
    edge = math.degrees(coefficients.range.angle_rad[1])
    axes.axvspan(edge, math.degrees(highest), color="0.93", zorder=0)
    axes.set(xlabel=r"angle of attack $|\gamma|$ [deg]", ylabel=_LABELS[name])
    axes.plot([], [], "ko", label="measured")
    axes.plot([], [], "ko", fillstyle="none", label="seed of a fit, not measured")
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top + 0.35 * (top - bottom))  # room for the legend above what is drawn
    axes.legend(fontsize=7, ncols=3, loc="upper center")
    axes.set_title("edge value held outside; band: percentiles 10 to 90", fontsize=8)
