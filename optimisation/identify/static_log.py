"""A static log as data of a fit: mean wrench, angle and speed of the hold, with the covariance of their errors.

With a rest phase (wind off, same angle) in the log, bias and drift go with a line through the resting readings, and
only noise is left. Without one the bias stays, and Table 4.8 says how large it is: its standard deviation per log.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from optimisation.errors import FitError
from optimisation.identify.published_tables import published
from optimisation.identify.static_balance import REACTIONS, StaticBalance
from optimisation.uncertainty import correlation_time
from workbench.errors import LogError
from workbench.logs.conditioning import OFFSETS
from workbench.logs.resting import stated_rest
from workbench.logs.schema import RunLog
from workbench.rig_scenario import RigScenario, rig_scenario_from_dict
from workbench.signals import check_signals

COLUMNS = dict(
    zip(
        REACTIONS,
        ("force_x_n", "force_y_n", "force_z_n", "torque_x_n_m", "torque_y_n_m", "torque_z_n_m"),
        strict=True,
    )
)
ANGLE, RATE, CURRENT = "angle_rad", "angular_velocity_rad_per_s", "current_a"
LEAST_SAMPLES = 100
_MOST_CORRELATED = 8192
"""Samples that the correlation time of the noise is taken from."""
_LARGEST_ANGLE = math.radians(110.0)
_LARGEST_WANDER = math.radians(1.0)
_LARGEST_SPEED = 60.0
CURRENT_MARGIN = 2.0
"""Logged currents beyond this many times the motor's limit are of another unit."""
_NO_CHANGE = 4.0
"""Standard deviations within which the readings of hold and rest are the same."""
_LARGEST_FORCE, _LARGEST_TORQUE = 1000.0, 40.0


@dataclass(frozen=True)
class StaticData:
    """One static hold.

    Attributes:
        name: of the log.
        balance: of the rig it was made on.
        angle, wind_speed: rad, m/s.
        wrench: mean reading plus offset (6); NaN for an axis that is missing.
        covariance: of the error of the mean wrench (6 x 6); rows of missing axes are meaningless.
        present: which of the six axes are there (6).
        speed: mean of the logged rate, rad/s; zero when it was not logged.
        speed_deviation: standard deviation of its error, rad/s.
        angle_deviation: of the error of the angle (half a count of the encoder, evenly spread), rad.
        current: mean of the logged current, A; NaN without.
        effective_samples: that the hold counts as.
        rest: first and last time of the rest phase, s; None without.
        facts: tail, axis, angle_deg, wind_speed_m_per_s for reports.
        warnings: of the log.
    """

    name: str
    balance: StaticBalance
    angle: float
    wind_speed: float
    wrench: np.ndarray
    covariance: np.ndarray
    present: np.ndarray
    speed: float
    speed_deviation: float
    angle_deviation: float
    current: float
    effective_samples: float
    rest: tuple[float, float] | None
    facts: Mapping[str, Any]
    warnings: tuple[str, ...]


def largest_reading(channel: str) -> float:
    """About twice the range of the Axia80-M20 in a reaction, N or N m: larger numbers are of another unit."""
    return _LARGEST_FORCE if channel.startswith("f") else _LARGEST_TORQUE


@cache
def accuracies() -> np.ndarray:
    """Table 4.8 for the six reactions (6), N and N m; do not change it in place."""
    return published("residual_weights").uncertainty_factor.to_numpy(float)[:6]


@cache
def speed_accuracy() -> float:
    """Table 4.8 for the speed, rad/s (printed as rad/s; ERRATA E19)."""
    return float(published("residual_weights").uncertainty_factor.iloc[6])


@lru_cache(maxsize=64)
def _balance(key: str) -> tuple[RigScenario, StaticBalance]:
    scenario = rig_scenario_from_dict(json.loads(key))
    return scenario, StaticBalance.of(scenario)


def rig_of(log: RunLog) -> tuple[RigScenario, StaticBalance]:
    """The rig that a log was made on: its scenario's masses, jet and motor, or those of `models/` for a foreign log.

    Raises:
        FitError: the log does not say which tail was on the rig, or how fast the wind was.
    """
    extra = log.extra
    for key, allowed in (("tail", ("1", "2", "3")), ("axis", ("major", "minor"))):
        if str(extra.get(key)) not in allowed:
            raise FitError(
                f"{log.source or 'log'}: metadata {key!r} is {extra.get(key)!r}; allowed: {', '.join(allowed)}"
            )
    sections = (
        "mount",
        "bar",
        "tail_1",
        "tail_2",
        "tail_3",
        "maxon",
        "encoder",
        "friction",
        "force_sensor",
        "environment",
    )
    kept = {name: log.scenario[name] for name in sections if name in log.scenario}
    if "tunnel" in log.scenario:
        kept["tunnel"] = {key: value for key, value in log.scenario["tunnel"].items() if key != "psi3"}
    kept["experiment"] = {"kind": "static", "tail": int(extra["tail"]), "axis": str(extra["axis"])}
    return _balance(json.dumps(kept, sort_keys=True))


def static_data(log: RunLog, rest: tuple[float, float] | None = None) -> StaticData:
    """Checks a static log and takes from it what the fit needs.

    Args:
        log: of kind `static`.
        rest: first and last time of the rest phase (wind off), s; by default `rest_s` of the log's metadata, if it is
            there.

    Raises:
        LogError: unsorted time, gap or NaN, with column and time.
        FitError: not a static log, too short, the angle is not held, numbers that must be of another unit.
    """
    name = log.source or "static log"
    try:
        return _static_data(log, rest if rest is not None else stated_rest(log), name)
    except LogError as error:
        raise LogError(f"{name}: {str(error).removeprefix(f'{name}: ')}") from error


def _static_data(log: RunLog, rest: tuple[float, float] | None, name: str) -> StaticData:
    if log.kind != "static":
        raise FitError(f"{name}: is a log of kind {log.kind!r}; a static fit needs 'static'")
    scenario, balance = rig_of(log)
    speed = _wind_speed(log, name)
    time, angle = log.time, log.signal(ANGLE)
    if len(time) < LEAST_SAMPLES:
        raise FitError(f"{name}: {len(time)} samples; a static fit needs at least {LEAST_SAMPLES}")
    check_signals(time, {ANGLE: angle})
    _check_held(angle, name)
    hold = np.ones(len(time), bool) if rest is None else _hold_mask(time, rest, name)
    columns, warnings = _readings(log, time, name)
    offsets = np.asarray(log.stated(OFFSETS, len(REACTIONS)) or scenario.cheetah_tail.offsets, float)
    if rest is None:
        warnings.append(
            "no rest phase: bias and drift stay in the readings; Table 4.8 is taken as their standard deviation"
        )
    wrench, variance, samples = _mean_wrench(time, columns, hold, rest, balance, float(np.mean(angle)), offsets)
    present = np.array([channel in columns for channel in REACTIONS])
    if rest is not None and balance.exposed_length(float(np.mean(angle))) > 0.0:
        step = (wrench - balance.hanging(float(np.mean(angle)))[0])[present]
        if np.all(np.abs(step) < _NO_CHANGE * np.sqrt(variance[present])):
            warnings.append(
                f"the readings do not change after the rest phase {rest[0]:g} to {rest[1]:g} s, although the wind of "
                f"{speed:g} m/s meets the tail: is the wind off in it?"
            )
    count = 2.0 * math.pi / (scenario.encoder.pulses * scenario.encoder.quadrature * scenario.maxon.gear_ratio)
    rate, rate_deviation = _mean_rate(log, time, hold, count)
    return StaticData(
        name=name,
        balance=balance,
        angle=float(np.mean(angle[hold])),
        wind_speed=speed,
        wrench=wrench,
        covariance=np.diag(variance),
        present=present,
        speed=rate,
        speed_deviation=rate_deviation,
        angle_deviation=count / math.sqrt(12.0),
        current=_mean_current(log, hold, scenario, warnings),
        effective_samples=samples,
        rest=rest,
        facts={
            "tail": str(log.extra["tail"]),
            "axis": str(log.extra["axis"]),
            "angle_deg": round(math.degrees(float(np.mean(angle[hold]))), 3),
            "wind_speed_m_per_s": speed,
        },
        warnings=tuple(warnings),
    )


def _wind_speed(log: RunLog, name: str) -> float:
    value = log.extra.get("wind_speed_m_per_s")
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < float(value) <= _LARGEST_SPEED:
        raise FitError(
            f"{name}: metadata 'wind_speed_m_per_s' is {value!r}; allowed: above 0 to {_LARGEST_SPEED:g} m/s"
        )
    return float(value)


def _check_held(angle: np.ndarray, name: str) -> None:
    if np.max(np.abs(angle)) > _LARGEST_ANGLE:
        raise FitError(
            f"{name}: column {ANGLE!r} reaches {angle[np.argmax(np.abs(angle))]:g}, beyond +-{_LARGEST_ANGLE:.2f} rad; "
            "is it in degrees?"
        )
    if np.ptp(angle) > _LARGEST_WANDER:
        raise FitError(
            f"{name}: the angle moves by {math.degrees(float(np.ptp(angle))):.2f} degrees; a static log holds it "
            f"within {math.degrees(_LARGEST_WANDER):g} degree"
        )


def _hold_mask(time: np.ndarray, rest: tuple[float, float], name: str) -> np.ndarray:
    """What comes after the rest phase."""
    resting = (time >= rest[0]) & (time <= rest[1])
    hold = time > rest[1]
    if np.count_nonzero(resting) < LEAST_SAMPLES or np.count_nonzero(hold) < LEAST_SAMPLES:
        raise FitError(
            f"{name}: {np.count_nonzero(resting)} samples in the rest phase {rest[0]:g} to {rest[1]:g} s and "
            f"{np.count_nonzero(hold)} after it; at least {LEAST_SAMPLES} of each are needed"
        )
    return hold


def _readings(log: RunLog, time: np.ndarray, name: str) -> tuple[dict[str, np.ndarray], list[str]]:
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
            raise FitError(
                f"{name}: column {column!r} reaches {np.max(np.abs(values)):g}, beyond {limit:g}; wrong unit?"
            )
        if np.ptp(values) == 0.0:
            warnings.append(f"{column} is constant ({values[0]:g}), a dead channel: fitted without it")
            continue
        columns[channel] = values
    if not columns:
        raise FitError(f"{name}: no axis of the force sensor is left; there is nothing to fit")
    return columns, warnings


def _mean_current(log: RunLog, hold: np.ndarray, scenario: RigScenario, warnings: list[str]) -> float:
    """Mean logged current of the hold, NaN without a usable one; it is shown beside the fitted one, not fitted."""
    if CURRENT not in log.table.columns:
        return math.nan
    mean, limit = float(np.mean(log.signal(CURRENT)[hold])), CURRENT_MARGIN * scenario.maxon.current_limit
    if abs(mean) <= limit:
        return mean
    warnings.append(f"{CURRENT} is {mean:.4g} in the mean, beyond {limit:g} A (is it in mA?): not compared")
    return math.nan


def _mean_rate(log: RunLog, time: np.ndarray, hold: np.ndarray, count: float) -> tuple[float, float]:
    """Mean speed of the hold and the deviation of its error: half a count at either end, over its length."""
    length = float(time[hold][-1] - time[hold][0])
    deviation = count / math.sqrt(6.0) / length
    if RATE not in log.table.columns:
        return 0.0, deviation
    rate = log.signal(RATE)
    check_signals(time, {RATE: rate}, largest_step=np.inf)
    return float(np.mean(rate[hold])), deviation


def _mean_wrench(
    time: np.ndarray,
    columns: Mapping[str, np.ndarray],
    hold: np.ndarray,
    rest: tuple[float, float] | None,
    balance: StaticBalance,
    angle: float,
    offsets: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean wrench of the hold (6), variance of its error (6), effective samples.

    A line of time, and with a rest phase a step at its end, are fitted to all of the readings: the drift of the hold
    helps to find the slope too.
    """
    channels = [i for i, channel in enumerate(REACTIONS) if channel in columns]
    values = np.stack([columns[REACTIONS[i]] for i in channels])
    used = hold if rest is None else hold | ((time >= rest[0]) & (time <= rest[1]))
    if not np.all(used):
        values = values[:, used]
    centred = time[used] - time[used].mean()
    basis = [np.ones_like(centred), centred] + ([] if rest is None else [hold[used].astype(float)])
    design = np.stack(basis)
    inverse = np.linalg.inv(design @ design.T)
    found = values @ design.T @ inverse
    scatter = values - found @ design
    lags = np.array([correlation_time(row[:_MOST_CORRELATED]) for row in scatter])
    samples = values.shape[1]
    noise = np.sum(np.square(scatter), axis=1) / np.maximum(samples / lags - design.shape[0], 1.0)
    wrench, variance = np.full(6, np.nan), np.zeros(6)
    if rest is None:
        wrench[channels] = found[:, 0] + offsets[channels]
        variance[channels] = noise * inverse[0, 0] + accuracies()[channels] ** 2
    else:
        wrench[channels] = found[:, 2] + balance.hanging(angle)[0][channels]
        variance[channels] = noise * inverse[2, 2]
    return wrench, variance, float(np.count_nonzero(hold) / lags.max())
