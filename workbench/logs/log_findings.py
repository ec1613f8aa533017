"""What is odd in a log: gaps, lost samples, dead sensors, and values that betray a wrong unit.

A finding names column and time. What makes every later figure wrong (times that run back, a wrong
unit) is an error; what conditioning can deal with (a gap, NaN) or a user must judge (a constant
signal) is reported and kept.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid
from scipy.signal import detrend

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.signals import gaps_in
from aerodima.workbench.scenario.signal_table import TIME

FEW_SAMPLES = 32
"""Fewer rows than this cannot be filtered and hold no experiment."""
STEP_RANGE = (1e-5, 1.0)
"""Median time step (s) of a plausible log; beyond it the unit of the times is wrong."""
RATE_OF = {
    "angular_velocity_rad_per_s": "angle_rad",
    "tail_pitch_rate_rad_per_s": "tail_pitch_angle_rad",
    "tail_roll_rate_rad_per_s": "tail_roll_angle_rad",
    "sail_rate_rad_per_s": "sail_angle_rad",
    "imu_gyro_z_rad_per_s": "imu_yaw_rad",
}
"""Rate column to the angle that it is the derivative of (for the IMU: while the car is level)."""
_LARGEST_OF_UNIT = {
    "rad/s": 60.0,
    "A": 60.0,
    "N": 500.0,
    "N m": 100.0,
    "m/s": 60.0,
    "m/s2": 300.0,
    "rad": 2.1 * np.pi,
}
"""Largest plausible magnitudes. An angle stays within a turn, apart from `_TURNING`."""
_TURNING = ("yaw", "sail")
"""Words in the names of angles that may pass a turn."""
_LARGEST_TURNED = 100.0
"""Largest plausible angle of these, rad."""
_MEASURED = ("angle", "angular_velocity", "current", "force_", "torque_", "imu_", "tail_", "speed")


@dataclass(frozen=True)
class LogFinding:
    """Something odd: column ("" when it concerns the file), time (s; None when it is not at a
    time), and what it is.
    """

    column: str
    time: float | None
    text: str

    def __str__(self) -> str:
        """One line for a person."""
        where = ""
        if self.column:
            where = f"column {self.column!r}"
        where += "" if self.time is None else f" at {self.time:g} s"
        if where:
            return f"{where}: {self.text}"
        return self.text


def gap_findings(time: FloatArray, column: str = TIME) -> list[LogFinding]:
    """Steps longer than 1.5 median steps: the first of them, and how many follow."""
    steps = np.diff(time)
    wide = gaps_in(time)
    if not wide.size:
        return []
    step = steps[wide[0]]
    if wide.size > 1:
        further = f"; {wide.size - 1} further gap(s)"
    else:
        further = ""
    lost = f"gap of {step:.6g} s, about {round(step / np.median(steps)) - 1} samples lost"
    return [LogFinding(column, float(time[wide[0]]), lost + further)]


def nan_findings(time: FloatArray, column: str, values: FloatArray) -> list[LogFinding]:
    """How many samples are NaN or infinite, and where the first one is."""
    bad = np.flatnonzero(~np.isfinite(values))
    if not bad.size:
        return []
    return [
        LogFinding(
            column,
            float(time[bad[0]]),
            f"{bad.size} of {values.size} samples are not numbers, the first here",
        )
    ]


def table_findings(table: pd.DataFrame, kind: str = "") -> list[LogFinding]:
    """Gaps, NaN, too few rows and constant measurements of a table whose times are sorted; `kind`
    of the log.
    """
    time = table[TIME].to_numpy(dtype=np.float64)
    found = gap_findings(time)
    if time.size < FEW_SAMPLES:
        found.append(
            LogFinding(
                TIME, None, f"only {time.size} samples; no filter and no fit can work on them"
            )
        )
    for name in table.columns:
        values = table[name].to_numpy(dtype=np.float64)
        found += nan_findings(time, name, values)
        finite = values[np.isfinite(values)]
        # An encoder counts whole steps: a held angle is constant.
        held = kind == "static" and name.startswith("ang")
        changes = name.startswith(_MEASURED) and "_command_" not in name and not held
        if changes and finite.size > 1 and np.ptp(finite) == 0.0:
            found.append(
                LogFinding(
                    name, None, f"constant, {finite[0]:g} in every row: is the sensor connected?"
                )
            )
    return found


def refuse_implausible(
    table: pd.DataFrame, units: Mapping[str, str], largest: Mapping[str, float | None], where: str
) -> None:
    """Raise LogError for values that betray a wrong unit.

    Args:
        table: SI units.
        units: SI unit of each column.
        largest: largest plausible magnitude per column where the mapping states one.
        where: file named in the message.
    """
    time = table[TIME].to_numpy(dtype=np.float64)
    step = float(np.median(np.diff(time)))
    if not STEP_RANGE[0] <= step <= STEP_RANGE[1]:
        raise LogError(
            f"{where}: column {TIME!r}: steps of {step:.3g} s; {STEP_RANGE[0]:g} to "
            f"{STEP_RANGE[1]:g} s is plausible. Is the unit of the times right?"
        )
    for name in table.columns:
        turns = units.get(name) == "rad" and any(word in name for word in _TURNING)
        limit = largest.get(name) or (
            _LARGEST_TURNED if turns else _LARGEST_OF_UNIT.get(units.get(name, ""))
        )
        values = np.abs(table[name].to_numpy(dtype=np.float64))
        if limit is None or not np.any(values > limit):
            continue
        at = int(np.flatnonzero(values > limit)[0])
        raise LogError(
            f"{where}: column {name!r}: {table[name].iloc[at]:.6g} {units[name]} at {time[at]:g} "
            f"s; up to {limit:.4g} is plausible. Is the unit in the mapping right? If the value is "
            "real, state `largest` there"
        )


def refuse_inconsistent_rates(table: pd.DataFrame, where: str) -> None:
    """Raise LogError when a rate is plainly not the derivative of its angle: other unit, or other
    sign.

    Compared are the angle and the integral of the rate, without their straight lines (bias of a
    gyro). Signals that have little to do with each other (noise, a car that rolls) are left alone.
    """
    time = table[TIME].to_numpy(dtype=np.float64)
    for rate, angle in RATE_OF.items():
        if rate not in table.columns or angle not in table.columns:
            continue
        ratio = _rate_ratio(
            time, table[angle].to_numpy(dtype=np.float64), table[rate].to_numpy(dtype=np.float64)
        )
        if ratio is None or 0.6 <= ratio <= 1.6:
            continue
        raise LogError(
            f"{where}: column {rate!r}: {ratio:.3g} times the derivative of {angle!r}; one of the "
            "two has a wrong "
            "unit or sign (`check_rates: false` in the mapping turns this check off)"
        )


def _rate_ratio(time: FloatArray, angle: FloatArray, rate: FloatArray) -> float | None:
    """Factor between a rate and the derivative of its angle; None where they do not tell."""
    good = np.isfinite(angle) & np.isfinite(rate)
    if np.count_nonzero(good) < FEW_SAMPLES:
        return None
    time = time[good]
    angle = detrend(np.unwrap(angle[good]))
    integral = detrend(cumulative_trapezoid(rate[good], time, initial=0.0))
    power = float(angle @ angle)
    other = float(integral @ integral)
    tiny = 1e-8 * time.size
    if power < tiny or other < tiny or abs(float(angle @ integral)) < 0.9 * np.sqrt(power * other):
        return None
    return float(angle @ integral) / power
