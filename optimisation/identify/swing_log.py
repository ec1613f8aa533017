"""A swing log as data of a fit: the angle after the release, on the grid of the rollout, and the
motor's torque.
"""

import math
from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.least_squares import Parameter
from aerodima.optimisation.identify.log_rig import CURRENT, checked_angle, is_ours, rig_of
from aerodima.optimisation.identify.rig_constants import constant_parameters
from aerodima.optimisation.identify.static_log import CURRENT_MARGIN
from aerodima.workbench.car.car_sensors import POSITION_BITS
from aerodima.workbench.core.array_types import ArrayPair, FloatArray, IntArray, Texts
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Facts, Json
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import check_signals, earlier_shift, naming, stated_rest
from aerodima.workbench.scenario.rig_scenario import RigScenario

CURRENT_SAMPLING = "current_sampling"
"""Key in a log's `extra`: whether a sample of the current is its value then or its mean since the
sample before."""
MAX_STEP = 0.004
"""Approximate step of the rollouts, s; samples that are further apart are all used."""
MAX_LENGTH = 20.0
"""Time after the release over which a swing is fitted, s."""
MIN_SAMPLES = 50
"""Smallest number of samples of a swing that are fitted."""
_COUNTS_MOVED = 20
"""Number of steps of the angle's reading beyond which the tail has moved."""
_DWELL = 0.1
"""Time in which a reading that is at rest, or nearly so, moves no further than `_DWELL_STEPS`, s;
chosen on simulated swings."""
_DWELL_STEPS = 2.5
"""Largest motion of such a reading, in its steps."""
_DRIVEN = 5.0
"""Ratio of a current's root mean square to its noise above which it drives the swing."""
_MIN_NOISE = 1e-3
"""Smallest noise of a logged current, A."""
_WHOLE = 0.01
"""Distance from whole steps within which readings are counts: a log may have been through degrees
and text."""
_MAX_SAMPLING = 0.05
"""Largest distance of samples, s; those further apart show no swing of about a second."""


@dataclass(frozen=True)
class LoggedCurrent:
    """Current of a log.

    Attributes:
        time: times of the samples (n), s.
        value: samples of the current (n), A.
        means: whether a sample is the mean since the one before; else it is the value at its time,
            smooth between the samples (Akima).
        ends: times between which the steps of a rollout lie (m), s.
    """

    time: np.ndarray
    value: FloatArray
    means: bool
    ends: FloatArray

    def mean(self, delay: float = 0.0) -> FloatArray:
        """Average the current over each step (m - 1), A; a sample that comes late by `delay` (s)
        stands for an earlier time.

        Outside the log the first and last sample hold.
        """
        from scipy.interpolate import Akima1DInterpolator

        time = self.time
        current = self.value
        ends = self.ends + delay
        if self.means:
            integral = np.concatenate([[0.0], np.cumsum(current[1:] * np.diff(time))])
            inside = np.interp(ends, time, integral)
        else:
            charge = Akima1DInterpolator(time, current).antiderivative()
            inside = charge(np.clip(ends, time[0], time[-1]))
        before = np.minimum(ends - time[0], 0.0) * current[0]
        after = np.maximum(ends - time[-1], 0.0) * current[-1]
        return np.diff(inside + before + after) / np.diff(ends)

    def ramp(self, delay: float = 0.0) -> FloatArray:
        """Compute the change over each step (m - 1), A; zero where samples are means."""
        if self.means:
            return np.zeros(len(self.ends) - 1)
        return np.diff(np.interp(self.ends + delay, self.time, self.value))


def motor_torque(
    scenario: RigScenario,
    current: LoggedCurrent | None,
    steps: int,
    bias: float = 0.0,
    delay: float = 0.0,
) -> ArrayPair:
    """Compute the mean torque of the Maxon during each step and its change over the step (steps
    each), N m; zero without current.

    Args:
        scenario: rig of the motor.
        current: logged current; None for a free swing.
        steps: number of steps of the rollout.
        bias: bias of the logged current, A.
        delay: delay of the logged current, s.
    """
    if current is None:
        return np.zeros(steps), np.zeros(steps)
    torque = -scenario.maxon.torque_constant
    return torque * (current.mean(delay) - bias), torque * current.ramp(delay)


@dataclass(frozen=True)
class SwingData:
    """A swing from its release on.

    Attributes:
        name: name of the log.
        scenario: scenario of the rig, with its published coefficients.
        time: time since the release (n), s, evenly spaced.
        angle: readings of the tail's angle (n), rad.
        motor: mean torque of the motor during each step (n - 1), N m, from the logged current.
        ramp: change of that torque over the step (n - 1), N m; zero where samples of the current
            are means.
        motor_deviation: standard deviation of the error of `motor` from the noise of the current,
            N m; zero for a free swing.
        rounding: step of the readings of the angle, rad; zero when they are no plain counts
            (filtered, resampled).
        start_rate: estimate of the rate at the first sample, rad/s.
        current: logged current of a driven swing; None for a free one.
        constants: constants of the rig that are not exact, see `constant_parameters`.
        facts: tail, axis, wind_speed_m_per_s.
        warnings: warnings about the log.
    """

    name: str
    scenario: RigScenario
    time: np.ndarray
    angle: FloatArray
    motor: FloatArray
    ramp: FloatArray
    motor_deviation: float
    rounding: float
    start_rate: float
    current: LoggedCurrent | None
    constants: tuple[Parameter, ...]
    facts: Facts
    warnings: Texts

    @property
    def step(self) -> float:
        """Step of the grid, s."""
        return float(self.time[1] - self.time[0])


def swing_data(log: RunLog, kind: str, options: FitOptions = FREE) -> SwingData:
    """Checks a swing log and takes from it what the fits need.

    Args:
        log: log of a swing.
        kind: `swing`, `bar_swing` or `robot_swing`; the log must have this kind.
        options: options of the fit, of which the rig and its constants are used.

    Raises:
        LogError: unsorted time, gap or NaN, with column and time.
        FitError: another kind of log, no motion, too short, or angles that must be degrees.
    """
    name = log.source or kind
    with naming(name):
        return _swing_data(log, kind, name, options)


def _swing_data(log: RunLog, kind: str, name: str, options: FitOptions) -> SwingData:
    time, angle = checked_angle(log, kind, MIN_SAMPLES)
    scenario = rig_of(log, kind, options)
    sampling = float(np.median(np.diff(time)))
    if sampling > _MAX_SAMPLING:
        raise FitError(
            f"the samples stand {sampling:g} s apart, a swing needs at most {_MAX_SAMPLING:g} "
            "s; is the time in ms?"
        )
    first = _release(time, angle, scenario, log)
    stride = max(1, round(MAX_STEP / sampling))
    last = int(np.searchsorted(time, time[first] + MAX_LENGTH, side="right"))
    picked = np.arange(first, last, stride)
    if len(picked) < MIN_SAMPLES:
        raise FitError(
            f"only {len(picked)} samples of the motion; at least {MIN_SAMPLES} are needed"
        )
    step = reading_step(scenario)
    readings = angle[picked]
    if np.ptp(readings) <= _COUNTS_MOVED * step:
        raise FitError(
            f"the angle stays at {angle[first]:.4f} rad after the release; there is no swing in it"
        )
    rounding = 0.0
    if _is_rounded(readings, step):
        rounding = step
        picked = picked[: _end_of_motion(readings, rounding, stride * sampling)]
        readings = angle[picked]
    count = len(picked)
    current, warnings = _current(log, scenario, picked)
    motor, ramp = motor_torque(scenario, current, count - 1)
    t = time[picked] - time[picked[0]]
    early = slice(0, 8)
    rate = float(np.polyfit(t[early], readings[early], 2)[1])
    experiment = scenario.experiment
    facts: Json = {"wind_speed_m_per_s": experiment.wind_speed}
    if kind == "swing":
        facts = {"tail": str(experiment.tail), "axis": experiment.axis, **facts}
    noise = 0.0
    if np.any(motor):
        maxon = scenario.maxon
        noise = maxon.torque_constant * maxon.current_noise / math.sqrt(stride)
    grid = np.arange(count) * float(np.mean(np.diff(t)))
    return SwingData(
        name=name,
        scenario=scenario,
        time=grid,
        angle=readings,
        motor=motor,
        ramp=ramp,
        motor_deviation=noise,
        rounding=rounding,
        start_rate=rate,
        current=current,
        constants=constant_parameters(log, scenario, kind, options),
        facts=facts,
        warnings=tuple(warnings),
    )


def _release(time: FloatArray, angle: FloatArray, scenario: RigScenario, log: RunLog) -> int:
    """Find the row of the release: the end of the rest that the metadata or the scenario state,
    else the first motion.
    """
    stated = stated_rest(log)
    if stated is None and "rest" in log.scenario.get("experiment", {}):
        stated = (0.0, scenario.experiment.rest - earlier_shift(log))
    if stated is not None:
        _, end = stated
        last = time[-1]
        if end >= last:
            raise FitError(
                f"the rest ends at {end:g} s, but the log at {last:g} s; there is no swing in it"
            )
        return int(np.searchsorted(time, end - 1e-9))
    moved = np.abs(angle - angle[0]) > _COUNTS_MOVED * reading_step(scenario)
    return int(np.argmax(moved))


def reading_step(scenario: RigScenario) -> float:
    """Return the step of the logged angle, rad: a count of the encoder, or of the position in a
    reply of the AK70-10.
    """
    if scenario.is_robot:
        return 2.0 * scenario.robot_motor.position_range / (2**POSITION_BITS - 1)
    return scenario.count_angle


def _is_rounded(angle: FloatArray, step: float) -> bool:
    """Tells whether the readings differ by whole steps."""
    steps = (angle - angle[0]) / step
    return bool(np.all(np.abs(steps - np.round(steps)) < _WHOLE))


def _end_of_motion(angle: FloatArray, step: float, sampling: float) -> int:
    """Count the samples until the reading changes by fewer than three steps in a tenth of a second.

    At rest a reading repeats one rounding error for as long as the log goes on, and on the way
    there it dwells on the later side of each step: errors that do not average out, in samples that
    would count as many.
    """
    window = max(round(_DWELL / sampling), 1)
    moving = np.flatnonzero(np.abs(angle[window:] - angle[:-window]) > _DWELL_STEPS * step)
    end = len(angle)
    if moving.size:
        end = int(moving[-1]) + window + 1
    return max(end, MIN_SAMPLES)


def _current(
    log: RunLog, scenario: RigScenario, picked: IntArray
) -> tuple[LoggedCurrent | None, list[str]]:
    """Read the current of a driven swing, None for a free one, whose logged current is noise; also
    return warnings.
    """
    if scenario.is_robot:
        return None, []
    if CURRENT not in log.table.columns:
        return None, ["no current in the log: taken as a free swing"]
    current = log.signal(CURRENT)
    check_signals(log.time, {CURRENT: current}, largest_step=np.inf)
    limit = CURRENT_MARGIN * scenario.maxon.current_limit
    largest = np.max(np.abs(current))
    if largest > limit:
        raise FitError(f"column {CURRENT!r} reaches {largest:g}, beyond {limit:g} A; is it in mA?")
    sampling = log.extra.get(CURRENT_SAMPLING, "mean" if is_ours(log) else "instantaneous")
    if sampling not in ("mean", "instantaneous"):
        raise FitError(
            f"metadata {CURRENT_SAMPLING!r} is {sampling!r}; allowed: mean, instantaneous"
        )
    logged = LoggedCurrent(log.time, current, sampling == "mean", log.time[picked])
    rms = np.sqrt(np.mean(np.square(logged.mean())))
    if rms < _DRIVEN * max(scenario.maxon.current_noise, _MIN_NOISE):
        return None, []
    return logged, []
