"""Several runs over one another: what differs between them, signal by signal."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.workbench.figures.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    PURPLE,
    VERMILION,
    new_figure,
    shade_turn,
    styled,
)
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import IMU_FILTER, low_pass
from aerodima.workbench.metrics.turn_signals import turn_window

RUN_STYLES: tuple[tuple[str, Any], ...] = (
    (BLACK, "-"),
    (VERMILION, (0, (5, 1.5))),
    (BLUE, (0, (1, 1))),
    (GREEN, (0, (5, 1.5, 1, 1.5))),
    (PURPLE, (0, (8, 2, 1, 2, 1, 2))),
)
"""Colour and line of the first, second, ... run; both differ, so that neither alone must be told apart."""

_PANELS = (
    ("yaw rate [rad/s]", "imu_gyro_z_rad_per_s", True),
    ("lateral acceleration [m/s²]", "imu_acceleration_y_m_per_s2", True),
    ("speed [m/s]", "speed_m_per_s", False),
    ("roll of the car [deg]", "roll_truth_rad", False),
    ("tail roll angle [deg]", "tail_roll_angle_rad", False),
    ("tail roll torque [N m]", "tail_roll_torque_n_m", False),
)
"""Label, column, whether the car's IMU filter is applied."""
_WITHOUT_TRUTH = {"roll_truth_rad": "roll_estimate_rad"}


def plot_overlay(run_logs: Sequence[RunLog], names: Sequence[str]) -> Figure:
    """Six signals over time, a line per run; IMU signals after the car's zero-phase filter.

    Args:
        run_logs: up to `len(RUN_STYLES)` runs.
        names: shown in the legend, one per run.

    Raises:
        LogError: a log has no turn, or its sensors are missing.
    """
    with styled():
        figure, grid = new_figure(11.0, 8.0, 3, 2, sharex=True)
        for axes, (label, column, filtered) in zip(grid.flat, _PANELS, strict=True):
            axes.set_ylabel(label)
            shade_turn(axes, turn_window(run_logs[0]))
            for run_log, (colour, line) in zip(run_logs, RUN_STYLES, strict=False):
                _draw(axes, run_log, column, filtered, colour, line)
        for axes in grid[-1]:
            axes.set_xlabel("time [s]   (shaded: the turn of the first run)")
        handles = [
            grid[0, 0].plot([], [], color=colour, linestyle=line)[0]
            for _, (colour, line) in zip(names, RUN_STYLES, strict=False)
        ]
        figure.legend(handles, names, loc="outside upper center", ncols=min(3, len(names)))
    return figure


def _draw(axes: Axes, run_log: RunLog, column: str, filtered: bool, colour: str, line: Any) -> None:
    if column not in run_log.table:
        column = _WITHOUT_TRUTH.get(column, column)
    if column not in run_log.table or (column.startswith("tail_") and run_log.scenario["tail"]["mode"] == "none"):
        return
    values = run_log.signal(column)
    if filtered:
        values = low_pass(run_log.time, values, IMU_FILTER, column)
    if column.endswith("_rad"):
        values = np.degrees(np.unwrap(values))
    axes.plot(run_log.time, values, color=colour, linestyle=line)
