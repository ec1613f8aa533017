"""Figures over many runs: outcome map, published metrics, held and swung tail beside no tail, triggers."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from aerodima.workbench.figures.figure_style import (
    BLACK,
    FLIPPED_MARKER,
    GREEN,
    GREY,
    MODE_STYLES,
    VERMILION,
    modes_of,
    new_figure,
    styled,
)
from aerodima.workbench.metrics.published_values import Platform, PublishedValues, published_values
from aerodima.workbench.metrics.run_summary import RunSummary

_METRIC_LABELS = {
    "max_yaw_rate_rad_per_s": "largest yaw rate [rad/s]",
    "average_yaw_rate_rad_per_s": "mean yaw rate [rad/s]",
    "max_linear_acceleration_m_per_s2": "largest lateral acc. [m/s²]",
    "average_linear_acceleration_m_per_s2": "mean lateral acc. [m/s²]",
    "max_kohut_deg_m_per_s2": "largest Kohut [deg m/s²]",
    "average_kohut_deg_m_per_s2": "mean Kohut [deg m/s²]",
    "roll_integral_rad": "roll integral [rad]",
}


def plot_outcomes(summaries: Sequence[RunSummary]) -> Figure:
    """Speed x tail mode: a full disc for a clean run, a ring where something touched the ground, a cross for a flip."""
    modes = modes_of(summaries)
    with styled():
        figure, grid = new_figure(11.0, 0.75 * len(modes) + 1.5)
        axes = grid[0, 0]
        for summary in summaries:
            marker, face, colour = _outcome_mark(summary)
            place = (summary.commanded_speed, modes.index(summary.tail_mode))
            axes.plot(*place, marker=marker, markersize=17, markerfacecolor=face, markeredgecolor=colour, mew=2.2)
        speeds = sorted({s.commanded_speed for s in summaries})
        axes.set_xticks(speeds, [f"{v:.2f}\n{3.6 * v:.0f} km/h" for v in speeds])
        axes.set_yticks(range(len(modes)), [MODE_STYLES[mode].words for mode in modes])
        axes.set_ylim(len(modes) - 0.4, -0.6)
        axes.set_xlim(speeds[0] - 0.12, speeds[-1] + 0.12)
        axes.grid(False)
        axes.set_xlabel("commanded speed [m/s]")
        figure.legend(handles=_outcome_legend(), loc="outside upper center", ncols=3)
    return figure


def _outcome_mark(summary: RunSummary) -> tuple[str, str, str]:
    """Marker, face colour, edge colour."""
    if not summary.survived:
        return FLIPPED_MARKER, VERMILION, BLACK
    return ("o", GREEN, BLACK) if summary.clean else ("o", "white", GREEN)


def _outcome_legend() -> list[Line2D]:
    marks = (
        ("survived, clean", "o", GREEN, BLACK),
        ("survived, cage, board or tail touched the ground", "o", "white", GREEN),
        ("flipped", FLIPPED_MARKER, VERMILION, BLACK),
    )
    return [
        Line2D([], [], linestyle="none", marker=m, markersize=11, markerfacecolor=f, markeredgecolor=e, label=words)
        for words, m, f, e in marks
    ]


def plot_metrics(summaries: Sequence[RunSummary], platform: Platform = "simulated") -> Figure:
    """The metrics of the thesis over the speed at the start of the turn, with a platform's published rows as stars.

    Args:
        summaries: runs; flipped ones are crosses.
        platform: whose rows, and whose signals (`published_values.SIGNALS`) the metrics of the runs are from.
    """
    rows = [row for row in published_values() if row.platform == platform]
    modes = modes_of(summaries)
    with styled():
        figure, grid = new_figure(11.0, 5.6, 2, 4)
        for axes, (metric, label) in zip(grid.flat, _METRIC_LABELS.items(), strict=False):
            for run in sorted(summaries, key=lambda s: modes.index(s.tail_mode)):
                value = getattr(run.metrics.like(platform), metric)
                _point(axes, run, run.metrics.raw.speed_m_per_s, value, markersize=6.0)
            for row in rows:
                _star(axes, row, metric)
            axes.set(xlabel="speed [m/s]", ylabel=label)
            if metric == "roll_integral_rad":
                survived = [s.metrics.like(platform).roll_integral_rad for s in summaries if s.survived]
                published = [row.metrics.roll_integral_rad for row in rows]
                axes.set_ylim(0.0, 1.15 * max(survived + published))
            else:
                axes.set_ylim(bottom=0.0)
        legend = grid[1, 3]
        legend.set_axis_off()
        legend.legend(
            handles=[*_mode_legend(modes), *_published_legend(platform)],
            loc="center left",
            title=f"signals: {platform}",
        )
    return figure


def _point(axes: Axes, run: RunSummary, x: float, y: float, **options: Any) -> None:
    """A run in the colour and shape of its tail mode: full when it was clean, a cross when it flipped."""
    style = MODE_STYLES[run.tail_mode]
    marker, face = style.marker if run.survived else FLIPPED_MARKER, style.colour if run.clean else "white"
    axes.plot(x, y, linestyle="none", marker=marker, color=style.colour, markerfacecolor=face, **options)


def _star(axes: Axes, row: PublishedValues, metric: str) -> None:
    colour = MODE_STYLES["none" if row.configuration == "tailless" else "swing"].colour
    face = colour if row.platform == "simulated" else "white"
    value = getattr(row.metrics, metric)
    axes.plot(
        row.metrics.speed_m_per_s, value, "*", markersize=13, markeredgecolor=colour, markerfacecolor=face, zorder=5
    )


def _mode_legend(modes: Sequence[str]) -> list[Line2D]:
    handles = []
    for mode in modes:
        style = MODE_STYLES[mode]
        handles.append(Line2D([], [], linestyle="none", marker=style.marker, color=style.colour, label=style.words))
    crossed = Line2D([], [], linestyle="none", marker=FLIPPED_MARKER, mfc="white", mec=GREY, label="flipped")
    return [*handles, crossed]


def _published_legend(platform: Platform) -> list[Line2D]:
    handles = []
    for configuration, mode in (("tailless", "none"), ("tailed", "swing")):
        colour = MODE_STYLES[mode].colour
        handles.append(
            Line2D(
                [], [], linestyle="none", marker="*", markersize=12, mec=colour,
                mfc=colour if platform == "simulated" else "white", label=f"published, {configuration}, {platform}",
            )
        )  # fmt: skip
    return handles
