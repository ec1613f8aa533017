"""Figures of one run over time, and of several over one another: what differs between them, signal
by signal.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from aerodima.workbench.car.turn_signals import turn_window
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import GPS_FILTER, IMU_FILTER, LowPass, low_pass
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

_BEFORE = 0.5
"""Shown before the turn, s."""
_AFTER = 1.4
"""Shown after the turn, s."""
_DASHED = (0, (5, 2))
"""Matplotlib's line style of a true signal."""
_SHORT = (0, (4, 1.5))
"""Matplotlib's line style of the rear wheels."""
_SPEED_TRUTH = "speed over ground"
"""Stands for a column that is made of two."""
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
"""Label, and the signal; None where a run has none."""
_PLANT_PANELS: tuple[_Panel, ...] = (
    ("speed of the centre of mass [m/s]", plant_speed),
    ("height of the centre of mass [m]", lambda run_log: run_log.signal("com_z_truth_m")),
    ("tilt of the base [deg]", plant_tilt),
    ("air on the tails [N]", plant_air),
)
"""Panels of plants that are no cars."""


@dataclass(frozen=True)
class _Line:
    """Look of a column: its name in the legend, colour and line, and the car's filter it is shown
    after.
    """

    label: str
    column: str
    colour: str
    line: Any = "-"
    design: LowPass | None = None


def _as_logged(column: str, design: LowPass) -> tuple[_Line, _Line]:
    """Draws the signal as logged, light, and its low pass, dark."""
    return (
        _Line("as logged", column, "#9a9a9a"),
        _Line(f"filtered, {design.cutoff_hz:g} Hz", column, BLACK, "-", design),
    )


_TURN_PANELS: Sequence[tuple[str, str, Sequence[_Line]]] = (
    (
        "Yaw rate of the IMU",
        "yaw rate [rad/s]",
        _as_logged("imu_gyro_z_rad_per_s", IMU_FILTER),
    ),
    (
        "Lateral acceleration of the IMU (to the left)",
        "lateral acceleration [m/s²]",
        _as_logged("imu_acceleration_y_m_per_s2", IMU_FILTER),
    ),
    (
        "Speed of the GPS",
        "speed [m/s]",
        (
            *_as_logged("speed_m_per_s", GPS_FILTER),
            _Line("truth", _SPEED_TRUTH, GREEN, _DASHED),
        ),
    ),
    (
        "Roll of the body (to the right)",
        "roll [deg]",
        (
            _Line("on-board estimate", "roll_estimate_rad", GREY),
            _Line("truth", "roll_truth_rad", BLACK, _DASHED),
        ),
    ),
    (
        "Tail roll (0 up, + to the right)",
        "tail roll [deg]",
        (_Line("angle", "tail_roll_angle_rad", BLACK),),
    ),
    (
        "Wheel loads",
        "vertical force [N]",
        (
            _Line("front left", "wheel_force_front_left_z_truth_n", BLUE),
            _Line("front right", "wheel_force_front_right_z_truth_n", VERMILION),
            _Line("rear left", "wheel_force_rear_left_z_truth_n", SKY, _SHORT),
            _Line("rear right", "wheel_force_rear_right_z_truth_n", ORANGE, _SHORT),
        ),
    ),
)
"""Title, label and lines of each panel."""


def plot_turn(run_log: RunLog, title: str = "") -> Figure:
    """Draws a turn over time: yaw rate and lateral acceleration of the IMU, speed, roll, tail
    angle, wheel loads.

    IMU and GPS are drawn as logged and after the car's zero-phase filters. Ground truth is added
    where the log has it; a log of the real car gets the same figure without it.

    Args:
        run_log: of a run with a turn.
        title: above the figure; none when empty.

    Raises:
        LogError: the log ends before the turn does.
    """
    window = turn_window(run_log)
    if run_log.time[-1] < window[1] - 1e-6:
        raise LogError(f"{run_log.name}: ends at {run_log.time[-1]:g} s, before its turn does")
    with styled():
        figure, grid = new_figure(11.0, 7.6, 3, 2, sharex=True)
        start = max(run_log.time[0], window[0] - _BEFORE)
        end = min(run_log.time[-1], window[1] + _AFTER)
        inside = (run_log.time >= start) & (run_log.time <= end)
        for axes, (heading, label, lines) in zip(grid.flat, _TURN_PANELS, strict=True):
            axes.set(ylabel=label, title=heading, xlim=(start, end))
            shade_turn(axes, window)
            for line in lines:
                values = _values(run_log, line.column, line.design)
                if values is not None:
                    axes.plot(
                        run_log.time,
                        values,
                        color=line.colour,
                        linestyle=line.line,
                        label=line.label,
                    )
            if axes.get_lines():
                _fit_to_shown(axes, inside)
                axes.legend(loc="upper left", ncols=4, columnspacing=1.0, handlelength=1.6)
            else:
                axes.text(
                    0.5, 0.5, "not in this log", color=GREY, transform=axes.transAxes, ha="center"
                )
        for axes in grid[-1]:
            axes.set_xlabel("time [s]   (shaded: the turn, steering command to straight wheels)")
        if title:
            figure.suptitle(title, fontsize=12, fontweight="bold", x=0.01, ha="left")
    return figure


def _values(run_log: RunLog, column: str, design: LowPass | None = None) -> FloatArray | None:
    """Reads a column as it is drawn, (n,), angles in degrees; None where this run has none."""
    if column == _SPEED_TRUTH and run_log.has_truth:
        return np.linalg.norm(run_log.vector("velocity", "truth_m_per_s")[:, :2], axis=1)
    if column not in run_log.table or (column.startswith("tail_") and not run_log.has_tail):
        return None
    values = run_log.signal(column)
    if design is not None:
        values = low_pass(run_log.time, values, design, column)
    if column.endswith("_rad"):
        return np.degrees(np.unwrap(values))
    return values


def _roll(run_log: RunLog) -> FloatArray | None:
    """Reads the true roll; of a real car its estimate."""
    if "roll_truth_rad" in run_log.table:
        return _values(run_log, "roll_truth_rad")
    return _values(run_log, "roll_estimate_rad")


def _fit_to_shown(axes: Axes, inside: BoolArray) -> None:
    """Scales the y axis to the shown samples of its lines, leaving room for the legend."""
    shown = np.array([line.get_ydata() for line in axes.get_lines()])[:, inside]
    low = float(np.min(shown))
    high = float(np.max(shown))
    span = max(high - low, 1e-3)
    axes.set_ylim(low - 0.12 * span, high + 0.3 * span)


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
        run_logs: up to `len(RUN_STYLES)` runs.
        names: shown in the legend, one per run.

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
        styles = RUN_STYLES[: len(names)]
        handles = [Line2D([], [], color=colour, linestyle=line) for colour, line in styles]
        figure.legend(handles, names, loc="outside upper center", ncols=min(3, len(names)))
    return figure
