"""A static log as data of a fit: mean wrench, angle and speed of the hold, with the covariance of their errors.

With a rest phase (wind off, same angle) in the log, bias and drift go with what is fitted to the resting readings, and
only noise is left. Without one the bias stays, and its standard deviation is what the log states
(`offsets_uncertainty`), else what the drift since a tare can do, else the accuracy of the scenario (Table 4.8).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from aerodima.optimisation.identify.fit_parameters import Parameter
from aerodima.optimisation.identify.hold_mean import (
    REACTIONS,
    HoldMean,
    HoldOffset,
    StaticBalance,
    hold_mean,
    residual_warnings,
    stated_offset,
)
from aerodima.optimisation.identify.log_rig import (
    BIASES,
    FREE,
    LARGEST_SPEED,
    FitOptions,
    constant_parameters,
    named,
    rig_of,
    wind_speed,
)
from aerodima.optimisation.identify.residual_noise import correlation_time
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.conditioning import OFFSETS
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import check_signals, stated_rest
from aerodima.workbench.resources import published_table
from aerodima.workbench.sensors.rig_sensors import count_angle

COLUMNS = {c: f"force_{c[1]}_n" if c[0] == "f" else f"torque_{c[1]}_n_m" for c in REACTIONS}
ANGLE, RATE, CURRENT = "angle_rad", "angular_velocity_rad_per_s", "current_a"
LEAST_SAMPLES = 100
_LARGEST_ANGLE = math.radians(110.0)
_LARGEST_WANDER = math.radians(1.0)
CURRENT_MARGIN = 2.0
"""Logged currents beyond this many times the motor's limit are of another unit."""
_NO_CHANGE = 4.0
"""Standard deviations of noise and drift within which the readings of hold and rest are the same."""
_LARGEST_FORCE, _LARGEST_TORQUE = 1000.0, 40.0


@dataclass(frozen=True)
class StaticData:
    """One static hold.

    Attributes:
        name: of the log.
        balance: of the rig it was made on.
        angle, wind_speed: rad, m/s.
        wrench: mean reading plus offset (6), without the weight at `tare`; NaN for an axis that is missing.
        tare: angle at which the weight was taken out, rad: that of the hold after a rest; None: the weight is in it.
        covariance: of the error of the mean wrench (6 x 6); rows of missing axes are meaningless.
        present: which of the six axes are there (6).
        speed: mean of the logged rate, rad/s; zero when it was not logged.
        speed_deviation: standard deviation of its error, rad/s.
        angle_deviation: of the error of the angle (half a count of the encoder, evenly spread), rad.
        current, current_deviation: mean of the logged current and standard deviation of its error, A; NaN without.
        effective_samples: that the hold counts as.
        rest: first and last time of the rest phase, s; None without.
        facts: tail, axis, angle_deg, wind_speed_m_per_s for reports.
        offset_deviation: standard deviation of what is left of the offsets (6), in `covariance` too.
        constants: of the rig that are not exact, see `constant_parameters`.
        warnings: of the log.
    """

    name: str
    balance: StaticBalance
    angle: float
    wind_speed: float
    wrench: np.ndarray
    tare: float | None
    covariance: np.ndarray
    present: np.ndarray
    speed: float
    speed_deviation: float
    angle_deviation: float
    current: float
    current_deviation: float
    effective_samples: float
    rest: tuple[float, float] | None
    facts: Mapping[str, Any]
    offset_deviation: np.ndarray
    constants: tuple[Parameter, ...]
    warnings: tuple[str, ...]

    @property
    def scenario(self) -> RigScenario:
        """Of the rig it was made on."""
        return self.balance.scenario


def largest_reading(channel: str) -> float:
    """About twice the range of the Axia80-M20 in a reaction, N or N m: larger numbers are of another unit."""
    return _LARGEST_FORCE if channel.startswith("f") else _LARGEST_TORQUE


@cache
def accuracies() -> np.ndarray:
    """Table 4.8 for the six reactions (6), N and N m; do not change it in place."""
    return published_table("residual_weights").uncertainty_factor.to_numpy(float)[:6]


@cache
def speed_accuracy() -> float:
    """Table 4.8 for the speed, rad/s (printed as rad/s; ERRATA E19)."""
    return float(published_table("residual_weights").uncertainty_factor.iloc[6])


def static_data(log: RunLog, rest: tuple[float, float] | None = None, options: FitOptions = FREE) -> StaticData:
    """Checks a static log and takes from it what the fit needs.

    Args:
        log: of kind `static`.
        rest: first and last time of the rest phase (wind off), s; by default `rest_s` of the log's metadata, if it is
            there.
        options: rig, drift and loss.

    Raises:
        LogError: unsorted time, gap or NaN, with column and time.
        FitError: not a static log, too short, the angle is not held, numbers that must be of another unit.
        ScenarioError: the rig is wrong.
    """
    name = log.source or "static log"
    with named(name):
        return _static_data(log, rest if rest is not None else stated_rest(log), name, options)


def _static_data(log: RunLog, rest: tuple[float, float] | None, name: str, options: FitOptions) -> StaticData:
    if log.kind != "static":
        raise FitError(f"is a log of kind {log.kind!r}; a static fit needs 'static'")
    scenario = rig_of(log, "static", options)
    balance, speed = StaticBalance.of(scenario), wind_speed(log, 1e-3, LARGEST_SPEED)
    time, angle = log.time, log.signal(ANGLE)
    if len(time) < LEAST_SAMPLES:
        raise FitError(f"{len(time)} samples; a static fit needs at least {LEAST_SAMPLES}")
    check_signals(time, {ANGLE: angle})
    _check_held(angle)
    hold = np.ones(len(time), bool) if rest is None else _hold_mask(time, rest)
    columns, warnings = _readings(log, time)
    used = hold if rest is None else hold | ((time >= rest[0]) & (time <= rest[1]))
    mean = hold_mean(
        time[used],
        np.stack(list(columns.values()))[:, used],
        None if rest is None else hold[used].astype(float),
        options.drift,
        options.hold_loss,
    )
    held = float(np.mean(angle[hold]))
    log.stated(OFFSETS, len(REACTIONS))  # refused where it cannot be right, also if a rest makes it unneeded
    offset = HoldOffset(np.zeros(6), np.zeros(6), held) if rest is not None else stated_offset(log, scenario, warnings)
    channels = [i for i, channel in enumerate(REACTIONS) if channel in columns]
    wrench, variance = np.full(6, np.nan), np.zeros(6)
    wrench[channels] = mean.value + offset.added[channels]
    variance[channels] = mean.variance + np.square(offset.deviation[channels])
    warnings += residual_warnings(mean, list(columns), time[used])
    if rest is not None and balance.exposed_length(held) > 0.0 and _is_still(mean, scenario, channels, time, hold):
        warnings.append(
            f"the readings change after the rest phase {rest[0]:g} to {rest[1]:g} s by no more than noise and drift "
            f"can do, although the wind of {speed:g} m/s meets the tail: is the wind off in it?"
        )
    count = count_angle(scenario)
    rate, rate_deviation = _mean_rate(log, time, hold, count)
    current, current_deviation = _mean_current(log, hold, scenario, warnings)
    return StaticData(
        name=name,
        balance=balance,
        angle=held,
        wind_speed=speed,
        wrench=wrench,
        tare=offset.tare,
        covariance=np.diag(variance),
        present=np.isin(np.arange(6), channels),
        speed=rate,
        speed_deviation=rate_deviation,
        angle_deviation=count / math.sqrt(12.0),
        current=current,
        current_deviation=current_deviation,
        effective_samples=float(np.count_nonzero(hold) / mean.lags.max()),
        rest=rest,
        facts={
            "tail": str(log.extra["tail"]),
            "axis": str(log.extra["axis"]),
            "angle_deg": round(math.degrees(held), 3),
            "wind_speed_m_per_s": speed,
        },
        offset_deviation=offset.deviation,
        constants=_constants(log, scenario, options, offset),
        warnings=tuple(warnings),
    )


def _constants(log: RunLog, scenario: RigScenario, options: FitOptions, offset: HoldOffset) -> tuple[Parameter, ...]:
    """Of the rig; the biases of the readings among them only where there are others, so that the budget has them."""
    found = constant_parameters(log, scenario, "static", options)
    biases = {name: value for name, value in zip(BIASES, offset.deviation.tolist(), strict=True) if value > 0.0}
    return constant_parameters(log, scenario, "static", options, biases) if found and biases else found


def _is_still(mean: HoldMean, scenario: RigScenario, channels: list[int], time: np.ndarray, hold: np.ndarray) -> bool:
    """Whether no reading steps by more than noise, the drift of the sensor and the wander that is seen can do."""
    sensor = scenario.force_sensor
    between = float(time[hold].mean() - time[~hold].mean())
    drift = np.asarray(sensor.accuracies)[channels] * sensor.drift_fraction * between
    seen = np.array([check.swing for check in mean.checks])
    return bool(np.all(np.abs(mean.value) < _NO_CHANGE * np.sqrt(mean.variance + drift**2) + 2.0 * seen))


def _check_held(angle: np.ndarray) -> None:
    if np.max(np.abs(angle)) > _LARGEST_ANGLE:
        raise FitError(
            f"column {ANGLE!r} reaches {angle[np.argmax(np.abs(angle))]:g}, beyond +-{_LARGEST_ANGLE:.2f} rad; "
            "is it in degrees?"
        )
    if np.ptp(angle) > _LARGEST_WANDER:
        raise FitError(
            f"the angle moves by {math.degrees(float(np.ptp(angle))):.2f} degrees; a static log holds it "
            f"within {math.degrees(_LARGEST_WANDER):g} degree"
        )


def _hold_mask(time: np.ndarray, rest: tuple[float, float]) -> np.ndarray:
    """What comes after the rest phase."""
    resting = (time >= rest[0]) & (time <= rest[1])
    hold = time > rest[1]
    if np.count_nonzero(resting) < LEAST_SAMPLES or np.count_nonzero(hold) < LEAST_SAMPLES:
        raise FitError(
            f"{np.count_nonzero(resting)} samples in the rest phase {rest[0]:g} to {rest[1]:g} s and "
            f"{np.count_nonzero(hold)} after it; at least {LEAST_SAMPLES} of each are needed"
        )
    return hold


def _readings(log: RunLog, time: np.ndarray) -> tuple[dict[str, np.ndarray], list[str]]:
    """The axes that are there and alive; what is left out is told."""
    columns: dict[str, np.ndarray] = {}
    warnings = []
    for channel, column in COLUMNS.items():
        if column not in log.table.columns:
            warnings.append(f"{column} is missing: fitted without it")
            continue
        values = log.signal(column)
        check_signals(time, {column: values}, largest_step=np.inf)
        limit = largest_reading(channel)
        if np.max(np.abs(values)) > limit:
            raise FitError(f"column {column!r} reaches {np.max(np.abs(values)):g}, beyond {limit:g}; wrong unit?")
        if np.ptp(values) == 0.0:
            warnings.append(f"{column} is constant ({values[0]:g}), a dead channel: fitted without it")
            continue
        columns[channel] = values
    if not columns:
        raise FitError("no axis of the force sensor is left; there is nothing to fit")
    return columns, warnings


def _mean_current(log: RunLog, hold: np.ndarray, scenario: RigScenario, warnings: list[str]) -> tuple[float, float]:
    """Mean logged current of the hold and the deviation of its error, NaN without a usable one; it is not fitted."""
    if CURRENT not in log.table.columns:
        return math.nan, math.nan
    values = log.signal(CURRENT)[hold]
    mean, limit = float(np.mean(values)), CURRENT_MARGIN * scenario.maxon.current_limit
    if abs(mean) <= limit:
        lag = correlation_time(values[:8192])
        return mean, float(np.std(values)) * math.sqrt(lag / len(values))
    warnings.append(f"{CURRENT} is {mean:.4g} in the mean, beyond {limit:g} A (is it in mA?): not compared")
    return math.nan, math.nan


def _mean_rate(log: RunLog, time: np.ndarray, hold: np.ndarray, count: float) -> tuple[float, float]:
    """Mean speed of the hold and the deviation of its error: half a count at either end, over its length."""
    length = float(time[hold][-1] - time[hold][0])
    deviation = count / math.sqrt(6.0) / length
    if RATE not in log.table.columns:
        return 0.0, deviation
    rate = log.signal(RATE)
    check_signals(time, {RATE: rate}, largest_step=np.inf)
    return float(np.mean(rate[hold])), deviation
