"""Figures of the tail: impulses by cause over the speed, moments over time, and where it touches nothing."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from aerodima.workbench.errors import LogError
from aerodima.workbench.figures.figure_style import (
    BLACK,
    BLUE,
    CAUSE_STYLES,
    GREEN,
    GREY,
    MODE_STYLES,
    ORANGE,
    PURPLE,
    VERMILION,
    modes_of,
    new_figure,
    shade_turn,
    styled,
)
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import LowPass, low_pass
from aerodima.workbench.metrics.run_summary import RunSummary
from aerodima.workbench.metrics.tail_impulses import TailImpulses, tail_impulses
from aerodima.workbench.plants.clearance import PARTS, RangeOfMotion

_MOMENT_FILTER = LowPass(order=2, cutoff_hz=20.0)
"""For the eye only: the inertial moment is a derivative of logged momentum and jumps with every step of the motor."""


def plot_impulses(summaries: Sequence[RunSummary]) -> Figure:
    """Stacked bars: impulse of the tail against rolling outwards over the turn, by cause, held and swung, over speed.

    Runs without tail are left out.

    Raises:
        LogError: no run has a tail.
    """
    modes = modes_of(s for s in summaries if s.over_window is not None)
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
    parts = [asdict(s.over_window) for s in summaries if s.over_window is not None]
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
                raise LogError(f"{run_log.name}: a car without tail has no moments of the tail")
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


_PART_COLOURS = dict(zip(PARTS, (VERMILION, ORANGE, PURPLE, BLUE), strict=True))
_FINE = 241


def plot_range_of_motion(motion: RangeOfMotion, margin: float = 0.01) -> Figure:
    """Two maps over tail roll (right positive) and pitch (forwards positive): clearance, and the part next to the tail.

    Args:
        motion: the map.
        margin: m; its contour is drawn beside that of touching.
    """
    pitch, roll = (np.linspace(nodes[0], nodes[-1], _FINE) for nodes in (motion.pitch, motion.roll))
    p, r = np.meshgrid(pitch, roll, indexing="ij")
    degrees, least = (np.degrees(r), np.degrees(p)), motion.clearance(p, r)
    each = np.array([motion.clearance(p, r, (part,)) for part in PARTS])
    with styled():
        figure, grid = new_figure(11.0, 5.0, 1, 2, sharey=True)
        left, right = grid[0]
        filled = left.contourf(*degrees, 1000.0 * least, levels=np.arange(-40, 61, 5), cmap="PuOr", extend="both")
        figure.colorbar(filled, ax=left, label="clearance to car and ground [mm]")
        for axes in (left, right):
            for level, line in ((0.0, "-"), (margin, (0, (3, 2)))):
                axes.contour(*degrees, least, levels=[level], colors=BLACK, linestyles=[line])
            axes.set_xlabel("tail roll [deg], to the right positive")
            axes.grid(False)
        left.set_ylabel("tail pitch [deg], forwards positive")
        touched = np.where(least < margin, np.argmin(each, axis=0), -1)
        for number, part in enumerate(PARTS):
            mask = np.where(touched == number, 1.0, np.nan)
            right.contourf(*degrees, mask, levels=[0.5, 1.5], colors=[_PART_COLOURS[part]])
        handles: list[Artist] = [
            Patch(color=_PART_COLOURS[part], label=part) for n, part in enumerate(PARTS) if np.any(touched == n)
        ]
        handles.append(Patch(facecolor="white", edgecolor=BLACK, label="free"))
        handles.append(Line2D([], [], color=BLACK, label="touches"))
        handles.append(Line2D([], [], color=BLACK, linestyle=(0, (3, 2)), label=f"{1000 * margin:.0f} mm left"))
        right.set_title(f"what is nearer than {1000 * margin:.0f} mm")
        left.set_title("clearance of rod and sail")
        right.legend(handles=handles, loc="lower right", frameon=True, framealpha=0.9)
        right.plot([-90, 90], [0, 0], color=GREEN, linewidth=2.5)
        right.annotate("swing in roll alone", (0.0, 3.0), color=GREEN, ha="center")
    return figure
