"""Figures of the tail: impulses by cause over the speed, moments over time, and where it touches nothing."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from aerodima.workbench.figures.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILION,
    new_figure,
    styled,
)
from aerodima.workbench.logs.signals import LowPass
from aerodima.workbench.plants.clearance import PARTS, RangeOfMotion

_MOMENT_FILTER = LowPass(order=2, cutoff_hz=20.0)
"""For the eye only: the inertial moment is a derivative of logged momentum and jumps with every step of the motor."""


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
