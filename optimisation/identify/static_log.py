"""A static log as data of a fit: mean wrench, angle and speed of the hold, with the covariance of
their errors.

With a rest phase (wind off, same angle) in the log, a line over time (drift) and a step where the
wind begins are fitted to all samples of rest and hold together, because the hold helps to find the
drift too: the bias cancels, and only noise is left. Without one the bias stays, and its standard
deviation is the one that the log states (`offsets_uncertainty`), else the possible drift since a
tare, else the accuracy of the scenario (Table 4.8).
"""

import math
from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.hold_mean import (
    MAX_CORRELATED,
    HoldMean,
    hold_mean,
    residual_warnings,
)
from aerodima.optimisation.identify.least_squares import Parameter
from aerodima.optimisation.identify.log_rig import (
    CURRENT,
    MAX_ANGLE,
    MAX_WIND_SPEED,
    checked_angle,
    rig_of,
    stated_number,
)
from aerodima.optimisation.identify.noise import correlation_time
from aerodima.optimisation.identify.rig_constants import BIASES, constant_parameters
from aerodima.workbench.core.array_types import FloatArray, NamedArrays, Pair, Texts
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Facts
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import Interval, check_signals, naming, stated_rest
from aerodima.workbench.scenario.rig_scenario import RigScenario

REACTIONS = ("fx", "fy", "fz", "tx", "ty", "tz")
COLUMNS = {c: f"force_{c[1]}_n" if c[0] == "f" else f"torque_{c[1]}_n_m" for c in REACTIONS}
RATE = "angular_velocity_rad_per_s"
OFFSETS = "offsets_to_add"
"""Key in a log's `extra`: readings at which the sensor was zeroed, N and N m; zeros once they were
added."""
OFFSETS_UNCERTAINTY = "offsets_uncertainty"
"""Key in a log's `extra`: standard deviations of the remaining offsets of the readings (6), N and
N m."""
TARED = "tared_angle_rad"
"""Key in a log's `extra`: angle at which the sensor was zeroed without wind just before, rad."""
MIN_SAMPLES = 100
"""Smallest number of samples of a hold, and of a rest."""
_MAX_WANDER = math.radians(1.0)
"""Largest change of the angle within a hold, rad."""
CURRENT_MARGIN = 2.0
"""Multiple of the motor's limit beyond which a logged current is in another unit."""
_UNKNOWN_OFFSET = (
    "no rest phase: bias and drift stay in the readings; the sensor's accuracy is taken as their "
    f"standard deviation (state {OFFSETS_UNCERTAINTY} or {TARED} in the log if it was tared or "
    "calibrated)"
)
"""Warning of a log that does not say how well its offsets are known."""
_NO_CHANGE = 4.0
"""Number of standard deviations of noise and drift within which hold and rest read the same."""
_MAX_FORCE = 1000.0
"""Largest force reading, N, about twice the range of the Axia80-M20; larger ones are in another
unit."""
_MAX_TORQUE = 40.0
"""Largest torque reading, N m, about twice the range of the Axia80-M20."""


@dataclass(frozen=True)
class StaticData:
    """A static hold.

    Attributes:
        name: name of the log.
        scenario: scenario of the rig that the log was made on.
        angle: mean angle of the hold, rad.
        wind_speed: wind speed that the log states, m/s.
        wrench: mean reading plus offset (6), N and N m, without the weight at `tare`; NaN for an
            axis that is missing.
        tare: angle at which the weight was taken out of the readings, rad, which is that of the
            hold after a rest; None when the weight is in them.
        covariance: covariance of the error of the mean wrench (6 x 6); rows of missing axes are
            meaningless.
        present: flags of the axes that are there (6).
        speed: mean of the logged rate, rad/s; zero when it was not logged.
        speed_deviation: standard deviation of the error of `speed`, rad/s.
        current: mean of the logged current, A; NaN without one.
        current_deviation: standard deviation of the error of `current`, A; NaN without one.
        effective_samples: number of independent samples that the hold counts as.
        facts: tail, axis, angle_deg, wind_speed_m_per_s for reports.
        offset_deviation: standard deviation of the offsets that are left (6); it is in `covariance`
            too.
        constants: constants of the rig that are not exact, see `constant_parameters`.
        still: whether the readings change after a rest phase by no more than noise and drift can
            do.
        warnings: warnings about the log.
    """

    name: str
    scenario: RigScenario
    angle: float
    wind_speed: float
    wrench: FloatArray
    tare: float | None
    covariance: FloatArray
    present: np.ndarray
    speed: float
    speed_deviation: float
    current: float
    current_deviation: float
    effective_samples: float
    facts: Facts
    offset_deviation: FloatArray
    constants: tuple[Parameter, ...]
    still: bool
    warnings: Texts


def static_data(
    log: RunLog, rest: Interval | None = None, options: FitOptions = FREE
) -> StaticData:
    """Checks a static log and takes from it what the fit needs.

    Args:
        log: log of kind `static`.
        rest: first and last time of the rest phase (wind off), s; by default `rest_s` of the log's
            metadata, if it is there.
        options: options of the fit: rig, its constants, loss of the samples.

    Raises:
        LogError: unsorted time, gap or NaN, with column and time.
        FitError: not a static log, too short, an angle that is not held, or numbers that must be in
            another unit.
        ScenarioError: the rig is wrong.
    """
    name = log.source or "static log"
    with naming(name):
        return _static_data(log, rest if rest is not None else stated_rest(log), name, options)


def _static_data(log: RunLog, rest: Interval | None, name: str, options: FitOptions) -> StaticData:
    time, angle = checked_angle(log, "static", MIN_SAMPLES)
    scenario = rig_of(log, "static", options)
    speed = stated_number(log, "wind_speed_m_per_s", 1e-3, MAX_WIND_SPEED, "m/s")
    _require_held(angle)
    hold = _hold_mask(time, rest)
    held = float(np.mean(angle[hold]))
    readings, warnings = _readings(log, time)
    # An offset that cannot be right is refused, even if a rest makes it needless.
    log.stated(OFFSETS, len(REACTIONS))
    if rest is None:
        used = hold
        step = None
        offset = _stated_offset(log, scenario)
    else:
        used = hold | ((time >= rest[0]) & (time <= rest[1]))
        step = hold[used].astype(float)
        offset = Offset(np.zeros(6), np.zeros(6), held)
    warnings += offset.warnings
    mean = hold_mean(time[used], np.stack(list(readings.values()))[:, used], step, options.loss)
    warnings += residual_warnings(mean, list(readings), time[used])
    channels = [i for i, channel in enumerate(REACTIONS) if channel in readings]
    wrench = np.full(6, np.nan)
    variance = np.zeros(6)
    wrench[channels] = mean.value + offset.added[channels]
    variance[channels] = mean.variance + np.square(offset.deviation[channels])
    rate, rate_deviation = _mean_rate(log, time, hold, scenario.count_angle)
    current, current_deviation = _mean_current(log, hold, scenario, warnings)
    extra = log.extra
    biases = dict(zip(BIASES, offset.deviation.tolist(), strict=True))
    return StaticData(
        name=name,
        scenario=scenario,
        angle=held,
        wind_speed=speed,
        wrench=wrench,
        tare=offset.tare,
        covariance=np.diag(variance),
        present=np.isin(np.arange(6), channels),
        speed=rate,
        speed_deviation=rate_deviation,
        current=current,
        current_deviation=current_deviation,
        effective_samples=float(np.count_nonzero(hold) / mean.lags.max()),
        facts={
            "tail": str(extra["tail"]),
            "axis": str(extra["axis"]),
            "angle_deg": round(math.degrees(held), 3),
            "wind_speed_m_per_s": speed,
        },
        offset_deviation=offset.deviation,
        constants=constant_parameters(log, scenario, "static", options, biases),
        still=rest is not None and _is_still(mean, scenario, channels, time, hold),
        warnings=tuple(warnings),
    )


def _require_held(angle: FloatArray) -> None:
    moved = float(np.ptp(angle))
    if moved > _MAX_WANDER:
        raise FitError(
            f"the angle moves by {math.degrees(moved):.2f} degrees; a static log holds it within "
            f"{math.degrees(_MAX_WANDER):g} degree"
        )


def _hold_mask(time: FloatArray, rest: Interval | None) -> np.ndarray:
    """Flag the samples of the hold (n): all of them, or those after the rest phase."""
    if rest is None:
        return np.ones(len(time), bool)
    begin, end = rest
    resting = np.count_nonzero((time >= begin) & (time <= end))
    hold = time > end
    holding = np.count_nonzero(hold)
    if min(resting, holding) < MIN_SAMPLES:
        raise FitError(
            f"{resting} samples in the rest phase {begin:g} to {end:g} s and {holding} after it; "
            f"at least {MIN_SAMPLES} of each are needed"
        )
    return hold


def _readings(log: RunLog, time: FloatArray) -> tuple[NamedArrays, list[str]]:
    """Read the axes that are there and alive; a warning names each axis that is left out."""
    columns: NamedArrays = {}
    warnings = []
    for channel, column in COLUMNS.items():
        if column not in log.table.columns:
            warnings.append(f"{column} is missing: fitted without it")
            continue
        values = log.signal(column)
        check_signals(time, {column: values}, largest_step=np.inf)
        limit = _MAX_FORCE if channel.startswith("f") else _MAX_TORQUE
        largest = np.max(np.abs(values))
        if largest > limit:
            raise FitError(f"column {column!r} reaches {largest:g}, beyond {limit:g}; wrong unit?")
        if np.ptp(values) == 0.0:
            warnings.append(
                f"{column} is constant ({values[0]:g}), a dead channel: fitted without it"
            )
            continue
        columns[channel] = values
    if not columns:
        raise FitError("no axis of the force sensor is left; there is nothing to fit")
    return columns, warnings


def _mean_current(
    log: RunLog, hold: np.ndarray, scenario: RigScenario, warnings: list[str]
) -> Pair:
    """Return the mean logged current of the hold and the deviation of its error, NaN without a
    usable current; it is not fitted.
    """
    unusable = (math.nan, math.nan)
    if CURRENT not in log.table.columns:
        return unusable
    values = log.signal(CURRENT)[hold]
    mean = float(np.mean(values))
    limit = CURRENT_MARGIN * scenario.maxon.current_limit
    if abs(mean) <= limit:
        lag = correlation_time(values[:MAX_CORRELATED])
        return mean, float(np.std(values)) * math.sqrt(lag / len(values))
    reason = f"is {mean:.4g} in the mean, beyond {limit:g} A (is it in mA?)"
    if not math.isfinite(mean):
        reason = "has samples that are no finite numbers"
    warnings.append(f"{CURRENT} {reason}: not compared")
    return unusable


def _mean_rate(log: RunLog, time: FloatArray, hold: np.ndarray, count: float) -> Pair:
    """Return the mean speed of the hold and the deviation of its error, which is up to half a count
    at either end, over the duration of the hold.
    """
    times = time[hold]
    deviation = count / math.sqrt(6.0) / float(times[-1] - times[0])
    if RATE not in log.table.columns:
        return 0.0, deviation
    rate = log.signal(RATE)
    check_signals(time, {RATE: rate}, largest_step=np.inf)
    return float(np.mean(rate[hold])), deviation


@dataclass(frozen=True)
class Offset:
    """Offset that is added to the readings of a hold.

    Attributes:
        added: offset that is added to the readings (6), N and N m.
        deviation: standard deviation of the offset that is then left (6), N and N m.
        tare: angle of the tare, see `StaticData.tare`.
        warnings: warning of a deviation that is not known.
    """

    added: FloatArray
    deviation: FloatArray
    tare: float | None
    warnings: Texts = ()


def _stated_offset(log: RunLog, scenario: RigScenario) -> Offset:
    """Look up the offset of a hold without rest: the one that the log states, else that of the
    scenario.

    Raises:
        LogError, FitError: the metadata make no sense.
    """
    sensor = scenario.force_sensor
    deviation = np.asarray(sensor.accuracies)
    tared = None
    if log.extra.get(TARED) is not None:
        tared = stated_number(log, TARED, -MAX_ANGLE, MAX_ANGLE, "rad")
    stated = log.stated(OFFSETS_UNCERTAINTY, len(REACTIONS))
    warnings: Texts = ()
    if stated is not None:
        if min(stated) < 0.0:
            raise FitError(
                f"metadata {OFFSETS_UNCERTAINTY!r} is {list(stated)}; six numbers of at least 0 "
                "are needed"
            )
        deviation = np.asarray(stated)
    elif tared is not None:
        deviation = deviation * sensor.drift_fraction * float(log.time[-1] - min(log.time[0], 0.0))
    else:
        warnings = (_UNKNOWN_OFFSET,)
    if tared is not None:
        return Offset(np.zeros(6), deviation, tared, warnings)
    added = log.stated(OFFSETS, len(REACTIONS)) or scenario.cheetah_tail.offsets
    return Offset(np.asarray(added, float), deviation, None, warnings)


def _is_still(
    mean: HoldMean, scenario: RigScenario, channels: list[int], time: FloatArray, hold: np.ndarray
) -> bool:
    """Tells whether noise, the drift of the sensor and its wander explain all steps."""
    sensor = scenario.force_sensor
    between = float(time[hold].mean() - time[~hold].mean())
    drift = np.asarray(sensor.accuracies)[channels] * sensor.drift_fraction * between
    wander = np.array([check.swing for check in mean.checks])
    reach = _NO_CHANGE * np.sqrt(mean.variance + drift**2) + 2.0 * wander
    return bool(np.all(np.abs(mean.value) < reach))
