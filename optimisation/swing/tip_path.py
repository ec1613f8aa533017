"""Where the tip of the tail goes during a swing, seen from behind and from above, in the axes of the car."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_curve import swing_at
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.figures.figure_style import BLACK, GREY, TURN_SHADE, VERMILION, new_figure, styled

TICKS = 0.1
"""s between two marks on the path."""


def tip_position(roll: ArrayLike, pitch: ArrayLike, scenario: Scenario) -> FloatArray:
    """Place of the tip (..., 3) in the axes of the car: forwards, left, up from the ground below the rear axle, m.

    Args:
        roll, pitch: of the tail, rad; roll is positive to the right, pitch forwards.
        scenario: geometry.
    """
    q, p, tail = np.asarray(roll), np.asarray(pitch), scenario.tail
    parts = np.broadcast_arrays(
        tail.mount_x + tail.length * np.sin(p) * np.cos(q),
        -tail.length * np.sin(q),
        tail.mount_height + tail.length * np.cos(p) * np.cos(q),
    )
    return np.stack(parts, axis=-1)


def plot_tip_path(swing: SwingFile, scenario: Scenario) -> Figure:
    """The planned path of the tip with a mark every 0.1 s; the tail at rest before and after as grey lines."""
    direction: Any = scenario.manoeuvre.direction
    end = swing.knots.time_s[-1]
    path, marks = (_tip(swing, times, scenario, direction) for times in _times(end))
    car, tail = scenario.car, scenario.tail
    mount = np.array([tail.mount_x, 0.0, tail.mount_height])
    with styled():
        image, grid = new_figure(11.0, 4.6, 1, 2)
        for axes, (across, up) in zip(grid[0], ((1, 2), (1, 0)), strict=True):
            sign = np.array([1.0, -1.0, 1.0])  # to the right is to the right
            for point in (path[0], path[-1]):
                line = np.array([mount, point]) * sign
                axes.plot(line[:, across], line[:, up], color=GREY, linewidth=1.0)
            axes.plot((path * sign)[:, across], (path * sign)[:, up], color=VERMILION)
            axes.plot((marks * sign)[:, across], (marks * sign)[:, up], "o", color=BLACK, markersize=4)
            for number, point in enumerate(marks * sign):
                if number == 0 or np.max(np.abs(marks[number] - marks[number - 1])) > 0.03:
                    words = f" {TICKS * number:.1f} s"
                    axes.annotate(words, (point[across], point[up]), fontsize=8, va="bottom")
            axes.set_aspect("equal")
            axes.margins(0.12)
            axes.set_xlabel("to the right [m]")
        behind, above = grid[0]
        half, length = car.outer_half_track, car.wheelbase
        behind.fill([-half, half, half, -half], [0, 0, mount[2], mount[2]], color=TURN_SHADE, zorder=0)
        above.fill([-half, half, half, -half], [0, 0, length, length], color=TURN_SHADE, zorder=0)
        behind.axhline(0.0, color=BLACK, linewidth=1.0)
        behind.set(ylabel="above the ground [m]", title="From behind")
        above.set(ylabel="forwards from the rear axle [m]", title="From above")
    return image


def _times(end: float) -> tuple[FloatArray, FloatArray]:
    return np.linspace(0.0, end, 301), np.arange(0.0, end + 1e-9, TICKS)


def _tip(swing: SwingFile, times: FloatArray, scenario: Scenario, direction: Any) -> FloatArray:
    point = swing_at(swing, times, direction)
    return tip_position(point.roll_position, point.pitch_position, scenario)
