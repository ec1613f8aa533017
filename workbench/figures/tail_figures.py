"""Figures that explain what the tail does: impulses by cause over the speed, moments over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.workbench.errors import LogError
from aerodima.workbench.figures.figure_style import (
    BLACK,
    CAUSE_STYLES,
    GREY,
    MODE_STYLES,
    VERMILION,
    new_figure,
    shade_turn,
    styled,
)
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import LowPass, low_pass
from aerodima.workbench.metrics.run_summary import RunSummary, impulse_parts
from aerodima.workbench.metrics.tail_impulses import TailImpulses, tail_impulses

_MOMENT_FILTER = LowPass(order=2, cutoff_hz=20.0)
"""For the eye only: the inertial moment is a derivative of logged momentum and jumps with every step of the motor."""


def plot_impulses(summaries: Sequence[RunSummary]) -> Figure:
    """Stacked bars: impulse of the tail against rolling outwards over the turn, by cause, held and swung, over speed.

    Runs without tail are left out.

    Raises:
        LogError: no run has a tail.
    """
    modes = [mode for mode in MODE_STYLES if any(s.tail_mode == mode and s.over_window is not None for s in summaries)]
    if not modes:
        raise LogError("impulses of the tail: none of the runs has a tail and ground truth")
    with styled():
        figure, grid = new_figure(11.0, 4.0, 1, len(modes), sharey=True)
        for axes, mode in zip(grid[0], modes, strict=True):
            _stack(axes, [s for s in summaries if s.tail_mode == mode])
            axes.set(xlabel="commanded speed [m/s]", title=MODE_STYLES[mode].words.capitalize())
        grid[0, 0].set_ylabel("impulse over the turn [N m s]\n+ against rolling outwards")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _stack(axes: Axes, summaries: list[RunSummary]) -> None:
    places = np.arange(len(summaries))
    above, below = np.zeros(len(summaries)), np.zeros(len(summaries))
    parts = [impulse_parts(s.over_window) for s in summaries if s.over_window is not None]
    for cause, (words, colour, hatch, _) in CAUSE_STYLES.items():
        values = np.array([part[cause] for part in parts])
        start = np.where(values >= 0.0, above, below)
        axes.bar(
            places, values, 0.62, bottom=start, color=colour, hatch=hatch, edgecolor=BLACK, linewidth=0.6, label=words
        )
        above += np.maximum(values, 0.0)
        below += np.minimum(values, 0.0)
    axes.plot(places, above + below, linestyle="none", marker="D", color="white", markeredgecolor=BLACK, label="sum")
    axes.axhline(0.0, color=BLACK, linewidth=0.8)
    axes.set_xticks(places, [f"{s.commanded_speed:.2f}" for s in summaries])
    axes.grid(False, axis="x")


def plot_moments(run_logs: Sequence[RunLog], titles: Sequence[str], after: float = 0.5) -> Figure:
    """Moments of the tail on the car about its heading, by cause, over time; one panel per run.

    Args:
        run_logs: simulated runs of a car with tail.
        titles: one per run.
        after: shown after the end of the turn, s.

    Raises:
        LogError: a car without tail, or a log without ground truth.
    """
    with styled():
        figure, grid = new_figure(11.0, 4.2, 1, len(run_logs), sharey=True)
        for axes, run_log, title in zip(grid[0], run_logs, titles, strict=True):
            impulses = tail_impulses(run_log)
            if impulses is None:
                raise LogError(f"{run_log.source or 'run log'}: a car without tail has no moments of the tail")
            _moments(axes, impulses, after)
            axes.set(xlabel="time [s]   (shaded: the turn)", title=title)
        grid[0, 0].set_ylabel("moment of the tail on the car [N m]\n+ against rolling outwards, below 20 Hz")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _moments(axes: Axes, impulses: TailImpulses, after: float) -> None:
    shade_turn(axes, impulses.window)
    shown = (impulses.time >= impulses.window[0] - 0.2) & (impulses.time <= impulses.window[1] + after)
    total = np.zeros(impulses.time.size)
    for cause, (words, colour, _, line) in CAUSE_STYLES.items():
        moment = low_pass(impulses.time, getattr(impulses, f"{cause}_moment"), _MOMENT_FILTER, f"moment ({cause})")
        total = total + moment
        axes.plot(impulses.time[shown], moment[shown], color=colour, linestyle=line, linewidth=2.0, label=words)
    axes.plot(impulses.time[shown], total[shown], color=BLACK, linewidth=1.1, label="sum")
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    if impulses.time[shown][0] <= impulses.peak_roll_time <= impulses.time[shown][-1]:
        axes.axvline(
            impulses.peak_roll_time, color=VERMILION, linestyle=(0, (1, 2)), linewidth=1.5, label="largest roll"
        )
