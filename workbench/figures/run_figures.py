"""Figures of one run over time, and of several over one another: what differs between them, signal by signal."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import WHEELS
from aerodima.workbench.errors import LogError
from aerodima.workbench.figures.figure_style import (
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
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import GPS_FILTER, IMU_FILTER, LowPass, low_pass
from aerodima.workbench.metrics.run_summary import of_plants, plant_air, plant_speed, plant_tilt
from aerodima.workbench.metrics.turn_signals import turn_window

_WHEEL_STYLES = {
    "front_left": (BLUE, "-"),
    "front_right": (VERMILION, "-"),
    "rear_left": (SKY, (0, (4, 1.5))),
    "rear_right": (ORANGE, (0, (4, 1.5))),
}
_BEFORE = 0.5
"""Shown before the turn, s."""


def plot_turn(run_log: RunLog, title: str = "", after: float = 1.4) -> Figure:
    """A turn over time: yaw rate and lateral acceleration of the IMU, speed, roll, tail angle, wheel loads.

    IMU and GPS are drawn as logged and after the car's zero-phase filters. Ground truth is added where the log has it;
    a log of the real car gets the same figure without it.

    Args:
        run_log: of a run with a turn.
        title: above the figure; none when empty.
        after: shown after the end of the turn, s.

    Raises:
        LogError: a column is missing, or the log ends before the turn does.
    """
    window = turn_window(run_log)
    if run_log.time[-1] < window[1] - 1e-6:
        raise LogError(f"{run_log.name}: ends at {run_log.time[-1]:g} s, before its turn does")
    with styled():
        figure, grid = new_figure(11.0, 7.6, 3, 2, sharex=True)
        _plot_yaw_rate(grid[0, 0], run_log)
        _plot_acceleration(grid[0, 1], run_log)
        _plot_speed(grid[1, 0], run_log)
        _plot_roll(grid[1, 1], run_log)
        _plot_tail(grid[2, 0], run_log)
        _plot_wheel_loads(grid[2, 1], run_log)
        start, end = max(run_log.time[0], window[0] - _BEFORE), min(run_log.time[-1], window[1] + after)
        for axes in grid.flat:
            shade_turn(axes, window)
            axes.set_xlim(start, end)
            _fit_to_shown(axes, start, end)
        for axes in grid[-1]:
            axes.set_xlabel("time [s]   (shaded: the turn, steering command to straight wheels)")
        if title:
            figure.suptitle(title, fontsize=12, fontweight="bold", x=0.01, ha="left")
    return figure


def _plot_yaw_rate(axes: Axes, run_log: RunLog) -> None:
    _raw_and_filtered(axes, run_log, "imu_gyro_z_rad_per_s", IMU_FILTER)
    if run_log.scenario["tail"]["mode"] == "swing":
        trigger = run_log.scenario["controller"]["trigger_yaw_rate"]
        side = -1.0 if run_log.scenario["manoeuvre"]["direction"] == "right" else 1.0
        axes.axhline(
            side * trigger, color=GREEN, linestyle=(0, (1, 1)), linewidth=1.2, label=f"trigger {trigger:g} rad/s"
        )
    axes.set(ylabel="yaw rate [rad/s]", title="Yaw rate of the IMU")
    axes.legend(loc="upper right")


def _plot_acceleration(axes: Axes, run_log: RunLog) -> None:
    _raw_and_filtered(axes, run_log, "imu_acceleration_y_m_per_s2", IMU_FILTER)
    axes.set(ylabel="lateral acceleration [m/s²]", title="Lateral acceleration of the IMU (to the left)")
    axes.legend(loc="upper right")


def _plot_speed(axes: Axes, run_log: RunLog) -> None:
    _raw_and_filtered(axes, run_log, "speed_m_per_s", GPS_FILTER)
    if run_log.has_truth:
        truth = np.hypot(run_log.signal("velocity_x_truth_m_per_s"), run_log.signal("velocity_y_truth_m_per_s"))
        axes.plot(run_log.time, truth, color=GREEN, linestyle=(0, (5, 2)), label="truth")
    axes.set(ylabel="speed [m/s]", title="Speed of the GPS")
    axes.legend(loc="lower left", ncols=3)


def _plot_roll(axes: Axes, run_log: RunLog) -> None:
    time = run_log.time
    estimate = np.degrees(np.unwrap(run_log.signal("roll_estimate_rad")))
    axes.plot(time, estimate, color=GREY, linewidth=1.2, label="on-board estimate")
    if run_log.has_truth:
        roll = np.degrees(np.unwrap(run_log.signal("roll_truth_rad")))
        axes.plot(time, roll, color=BLACK, linestyle=(0, (5, 2)), label="truth")
    axes.set(ylabel="roll [deg]", title="Roll of the body (to the right)")
    axes.legend(loc="upper left")


def _plot_tail(axes: Axes, run_log: RunLog) -> None:
    axes.set(ylabel="tail roll [deg]", title="Tail roll (0 up, + to the right)")
    if not run_log.has_tail:
        axes.text(0.5, 0.5, "this car has no tail", transform=axes.transAxes, ha="center", color=GREY)
        axes.set_ylim(-100.0, 100.0)
        return
    axes.plot(run_log.time, np.degrees(run_log.signal("tail_roll_angle_rad")), color=BLACK, label="angle")
    axes.set_ylim(-115.0, 115.0)
    axes.set_yticks([-90.0, -45.0, 0.0, 45.0, 90.0])
    torque = axes.twinx()
    torque.plot(
        run_log.time,
        run_log.signal("tail_roll_torque_n_m"),
        color=PURPLE,
        linewidth=1.0,
        linestyle=(0, (1, 1)),
        label="torque",
    )
    torque.set_ylabel("roll motor torque [N m]", color=PURPLE)
    torque.spines["right"].set_visible(True)
    torque.grid(False)
    lines = [*axes.get_lines(), *torque.get_lines()]
    axes.legend(lines, [str(line.get_label()) for line in lines], loc="upper left", ncols=2)


def _plot_wheel_loads(axes: Axes, run_log: RunLog) -> None:
    axes.set(ylabel="vertical force [N]", title="Wheel loads")
    if not run_log.has_truth:
        axes.text(0.5, 0.5, "the car does not measure them", transform=axes.transAxes, ha="center", color=GREY)
        return
    for wheel in WHEELS:
        colour, line = _WHEEL_STYLES[wheel]
        load = run_log.signal(f"wheel_force_{wheel}_z_truth_n")
        axes.plot(run_log.time, load, color=colour, linestyle=line, linewidth=1.2, label=wheel.replace("_", " "))
    axes.legend(loc="upper left", ncols=4, columnspacing=1.0, handlelength=1.6)


def _raw_and_filtered(axes: Axes, run_log: RunLog, column: str, design: LowPass) -> None:
    """The signal as logged, light, and its low pass, dark."""
    signal = run_log.signal(column)
    filtered = low_pass(run_log.time, signal, design, column)
    axes.plot(run_log.time, signal, color="#9a9a9a", linewidth=0.9, label="as logged")
    axes.plot(run_log.time, filtered, color=BLACK, label=f"filtered, {design.cutoff_hz:g} Hz")


def _fit_to_shown(axes: Axes, start: float, end: float) -> None:
    """Scales the y axis to what is shown, leaving room for the legend, unless it was set by hand."""
    if not axes.get_autoscaley_on():
        return
    shown: list[FloatArray] = []
    for line in axes.get_lines():
        x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
        if x.size > 2:
            shown.append(y[(x >= start) & (x <= end)])
    if shown:
        values = np.concatenate(shown)
        low, high = float(np.min(values)), float(np.max(values))
        span = max(high - low, 1e-3)
        axes.set_ylim(low - 0.12 * span, high + 0.3 * span)


_RUN_COLOURS = (BLACK, VERMILION, BLUE, GREEN, PURPLE)
_RUN_LINES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)), (0, (8, 2, 1, 2, 1, 2)))
RUN_STYLES: tuple[tuple[str, Any], ...] = tuple(
    (_RUN_COLOURS[run % 5], _RUN_LINES[(run + run // 5) % 5]) for run in range(20)
)
"""Colour and line of the first, second, ... run. Of the first five both differ, so that neither alone must be told
apart; of twenty the pair does."""

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
_PLANT_PANELS = (
    ("speed of the centre of mass [m/s]", plant_speed),
    ("height of the centre of mass [m]", lambda run_log: run_log.signal("com_z_truth_m")),
    ("tilt of the base [deg]", plant_tilt),
    ("air on the tails [N]", plant_air),
)
"""Label, and the signal of a plant that is no car; None where it has none."""


def plot_overlay(run_logs: Sequence[RunLog], names: Sequence[str]) -> Figure:
    """Six signals of cars over time, or four of other plants, a line per run.

    IMU signals are shown after the car's zero-phase filter.

    Args:
        run_logs: up to `len(RUN_STYLES)` runs.
        names: shown in the legend, one per run.

    Raises:
        LogError: a log has no turn, or its sensors are missing; or cars and other plants are mixed.
    """
    plants = of_plants(run_logs)
    with styled():
        figure, grid = new_figure(11.0, 6.0 if plants else 8.0, 2 if plants else 3, 2, sharex=True)
        for axes, panel in zip(grid.flat, _PLANT_PANELS if plants else _PANELS, strict=True):
            axes.set_ylabel(panel[0])
            if not plants:
                shade_turn(axes, turn_window(run_logs[0]))
            for run_log, (colour, line) in zip(run_logs, RUN_STYLES, strict=False):
                _draw(axes, run_log, panel[1:], colour, line)
        for axes in grid[-1]:
            axes.set_xlabel("time [s]" if plants else "time [s]   (shaded: the turn of the first run)")
        handles = [
            grid[0, 0].plot([], [], color=colour, linestyle=line)[0]
            for _, (colour, line) in zip(names, RUN_STYLES, strict=False)
        ]
        figure.legend(handles, names, loc="outside upper center", ncols=min(3, len(names)))
    return figure


def _draw(axes: Axes, run_log: RunLog, signal: tuple[Any, ...], colour: str, line: Any) -> None:
    """One line: a signal of a plant, or a column of a car and whether its IMU filter is applied."""
    if callable(signal[0]):
        if (found := signal[0](run_log)) is not None:
            axes.plot(run_log.time, found, color=colour, linestyle=line)
        return
    column, filtered = signal
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
