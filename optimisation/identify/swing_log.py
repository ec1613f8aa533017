"""A swing log as data of a fit: the angle after the release, on the grid of the rollout, and the motor's torque."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from optimisation.errors import FitError
from optimisation.identify.static_log import ANGLE, CURRENT, CURRENT_MARGIN
from workbench.errors import LogError
from workbench.logs.conditioning import earlier_shift
from workbench.logs.resting import stated_rest
from workbench.logs.schema import RunLog
from workbench.rig_scenario import RigScenario, rig_scenario_from_dict
from workbench.sensors.encoder import MotorReply
from workbench.sensors.rig_encoder import count_angle
from workbench.signals import check_signals

LARGEST_STEP = 0.004
"""Step of the rollouts, s."""
LEAST_SAMPLES = 50
"""Fewest samples of a swing that are fitted."""
_COUNTS_MOVED = 20
_DWELL, _DWELL_STEPS = 0.1, 2.5
"""A reading that moves no further (steps) in that time (s) is at rest or nearly so; chosen on simulated swings."""
_WHOLE = 0.01
"""Readings this near to whole steps are counts: a log may have been through degrees and text."""
_LONGEST_SAMPLING = 0.05
"""Samples further apart than this show no swing of about a second, s."""
_LARGEST_ANGLE = math.radians(110.0)
_TRUTH = ("aero", "seed", "name", "schema")


@dataclass(frozen=True)
class SwingData:
    """One swing from its release on.

    Attributes:
        name: of the log.
        scenario: of the rig, with its published coefficients.
        time: from the release (n), s, evenly spaced.
        angle: (n), rad.
        motor: mean torque of the motor during each step (n - 1), N m, from the logged current.
        motor_deviation: standard deviation of its error from the noise of the current, N m; zero for a free swing.
        rounding: step of the readings of the angle, rad; zero when they are no plain counts (filtered, resampled).
        start_rate: estimate of the rate at the first sample, rad/s.
        release: time of the first sample in the log, s.
        facts: tail, axis, wind_speed_m_per_s.
        warnings: of the log.
    """

    name: str
    scenario: RigScenario
    time: np.ndarray
    angle: np.ndarray
    motor: np.ndarray
    motor_deviation: float
    rounding: float
    start_rate: float
    release: float
    facts: Mapping[str, Any]
    warnings: tuple[str, ...]

    @property
    def step(self) -> float:
        """Of the grid, s."""
        return float(self.time[1] - self.time[0])


@lru_cache(maxsize=64)
def _scenario(key: str) -> RigScenario:
    return rig_scenario_from_dict(json.loads(key))


def scenario_of(log: RunLog, kind: str) -> RigScenario:
    """The rig that a log was made on; what a fit is to find (`aero`) is that of `models/`, not of the log."""
    content = {key: value for key, value in log.scenario.items() if key not in _TRUTH}
    experiment = dict(content.get("experiment", {}))
    experiment["kind"] = kind
    if kind == "swing":
        for key, allowed in (("tail", ("1", "2", "3")), ("axis", ("major", "minor"))):
            if str(log.extra.get(key)) not in allowed:
                raise FitError(f"metadata {key!r} is {log.extra.get(key)!r}; allowed: {', '.join(allowed)}")
        experiment |= {"tail": int(log.extra["tail"]), "axis": str(log.extra["axis"])}
    if kind == "bar_swing":
        experiment["wind_speed"] = 0.0
    else:
        speed = log.extra.get("wind_speed_m_per_s")
        if not isinstance(speed, int | float) or not 0.0 <= float(speed) <= 40.0:
            raise FitError(f"metadata 'wind_speed_m_per_s' is {speed!r}; allowed: 0 to 40 m/s")
        experiment["wind_speed"] = float(speed)
    return _scenario(json.dumps({**content, "experiment": experiment}, sort_keys=True))


def swing_data(log: RunLog, kind: str, longest: float = 20.0) -> SwingData:
    """Checks a swing log and takes from it what the fits need.

    Args:
        kind: `swing`, `bar_swing` or `robot_swing`; the log must be of it.
        longest: use at most this long after the release, s.

    Raises:
        LogError: unsorted time, gap or NaN, with column and time.
        FitError: another kind of log, no motion, too short, angles that must be degrees.
    """
    name = log.source or kind
    try:
        return _swing_data(log, kind, longest, name)
    except FitError as error:
        raise FitError(f"{name}: {error}") from error
    except LogError as error:
        raise LogError(f"{name}: {str(error).removeprefix(f'{name}: ')}") from error


def _swing_data(log: RunLog, kind: str, longest: float, name: str) -> SwingData:
    if log.kind != kind:
        raise FitError(f"is a log of kind {log.kind!r}; this fit needs {kind!r}")
    scenario = scenario_of(log, kind)
    time, angle = log.time, log.signal(ANGLE)
    if len(time) < LEAST_SAMPLES:
        raise FitError(f"{len(time)} samples; a swing needs at least {LEAST_SAMPLES}")
    check_signals(time, {ANGLE: angle})
    sampling = float(np.median(np.diff(time)))
    if sampling > _LONGEST_SAMPLING:
        raise FitError(
            f"the samples stand {sampling:g} s apart, a swing needs at most {_LONGEST_SAMPLING:g} s; is the time in ms?"
        )
    if np.max(np.abs(angle)) > _LARGEST_ANGLE:
        raise FitError(f"column {ANGLE!r} reaches {np.max(np.abs(angle)):g}, beyond 1.92 rad; is it in degrees?")
    first = _release(time, angle, scenario, log)
    stride = max(1, round(LARGEST_STEP / sampling))
    last = int(np.searchsorted(time, time[first] + longest, side="right"))
    picked = np.arange(first, last, stride)
    if len(picked) < LEAST_SAMPLES:
        raise FitError(f"only {len(picked)} samples of the motion; at least {LEAST_SAMPLES} are needed")
    if np.ptp(angle[picked]) <= _COUNTS_MOVED * reading_step(scenario):
        raise FitError(f"the angle stays at {angle[first]:.4f} rad after the release; there is no swing in it")
    rounding = reading_step(scenario) if _is_rounded(angle[picked], reading_step(scenario)) else 0.0
    if rounding:
        picked = picked[: _end_of_motion(angle[picked], rounding, stride * sampling)]
    motor, warnings = _motor(log, scenario, picked, stride)
    t = time[picked] - time[picked[0]]
    early = slice(0, 8)
    rate = float(np.polyfit(t[early], angle[picked][early], 2)[1])
    facts: dict[str, Any] = {"wind_speed_m_per_s": scenario.experiment.wind_speed}
    if kind == "swing":
        facts = {"tail": str(scenario.experiment.tail), "axis": scenario.experiment.axis, **facts}
    noise = scenario.maxon.torque_constant * scenario.maxon.current_noise / math.sqrt(stride) if np.any(motor) else 0.0
    grid = np.arange(len(picked)) * float(np.mean(np.diff(t)))
    return SwingData(
        name,
        scenario,
        grid,
        angle[picked],
        motor,
        noise,
        rounding,
        rate,
        float(time[picked[0]]),
        facts,
        tuple(warnings),
    )


def _release(time: np.ndarray, angle: np.ndarray, scenario: RigScenario, log: RunLog) -> int:
    """Row of the release: the end of the rest that the metadata or the scenario tell, else the first motion."""
    told = stated_rest(log)
    if told is None and "rest" in log.scenario.get("experiment", {}):
        told = (0.0, scenario.experiment.rest - earlier_shift(log))
    if told is not None:
        if told[1] >= time[-1]:
            raise FitError(f"the rest ends at {told[1]:g} s, but the log at {time[-1]:g} s; there is no swing in it")
        return int(np.searchsorted(time, told[1] - 1e-9))
    moved = np.flatnonzero(np.abs(angle - angle[0]) > _COUNTS_MOVED * reading_step(scenario))
    if not moved.size:
        raise FitError(f"the angle stays at {angle[0]:.4f} rad; there is no swing in it")
    return int(moved[0])


def reading_step(scenario: RigScenario) -> float:
    """Of the angle in a log of this rig, rad: a count of the encoder, or of the position in a reply of the AK70-10."""
    if scenario.is_robot:
        return 2.0 * scenario.robot_motor.position_range / (2**MotorReply.position_bits - 1)
    return count_angle(scenario)


def _is_rounded(angle: np.ndarray, step: float) -> bool:
    """Whether the readings differ by whole steps."""
    steps = (angle - angle[0]) / step
    return bool(np.all(np.abs(steps - np.round(steps)) < _WHOLE))


def _end_of_motion(angle: np.ndarray, step: float, sampling: float) -> int:
    """Number of samples until the reading changes by fewer than three steps in a tenth of a second.

    At rest a reading repeats one rounding error for as long as the log goes on, and on the way there it dwells on the
    later side of each step: errors that do not average out, in samples that would count as many.
    """
    window = max(round(_DWELL / sampling), 1)
    moving = np.flatnonzero(np.abs(angle[window:] - angle[:-window]) > _DWELL_STEPS * step)
    return max(int(moving[-1]) + window + 1 if moving.size else len(angle), LEAST_SAMPLES)


def _motor(log: RunLog, scenario: RigScenario, picked: np.ndarray, stride: int) -> tuple[np.ndarray, list[str]]:
    """Mean torque of the Maxon during each step; zero for a free swing, whose logged current is only noise."""
    steps = len(picked) - 1
    if scenario.is_robot:
        return np.zeros(steps), []
    if CURRENT not in log.table.columns:
        return np.zeros(steps), ["no current in the log: taken as a free swing"]
    current = log.signal(CURRENT)
    check_signals(log.time, {CURRENT: current}, largest_step=np.inf)
    limit = CURRENT_MARGIN * scenario.maxon.current_limit
    if np.max(np.abs(current)) > limit:
        raise FitError(f"column {CURRENT!r} reaches {np.max(np.abs(current)):g}, beyond {limit:g} A; is it in mA?")
    moving = current[picked[0] + 1 : picked[-1] + 1].reshape(steps, stride).mean(axis=1)
    if np.sqrt(np.mean(np.square(moving))) < 5.0 * max(scenario.maxon.current_noise, 1e-3):
        return np.zeros(steps), []
    return -scenario.maxon.torque_constant * moving, []
