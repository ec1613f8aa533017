"""Signals of runs for a page: channels with names and units of the column table, their samples
thinned out for a plot.

A run keeps every sample up to `MAX_POINTS`; of a longer one each of equal stretches keeps its
smallest and its largest value in the order in which they came, so no peak is lost, and none is
shown by more than a stretch too early or late.
"""

import base64
import re
from collections.abc import Mapping, Sequence

import numpy as np

from aerodima.workbench.car.turn_signals import turn_window
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.mapping import unit_in_name
from aerodima.workbench.logs.schema import PLANT_RUN, Json, RunLog
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
"""Samples of one channel of one run on a page; 13 kB."""
_MAX_TOTAL_POINTS = 12_500
"""Samples of one channel of all runs: from the sixth run on each has fewer."""
_TABLE: Mapping[str, Column] = {
    column.name: column
    for ports in (RIG_PORTS, RIG_TRUTH, CAR_PORTS, CAR_TRUTH)
    for columns in ports.values()
    for column in columns
}
_EXCLUDED = ("plant_position_", "plant_velocity_", "pose_", "wheel_contact_")
"""Places that the 3-D view shows, and the rates of the plant's joints."""
_SHOWN = (
    *("imu_gyro_z_rad_per_s", "imu_acceleration_y_m_per_s2", "speed_m_per_s", "roll_truth_rad"),
    *("tail_roll_angle_rad", "tail_roll_torque_n_m"),
)
_SHOWN_OF_ONE = (
    *("gyro_z_truth_rad_per_s", "roll_estimate_rad", "steering_command_rad"),
    *(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS),
)
_SHOWN_OF_PLANT = ("com_z_truth_m", "com_velocity_x_truth_m_per_s", "tilt_truth_rad")
"""Channels that are chosen at first: of cars, further ones of a single car, of other plants."""


def channels_of(run_logs: Sequence[RunLog], names: Sequence[str]) -> Json:
    """What `signals.js` draws, ready for JSON; samples are float32 in base64, a channel that never
    changes one number.

    The time of a single run is that of its log, several runs are laid over one another from the
    first sample of each.

    Args:
        run_logs: up to `len(RUN_STYLES)` runs; they may differ in length and step.
        names: of the runs.
    """
    alone = len(run_logs) == 1
    starts = [0.0 if alone else float(run_log.time[0]) for run_log in run_logs]
    ends = [
        float(run_log.time[-1]) - start for run_log, start in zip(run_logs, starts, strict=True)
    ]
    most = min(MAX_POINTS, _MAX_TOTAL_POINTS // len(run_logs))
    channels = []
    for name in _columns(run_logs):
        channel = _channel(name, run_logs, most)
        if channel is not None:
            channels.append(channel)
    there = {channel["name"] for channel in channels}
    return {
        "runs": [
            {"name": name, "time": _packed(_thin_time(run_log.time - start, most))}
            for name, run_log, start in zip(names, run_logs, starts, strict=True)
        ],
        "channels": channels,
        "chosen": [name for name in _first_chosen(run_logs, there) if name in there],
        "looks": line_looks(),
        "span": [float(run_logs[0].time[0]) if alone else 0.0, max(ends)],
        "turn": _turn(run_logs[0], starts[0]),
        "shade": TURN_SHADE,
    }


def _first_chosen(run_logs: Sequence[RunLog], there: set[str]) -> list[str]:
    if any(run_log.kind == PLANT_RUN for run_log in run_logs):
        air = []
        for run_log in run_logs:
            for tail, _ in tails_of(run_log):
                air += [f"{tail}_{axis}_truth_n" for axis in "yz"]
        return [*_SHOWN_OF_PLANT, *dict.fromkeys(air)]
    if len(run_logs) == 1:
        return [*_SHOWN, *_SHOWN_OF_ONE]
    if "roll_truth_rad" in there:
        return [*_SHOWN]
    return [*_SHOWN, "roll_estimate_rad"]


def line_looks() -> list[Json]:
    """Colour and dashes (pixels; none of a full line) of the first, second, ... line, as in printed
    figures.
    """
    looks = []
    for colour, line in RUN_STYLES:
        look: Json = {"colour": colour}
        if line != "-":
            look["dash"] = [round(1.6 * length, 1) for length in line[1]]
        looks.append(look)
    return looks


def _columns(run_logs: Sequence[RunLog]) -> list[str]:
    """Channels that a run has, those of the column table first and in its order."""
    present = {str(name) for run_log in run_logs for name in run_log.table.columns}
    present = {name for name in present if name != TIME and not name.startswith(_EXCLUDED)}
    return [name for name in _TABLE if name in present] + sorted(present - set(_TABLE))


def _channel(name: str, run_logs: Sequence[RunLog], most: int) -> Json | None:
    """Name, unit, meaning and samples per run; None when no run has a number in it."""
    values = [_values(run_log, name, most) for run_log in run_logs]
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
    """What a column measures: equal for the sensor, the estimate and the truth of one quantity, and
    for the wheels.
    """
    for wheel in WHEELS:
        name = name.replace(wheel, "wheel")
    return re.sub(r"^imu_|_truth|_estimate", "", name)


def _values(run_log: RunLog, name: str, most: int) -> str | float | None:
    if name not in run_log.table or (name.startswith(("tail_", "sail_")) and not run_log.has_tail):
        return None
    values = run_log.signal(name)
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    if known.size == values.size and np.all(values == values[0]):
        return float(values[0])
    return _packed(thinned(values, most))


def thinned(values: FloatArray, most: int) -> FloatArray:
    """At most so many of the samples (n,): of equal stretches the smallest and the largest; NaN
    where one is NaN.
    """
    if values.size <= most:
        return values
    stretches = _stretches(values, most)
    picks = np.sort(
        np.column_stack([np.argmin(stretches, axis=1), np.argmax(stretches, axis=1)]), axis=1
    )
    return np.take_along_axis(stretches, picks, axis=1).ravel()


def _thin_time(time: FloatArray, most: int) -> FloatArray:
    """Times of the samples that `thinned` keeps: beginning and middle of each stretch; the last one
    is the end.
    """
    if time.size <= most:
        return time
    length = _stretch_length(time.size, most)
    stretches = -(-time.size // length)
    rows = np.arange(stretches)[:, None] * length + [0, length // 2]
    thin = np.interp(rows.ravel(), np.arange(time.size), time)
    thin[-1] = time[-1]
    if thin[-1] <= thin[-2]:
        thin[-2] = 0.5 * (thin[-3] + time[-1])
    return thin


def _stretch_length(count: int, most: int) -> int:
    return -(-count // (most // 2))


def _stretches(values: FloatArray, most: int) -> FloatArray:
    """The samples in rows of equal length, the last of them filled up with the last sample."""
    length = _stretch_length(values.size, most)
    padded = np.concatenate([values, np.full(-values.size % length, values[-1])])
    return padded.reshape(-1, length)


def _packed(values: FloatArray) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def _turn(run_log: RunLog, start: float) -> list[float] | None:
    """Beginning and end of the turn, s; None for a run without one."""
    try:
        window = turn_window(run_log)
    except LogError:
        return None
    return [float(time) - start for time in window]
