"""Figures of one run over time, and of several runs over one another, signal by signal."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from aerodima.workbench.car.turn_signals import turn_window
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import IMU_FILTER, LowPass, low_pass
from aerodima.workbench.metrics.run_summary import of_plants, plant_air, plant_speed, plant_tilt
from aerodima.workbench.view.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    new_figure,
    shade_turn,
    styled,
)

_RUN_COLOURS = (BLACK, VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY, GREY)
_RUN_LINES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.5)),
    (0, (1, 1)),
    (0, (5, 1.5, 1, 1.5)),
    (0, (8, 2, 1, 2, 1, 2)),
)
RUN_STYLES: list[tuple[str, Any]] = [
    (_RUN_COLOURS[run % 8], _RUN_LINES[run % 5]) for run in range(20)
]
"""Colour and line of the first, second, ... run. The first eight have a colour of their own, the
first five a line of their own, and all twenty differ in the pair."""
_Panel = tuple[str, Callable[[RunLog], FloatArray | None]]
"""Label of a panel, and function that reads its signal; None where a run has none."""
_PLANT_PANELS: tuple[_Panel, ...] = (
    ("speed of the centre of mass [m/s]", plant_speed),
    ("height of the centre of mass [m]", lambda run_log: run_log.signal("com_z_truth_m")),
    ("tilt of the base [deg]", plant_tilt),
    ("air on the tails [N]", plant_air),
)
"""Panels of plants that are not cars."""


def _values(run_log: RunLog, column: str, design: LowPass | None = None) -> FloatArray | None:
    """Reads a column as it is drawn, (n,), angles in degrees; None where this run has none."""
    if column not in run_log.table or (column.startswith("tail_") and not run_log.has_tail):
        return None
    values = run_log.signal(column)
    if design is not None:
        values = low_pass(run_log.time, values, design, column)
    if column.endswith("_rad"):
        return np.degrees(np.unwrap(values))
    return values


def _roll(run_log: RunLog) -> FloatArray | None:
    """Reads the true roll, or for a real car its estimate."""
    if "roll_truth_rad" in run_log.table:
        return _values(run_log, "roll_truth_rad")
    return _values(run_log, "roll_estimate_rad")


_PANELS: tuple[_Panel, ...] = (
    ("yaw rate [rad/s]", partial(_values, column="imu_gyro_z_rad_per_s", design=IMU_FILTER)),
    (
        "lateral acceleration [m/s²]",
        partial(_values, column="imu_acceleration_y_m_per_s2", design=IMU_FILTER),
    ),
    ("speed [m/s]", partial(_values, column="speed_m_per_s")),
    ("roll of the car [deg]", _roll),
    ("tail roll angle [deg]", partial(_values, column="tail_roll_angle_rad")),
    ("tail roll torque [N m]", partial(_values, column="tail_roll_torque_n_m")),
)


def plot_overlay(run_logs: Sequence[RunLog], names: Sequence[str]) -> Figure:
    """Draws six signals of cars over time, or four of other plants, a line per run.

    IMU signals are shown after the car's zero-phase filter.

    Args:
        run_logs: logs of up to `len(RUN_STYLES)` runs.
        names: names shown in the legend, one per run.

    Raises:
        LogError: a log has no turn, or its sensors are missing; or cars and other plants are mixed.
    """
    plants = of_plants(run_logs)
    panels = _PLANT_PANELS
    height = 6.0
    time_label = "time [s]"
    if not plants:
        panels = _PANELS
        height = 8.0
        time_label += "   (shaded: the turn of the first run)"
    with styled():
        figure, grid = new_figure(11.0, height, len(panels) // 2, 2, sharex=True)
        for axes, (label, signal) in zip(grid.flat, panels, strict=True):
            axes.set_ylabel(label)
            if not plants:
                shade_turn(axes, turn_window(run_logs[0]))
            for run_log, (colour, line) in zip(run_logs, RUN_STYLES, strict=False):
                values = signal(run_log)
                if values is not None:
                    axes.plot(run_log.time, values, color=colour, linestyle=line)
        for axes in grid[-1]:
            axes.set_xlabel(time_label)
        handles = [
            Line2D([], [], color=colour, linestyle=line)
            for colour, line in RUN_STYLES[: len(names)]
        ]
        figure.legend(handles, names, loc="outside upper center", ncols=min(3, len(names)))
    return figure
