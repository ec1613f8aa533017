"""Findings in a log: gaps, lost samples, dead sensors, and values that betray a wrong unit.

A finding names column and time. A fault that makes every later figure wrong (times that run back, a
wrong unit) is an error; a fault that conditioning can deal with (a gap, NaN) or that a user must
judge (a constant signal) is reported and kept.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid
from scipy.signal import detrend

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.logs.signals import gaps_in, median_step
from aerodima.workbench.scenario.signal_table import TIME

MIN_SAMPLES = 32
"""Smallest number of rows that can be filtered and hold an experiment."""
STEP_RANGE = (1e-5, 1.0)
"""Median time step (s) of a plausible log; beyond it the unit of the times is wrong."""
_SPEED = "speed_m_per_s"
_STEERING = "steering_command_rad"
_YAW_RATE = "imu_gyro_z_rad_per_s"
_VERTICAL = "imu_acceleration_z_m_per_s2"
_SIDEWAYS = "integral of speed times yaw rate"
RATE_OF = {
    "angular_velocity_rad_per_s": "angle_rad",
    "tail_pitch_rate_rad_per_s": "tail_pitch_angle_rad",
    "tail_roll_rate_rad_per_s": "tail_roll_angle_rad",
    "sail_rate_rad_per_s": "sail_angle_rad",
    _YAW_RATE: "imu_yaw_rad",
    "imu_acceleration_x_m_per_s2": _SPEED,
    "imu_acceleration_y_m_per_s2": _SIDEWAYS,
}
"""Angle or speed whose derivative each rate column is (for the IMU: while the car is level and does
not slide)."""
MAX_MEDIAN_VERTICAL = 0.8
"""Largest plausible median of the vertical acceleration, m/s2: a car stays on the ground."""
_MAX_OF_UNIT = {
    "rad/s": 60.0,
    "A": 60.0,
    "N": 500.0,
    "N m": 100.0,
    "m/s": 60.0,
    "m/s2": 300.0,
    "rad": 2.1 * np.pi,
}
"""Largest plausible magnitude by unit. An angle stays within a turn, apart from `_MAX_ANGLES`."""
_MAX_ANGLES = {"yaw": 100.0, "sail": 100.0, "steering": 0.5 * np.pi}
"""Largest plausible magnitude of an angle, rad, by a word in its name: yaw and sail may pass a
turn, and no road wheel stands across its car."""
_MEASURED = ("angle", "angular_velocity", "current", "force_", "torque_", "imu_", "tail_", "speed")


@dataclass(frozen=True)
class LogFinding:
    """Something odd in a log: column ("" if it concerns the file), time (s; None if it has none),
    and text that says what it is.
    """

    column: str
    time: float | None
    text: str

    def __str__(self) -> str:
        """Writes one line for a person."""
        text = self.text
        if self.column:
            at = "" if self.time is None else f" at {self.time:g} s"
            text = f"column {self.column!r}{at}: {text}"
        return text


def gap_findings(time: FloatArray, column: str = TIME) -> list[LogFinding]:
    """Finds steps longer than 1.5 median steps: the first of them, and how many follow."""
    wide = gaps_in(time)
    if not wide.size:
        return []
    start = time[wide[0]]
    gap = time[wide[0] + 1] - start
    text = f"gap of {gap:.6g} s, about {round(gap / median_step(time)) - 1} samples lost"
    if wide.size > 1:
        text += f"; {wide.size - 1} further gap(s)"
    return [LogFinding(column, float(start), text)]


def nan_findings(time: FloatArray, column: str, values: FloatArray) -> list[LogFinding]:
    """Counts the samples that are NaN or infinite, and says where the first one is."""
    bad = time[~np.isfinite(values)]
    if not bad.size:
        return []
    text = f"{bad.size} of {values.size} samples are not numbers, the first here"
    return [LogFinding(column, float(bad[0]), text)]


def table_findings(table: pd.DataFrame, kind: str) -> list[LogFinding]:
    """Finds gaps, NaN, too few rows and constant measurements in a table whose times are sorted;
    `kind` is that of the log.
    """
    time = table[TIME].to_numpy(float)
    findings = gap_findings(time)
    if time.size < MIN_SAMPLES:
        text = f"only {time.size} samples; no filter and no fit can work on them"
        findings.append(LogFinding(TIME, None, text))
    for name in table.columns:
        values = table[name].to_numpy(float)
        findings += nan_findings(time, name, values)
        finite = values[np.isfinite(values)]
        # An encoder counts whole steps: a held angle is constant.
        held = kind == "static" and name.startswith("ang")
        changes = name.startswith(_MEASURED) and "_command_" not in name and not held
        if changes and finite.size > 1 and np.ptp(finite) == 0.0:
            text = f"constant, {finite[0]:g} in every row: is the sensor connected?"
            findings.append(LogFinding(name, None, text))
    return findings


def implausible_values(
    table: pd.DataFrame, units: Mapping[str, str], largest: Mapping[str, float | None]
) -> list[str]:
    """Finds values that betray a wrong unit; names each column with its first such value.

    Args:
        table: table of the log in SI units.
        units: SI unit of each column.
        largest: largest plausible magnitude per column where the mapping states one.
    """
    problems = []
    time = table[TIME].to_numpy(float)
    step = median_step(time)
    if not STEP_RANGE[0] <= step <= STEP_RANGE[1]:
        problems.append(
            f"column {TIME!r}: steps of {step:.3g} s; {STEP_RANGE[0]:g} to "
            f"{STEP_RANGE[1]:g} s is plausible. Is the unit of the times right?"
        )
    for name in table.columns:
        unit = units.get(name, "")
        limit = _MAX_OF_UNIT.get(unit, np.inf)
        for word, angle in _MAX_ANGLES.items():
            if unit == "rad" and word in name:
                limit = angle
        limit = largest.get(name) or limit
        values = table[name].to_numpy(float)
        beyond = np.flatnonzero(np.abs(values) > limit)
        if beyond.size:
            first = beyond[0]
            problems.append(
                f"column {name!r}: {values[first]:.6g} {unit} at {time[first]:g} s; up to "
                f"{limit:.4g} is plausible. Is the unit in the mapping right? If the value is "
                "real, state `largest` there"
            )
    return problems


def inconsistent_rates(table: pd.DataFrame) -> list[str]:
    """Finds rates that are plainly not the derivative of their angle, accelerations that are not
    those of the car (other unit, other sign, or gravity in it), and a steering of the wrong sign.

    The angle is compared with the integral of the rate, both without their straight lines (bias of
    a gyro). Signals that have little to do with each other (noise, a car that rolls) are left
    alone.
    """
    problems = []
    off = "(`check_rates: false` in the mapping turns this check off)"
    vertical = table.get(_VERTICAL, pd.Series(0.0)).median()
    if abs(vertical) > MAX_MEDIAN_VERTICAL:
        problems.append(
            f"column {_VERTICAL!r}: {vertical:.3g} m/s2 in the median; gravity must be "
            f"taken out of all accelerations {off}"
        )
    if {_SPEED, _YAW_RATE} <= {*table}:
        lateral = table[_SPEED] * table[_YAW_RATE]
        table = table.assign(**{_SIDEWAYS: cumulative_trapezoid(lateral, table[TIME], initial=0.0)})
    if {_SPEED, _YAW_RATE, _STEERING} <= {*table}:
        turned = cumulative_trapezoid(table[_YAW_RATE], table[TIME], initial=0.0)
        steered = table[_SPEED] * table[_STEERING]
        ratio = _rate_ratio(*np.array([table[TIME], turned, steered], float))
        if ratio is not None and ratio < 0.0:
            problems.append(
                f"column {_STEERING!r}: the car yaws to the other side than it is steered. Both "
                "must be positive to the left; `scale: -1` in the mapping mirrors a column. A car "
                f"that reverses does this, too {off}"
            )
    for rate, angle in RATE_OF.items():
        if rate not in table or angle not in table:
            continue
        ratio = _rate_ratio(*table[[TIME, angle, rate]].to_numpy(float).T)
        # The acceleration of a car that slides does not follow from its speed and yaw rate.
        low, high = (0.3, 3.0) if "acceleration" in rate else (0.6, 1.6)
        if ratio is not None and not low <= ratio <= high:
            problems.append(
                f"column {rate!r}: {ratio:.3g} times the derivative of {angle!r}; one of "
                f"the two has a wrong unit or sign {off}"
            )
    return problems


def _rate_ratio(time: FloatArray, angle: FloatArray, rate: FloatArray) -> float | None:
    """Computes the factor between a rate and the derivative of its angle; None where it cannot be
    told.
    """
    good = np.isfinite(angle) & np.isfinite(rate)
    if np.count_nonzero(good) < MIN_SAMPLES:
        return None
    angle = detrend(np.unwrap(angle[good]))
    integral = detrend(cumulative_trapezoid(rate[good], time[good], initial=0.0))
    power = angle @ angle
    other = integral @ integral
    product = float(angle @ integral)
    if min(power, other) < 1e-8 * angle.size or abs(product) < 0.9 * np.sqrt(power * other):
        return None
    return product / float(power)
