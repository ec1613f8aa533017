"""Signals of runs for a page: channels with names and units, and samples thinned for a plot.

A run keeps every sample up to `MAX_POINTS`. A longer run is cut into equal stretches, each of which
keeps its smallest and its largest value in the order in which they came, so no peak is lost, and
none is shown more than a stretch too early or late. Names and units are those of the column table.
"""

import base64
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from aerodima.workbench.car.turn_signals import turn_window
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.mapping import unit_in_name
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.metrics.run_summary import tails_of
from aerodima.workbench.scenario.signal_table import (
    CAR_PORTS,
    CAR_TRUTH,
    RIG_PORTS,
    RIG_TRUTH,
    TIME,
    WHEELS,
    Column,
)
from aerodima.workbench.view.figure_style import TURN_SHADE
from aerodima.workbench.view.run_figures import RUN_STYLES

MAX_POINTS = 2500
"""Largest number of samples of one channel of one run on a page; 13 kB."""
_MAX_TOTAL_POINTS = 12_500
"""Largest number of samples of one channel over all runs: of six or more runs each has fewer."""
_TABLE: Mapping[str, Column] = {
    column.name: column
    for ports in (RIG_PORTS, RIG_TRUTH, CAR_PORTS, CAR_TRUTH)
    for columns in ports.values()
    for column in columns
}
_EXCLUDED = (TIME, "plant_position_", "plant_velocity_", "pose_", "wheel_contact_")
"""Columns that are not channels: time, positions that the 3-D view shows, rates of the joints."""
_SHOWN = (
    "imu_gyro_z_rad_per_s",
    "imu_acceleration_y_m_per_s2",
    "speed_m_per_s",
    "roll_truth_rad",
    "tail_roll_angle_rad",
    "tail_roll_torque_n_m",
)
"""Channels of cars that are chosen at first."""
_SHOWN_OF_ONE = (
    "gyro_z_truth_rad_per_s",
    "roll_estimate_rad",
    "steering_command_rad",
    *(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS),
)
"""Further channels of a single car that are chosen at first."""
_SHOWN_OF_PLANT = ("com_z_truth_m", "com_velocity_x_truth_m_per_s", "tilt_truth_rad")
"""Channels of other plants that are chosen at first."""


def channels_of(run_logs: Sequence[RunLog], names: Sequence[str]) -> Json:
    """Collects what `signals.js` draws, ready for JSON; samples are float32 in base64, or one
    number for a channel that never changes.

    The time of a single run is that of its log; several runs are laid over one another from the
    first sample of each.

    Args:
        run_logs: logs of up to `len(RUN_STYLES)` runs; they may differ in length and step.
        names: names of the runs.
    """
    count = min(MAX_POINTS, _MAX_TOTAL_POINTS // len(run_logs))
    times = [run_log.time for run_log in run_logs]
    start = 0.0
    if len(run_logs) > 1:
        start = times[0][0]
        times = [time - time[0] for time in times]
    possible = [_channel(name, run_logs, count) for name in _columns(run_logs)]
    channels = [channel for channel in possible if channel is not None]
    present = {channel["name"] for channel in channels}
    runs = [
        {"name": name, "time": _packed(_thin_time(time, count))}
        for name, time in zip(names, times, strict=True)
    ]
    end = max(time[-1] for time in times)
    chosen = _first_chosen(run_logs, present)
    turn: list[float] | None = None
    with suppress(LogError):  # a run without a turn
        turn = [float(time) - start for time in turn_window(run_logs[0])]
    return {
        "runs": runs,
        "channels": channels,
        "chosen": [name for name in chosen if name in present],
        "looks": line_looks(),
        "span": [float(times[0][0]), float(end)],
        "turn": turn,
        "shade": TURN_SHADE,
    }


def _first_chosen(run_logs: Sequence[RunLog], present: set[str]) -> list[str]:
    """Lists the channels that are drawn at first."""
    if any(run_log.kind == PLANT_RUN for run_log in run_logs):
        tails = dict.fromkeys(tail for run_log in run_logs for tail, _ in tails_of(run_log))
        return [*_SHOWN_OF_PLANT, *(f"{tail}_{axis}_truth_n" for tail in tails for axis in "yz")]
    if len(run_logs) == 1:
        return [*_SHOWN, *_SHOWN_OF_ONE]
    if "roll_truth_rad" in present:
        return [*_SHOWN]
    return [*_SHOWN, "roll_estimate_rad"]


def line_looks() -> list[Json]:
    """Lists colour and dashes (pixels; none for a full line) of the first, second, ... line, as in
    printed figures.
    """
    looks = []
    for colour, line in RUN_STYLES:
        look: Json = {"colour": colour}
        if line != "-":
            look["dash"] = [round(1.6 * length, 1) for length in line[1]]
        looks.append(look)
    return looks


def _columns(run_logs: Sequence[RunLog]) -> list[str]:
    """Lists channels that a run has, those of the column table first and in its order."""
    names = {str(name) for run_log in run_logs for name in run_log.table.columns}
    present = {name for name in names if not name.startswith(_EXCLUDED)}
    return [name for name in _TABLE if name in present] + sorted(present - set(_TABLE))


def _channel(name: str, run_logs: Sequence[RunLog], count: int) -> Json | None:
    """Collects name, unit, meaning and samples per run; None when no run has a number in it."""
    values = [_values(run_log, name, count) for run_log in run_logs]
    if all(value is None for value in values):
        return None
    column = _TABLE.get(name, Column(name, unit_in_name(name), name))
    return {
        "name": name,
        "unit": column.unit,
        "meaning": column.meaning,
        "family": family(name),
        "values": values,
    }


def family(name: str) -> str:
    """Names what a column measures: the same for the sensor, the estimate and the truth of one
    quantity, and for the wheels.
    """
    for wheel in WHEELS:
        name = name.replace(wheel, "wheel")
    return re.sub(r"^imu_|_truth|_estimate", "", name)


def _values(run_log: RunLog, name: str, count: int) -> str | float | None:
    """Packs the samples of a channel; one number if it never changes, None if there is none."""
    of_tail = name.startswith(("tail_", "sail_"))
    if name not in run_log.table or (of_tail and not run_log.has_tail):
        return None
    values = run_log.signal(name)
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    if known.size == values.size and np.all(values == values[0]):
        return float(values[0])
    return _packed(thinned(values, count))


def thinned(values: FloatArray, count: int) -> FloatArray:
    """Keeps at most `count` of the samples (n,): the smallest and the largest of equal stretches;
    NaN where one is NaN.
    """
    if values.size <= count:
        return values
    length = _stretch_length(values.size, count)
    padding = np.full(-values.size % length, values[-1])
    stretches = np.concatenate([values, padding]).reshape(-1, length)
    extremes = np.column_stack([np.argmin(stretches, axis=1), np.argmax(stretches, axis=1)])
    return np.take_along_axis(stretches, np.sort(extremes, axis=1), axis=1).ravel()


def _thin_time(time: FloatArray, count: int) -> FloatArray:
    """Computes the times of the samples that `thinned` keeps: beginning and middle of each stretch;
    the last one is the end.
    """
    if time.size <= count:
        return time
    length = _stretch_length(time.size, count)
    begins = np.arange(0, time.size, length)
    rows = np.column_stack([begins, begins + length // 2])
    thin = np.interp(rows.ravel(), np.arange(time.size), time)
    thin[-1] = time[-1]
    if thin[-1] <= thin[-2]:
        thin[-2] = 0.5 * (thin[-3] + time[-1])
    return thin


def _stretch_length(samples: int, count: int) -> int:
    """Computes how many samples share a stretch, of which two are kept."""
    return math.ceil(samples / (count // 2))


def _packed(values: FloatArray) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()
