"""The signals of one run that metrics are made of, with the sign turned so that the turn is
positive.

Ground truth is used where the log has it, otherwise the sensors, or the sensors alone;
`TurnSignals.source` says which. Turning the sign makes a left turn and its mirror image in a right
turn equal: yaw rate and lateral acceleration are positive into the turn, roll and roll rate are
positive outwards (to the right in a left turn: a positive rotation about x of B).
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from aerodima.workbench.car.verdict import CALM, has_settled, is_busy, is_calm
from aerodima.workbench.control.manoeuvre import turn_length
from aerodima.workbench.core.array_types import BoolArray, FloatArray, NamedArrays, Pair
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import DRIVEN_BY, PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import check_signals, check_time, checked_table
from aerodima.workbench.scenario.signal_table import GROUND_CONTACTS, TIME, WHEELS

STEERED = 0.01
"""A command above this (rad) is steering by hand, not the middle of a stick."""
_STRAIGHT = 1e-6
"""Angle below which the wheels are straight up to rounding, rad."""
_TIME_MARGIN = 1e-6
"""Log times are sums of steps: a sample this close to the edge of the window (s) belongs to it."""
_RATE_MARGIN = 0.05
"""Share of the wanted rate by which a log may be faster without being thinned out."""
_LOADS = tuple(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS)
_TRUTH = {
    "yaw_rate": "gyro_z_truth_rad_per_s",
    "lateral_acceleration": "acceleration_y_truth_m_per_s2",
    "roll_rate": "gyro_x_truth_rad_per_s",
    "roll": "roll_truth_rad",
    "yaw": "yaw_truth_rad",
    "tilt": "tilt_truth_rad",
}
"""Signals of the ground truth by field of `TurnSignals`."""
_SENSORS = {
    "speed": "speed_m_per_s",
    "yaw_rate": "imu_gyro_z_rad_per_s",
    "lateral_acceleration": "imu_acceleration_y_m_per_s2",
    "roll": "imu_roll_rad",
    "yaw": "imu_yaw_rad",
}
"""Signals of the sensors by field of `TurnSignals`."""
SENSOR_COLUMNS = (*_SENSORS.values(), "imu_pitch_rad", "imu_gyro_x_rad_per_s")
"""Columns of the sensors that signals of a turn are made of."""
_STATE = "controller_state"
_TILT = "tilt_truth_rad"


@dataclass(frozen=True)
class TurnSignals:
    """Signals of a run over its log times, shape (n,) unless stated.

    Attributes:
        time: log times, s.
        window: start and end of the turn (from the steering command until the wheels are straight
            again), s.
        sign: side of the turn, +1 left, -1 right.
        source: origin of the signals, `truth` or `sensors`.
        speed: ground speed, m/s.
        yaw_rate: body rate about z, into the turn, rad/s.
        lateral_acceleration: acceleration along y of B, gravity removed, into the turn, m/s2.
        roll_rate: body rate about x, outwards, rad/s; without truth its mean before the turn (the
            bias of the gyro) is removed.
        roll: roll angle, outwards, unwrapped, rad.
        yaw: heading, into the turn, unwrapped, rad.
        tilt: angle of the body's z axis from the world's, 0 to pi, rad.
        wheel_loads: vertical ground force, order of `WHEELS`, shape (n, 4), N; None without truth.
        ground_contact: ground force on cage, board and tail, shape (n, 3), N; None without truth.
    """

    time: FloatArray
    window: Pair
    sign: float
    source: Literal["truth", "sensors"]
    speed: FloatArray
    yaw_rate: FloatArray
    lateral_acceleration: FloatArray
    roll_rate: FloatArray
    roll: FloatArray
    yaw: FloatArray
    tilt: FloatArray
    wheel_loads: FloatArray | None
    ground_contact: FloatArray | None

    def sampled(self, rate: float) -> "TurnSignals":
        """Returns what a logger of `rate` (Hz) would have kept: the newest row at each k / rate;
        all of a slower log.
        """
        count = self.time.size
        if (count - 1) / (self.time[-1] - self.time[0]) <= rate * (1.0 + _RATE_MARGIN):
            return self
        first = math.ceil(self.time[0] * rate - _TIME_MARGIN)
        last = math.floor(self.time[-1] * rate + _TIME_MARGIN)
        instants = np.arange(first, last + 1) / rate + _TIME_MARGIN
        rows = np.searchsorted(self.time, instants, side="right") - 1
        sampled: dict[str, Any] = {
            name: values[rows]
            for name, values in vars(self).items()
            if isinstance(values, np.ndarray)
        }
        return replace(self, **sampled)

    @property
    def in_window(self) -> BoolArray:
        """Returns which samples lie in the window, both ends included."""
        return self.from_start & (self.time <= self.window[1] + _TIME_MARGIN)

    @property
    def from_start(self) -> BoolArray:
        """Returns which samples lie at or after the start of the turn."""
        return self.time >= self.window[0] - _TIME_MARGIN


def turn_signals(run_log: RunLog, source: Literal["truth", "sensors"] | None = None) -> TurnSignals:
    """Returns signals of a run's turn, from the given source; by default from the truth where the
    log has it. A signal made from a column of nothing but NaN is NaN.

    Raises:
        LogError: a column or scenario key is missing, single NaN, unsorted time or a gap, the log
            ends before the turn does.
    """
    if run_log.kind == PLANT_RUN:
        raise LogError(
            f"{run_log.name}: a turn and its metrics need a run of the car; plant_metrics() reads "
            "this log"
        )
    time = run_log.time
    check_time(time)
    sign = turn_sign(run_log)
    window = turn_window(run_log)
    source = source or ("truth" if run_log.has_truth else "sensors")
    named = _read(run_log, source, window[0])
    logged = {name: values for name, values in named.items() if not np.isnan(values).all()}
    check_signals(time, {f"{name} ({source})": values for name, values in logged.items()})
    if time[0] > window[0] + _TIME_MARGIN or time[-1] < window[1] - _TIME_MARGIN:
        raise LogError(
            f"{run_log.name}: holds {time[0]:g} to {time[-1]:g} s, the turn is {window[0]:g} to "
            f"{window[1]:g} s"
        )
    turned = {
        name: sign * values for name, values in named.items() if name not in ("speed", "tilt")
    }
    return TurnSignals(
        time=time,
        window=window,
        sign=sign,
        source=source,
        speed=named["speed"],
        tilt=named["tilt"],
        wheel_loads=_columns(run_log, _LOADS),
        ground_contact=_columns(
            run_log, [f"ground_contact_{part}_truth_n" for part in GROUND_CONTACTS]
        ),
        **turned,
    )


def turn_sign(run_log: RunLog) -> float:
    """Returns +1 for a left turn, -1 for a right one, the side of the first steering; +1 for a
    straight run or a slalom.
    """
    if DRIVEN_BY in run_log.extra:
        return -1.0 if np.sum(run_log.signal("steering_command_rad")) < 0.0 else 1.0
    if run_log.setting("manoeuvre", "kind") in ("straight", "slalom"):
        return 1.0
    return -1.0 if run_log.setting("manoeuvre", "direction") == "right" else 1.0


def turn_window(run_log: RunLog) -> Pair:
    """Returns the start and end of the turn, s: from the steering command to straight wheels after
    it.

    The end is that of the last step of steering plus the time in which the servo brings the wheels
    back. A turn starts when the scenario says, the turn of the AUTO sequence at the first steering
    command in the log. A fishhook ends after the last steering command in the log, or with the log.
    For other kinds the window is the run from `turn_start` on, or the whole run if it is shorter
    than that. For a car that somebody steered, the window is from the first to the last steering
    command, or the whole run without any.
    """
    first = float(run_log.time[0])
    last = float(run_log.time[-1])
    if DRIVEN_BY in run_log.extra:
        steered = _steered_times(run_log, STEERED)
        if steered.size:
            return float(steered[0]), float(steered[-1])
        return first, last
    kind = run_log.setting("manoeuvre", "kind")
    start = run_log.number("manoeuvre", "turn_start")
    if kind not in ("turn", "auto_turn", "fishhook"):
        return (start if first < start < last else first), last
    steer_angle = run_log.number("manoeuvre", "steer_angle")
    rate = run_log.number("servo", "rate")
    if rate <= 0.0:
        raise LogError(
            f"{run_log.name}: its scenario has servo.rate {rate:g}, but it must be above 0"
        )
    if kind == "fishhook":
        steered = _steered_times(run_log, STEERED)
        steered_until = float(steered[-1]) if steered.size else start
        return start, min(steered_until + steer_angle / rate, last)
    settings = run_log.scenario["manoeuvre"]
    several: dict[str, Any] = {}
    if kind == "turn":
        several["repeats"] = int(settings.get("turns", 1))
        several["gap"] = float(settings.get("turn_gap", 0.0))
    else:
        steered = _steered_times(run_log, 0.5 * steer_angle)
        if steered.size == 0:
            raise LogError(f"{run_log.name}: no steering command in the run, so no turn to measure")
        start = float(steered[0])
    # An old log has one level and one step of steering and does not name others.
    for key in ("first_angle", "first_hold"):
        if key in settings:
            several[key] = run_log.number("manoeuvre", key)
    hold = run_log.number("manoeuvre", "turn_hold")
    return start, start + turn_length(rate, steer_angle, hold, **several)


def _steered_times(run_log: RunLog, angle: float) -> FloatArray:
    """Returns the times (k,), s, at which a run is steered by more than an angle, rad."""
    return run_log.time[np.abs(run_log.signal("steering_command_rad")) > angle]


class SteeredWindow(NamedTuple):
    """A time in which a car is steered to one side.

    Attributes:
        start, end: times of the window, s; the end is the first instant at which the command is no
            longer to that side, or the end of the log.
        side: side of the steering, +1 left, -1 right.
    """

    start: float
    end: float
    side: float


def steered_windows(time: FloatArray, angle: FloatArray) -> list[SteeredWindow]:
    """Returns when a car was steered to which side, in the order of time; none if never.

    Windows are the pulses of a turn, both halves of a fishhook, the half waves of a slalom, and the
    steering of a driver on a path.

    Args:
        time: log times (n,), s.
        angle: steering angle commanded at these times (n,), rad; one below `STEERED` opens no
            window.
    """
    side = np.sign(np.where(np.abs(angle) > _STRAIGHT, angle, 0.0))
    edges = [0, *(np.flatnonzero(np.diff(side)) + 1), side.size]
    return [
        SteeredWindow(float(time[first]), float(time[min(end, side.size - 1)]), float(side[first]))
        for first, end in itertools.pairwise(edges)
        if np.max(np.abs(angle[first:end]), initial=0.0) > STEERED
    ]


def _read(run_log: RunLog, source: str, turn_start: float) -> NamedArrays:
    """Reads the signals of a source by field of `TurnSignals`; the turn starts at a time, s."""
    columns = _TRUTH if source == "truth" else _SENSORS
    values = {name: run_log.signal(column) for name, column in columns.items()}
    values["roll"] = np.unwrap(values["roll"])
    values["yaw"] = np.unwrap(values["yaw"])
    if source == "truth":
        velocity = [run_log.signal(f"velocity_{axis}_truth_m_per_s") for axis in "xy"]
        values["speed"] = np.hypot(*velocity)
    else:
        level = np.cos(values["roll"]) * np.cos(run_log.signal("imu_pitch_rad"))
        values["tilt"] = np.arccos(np.clip(level, -1.0, 1.0))
        rate = run_log.signal("imu_gyro_x_rad_per_s")
        time = run_log.time
        # In the second half of the driving before the turn the car goes straight.
        straight = (time >= 0.5 * (time[0] + turn_start)) & (time < turn_start)
        bias = np.mean(rate[straight]) if np.any(straight) else 0.0
        values["roll_rate"] = rate - bias
    return values


def _columns(run_log: RunLog, names: Sequence[str]) -> FloatArray | None:
    if not all(name in run_log.table.columns for name in names):
        return None
    return checked_table(run_log, names)


def settled_row(table: pd.DataFrame | Mapping[str, FloatArray], turn_end: float) -> int | None:
    """Returns the first row of a run's table at which the car has been calm for `CALM_FOR`; None if
    it never was.

    It is None too where the table lacks a column, as that of a real car does.

    Args:
        table: columns as in a run log.
        turn_end: time at which the wheels are straight again, s.
    """
    if not {*CALM, *_LOADS, _STATE} <= set(table):
        return None
    columns = {name: np.asarray(table[name]) for name in (TIME, _STATE, *CALM, *_LOADS)}
    time = columns[TIME]
    motion = {name: columns[name] for name in CALM if name != _TILT}
    loads = [columns[name] for name in _LOADS]
    calm = is_calm(motion, np.cos(columns[_TILT]), loads, is_busy(columns[_STATE]))
    restless = np.maximum.accumulate(np.where(calm & (time >= turn_end), turn_end, time))
    settled = has_settled(time, restless)
    if settled.any():
        return int(np.argmax(settled))
    return None
