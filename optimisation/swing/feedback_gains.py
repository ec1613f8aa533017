"""Feedback around a swing: finite-horizon LQR on the reduced model along a run of the full car.

The nominal motion is that of the full car, seen through its own sensors without noise: the tracker's states at its own
ticks, delays and roll filter included, and the torque that the motor gave between them. So on the car and turn that the
swing was made for the feedback has nothing to do; its gains come from the reduced model linearised along that motion.

    minimise  sum_k (x_k' Q x_k + R u_k^2) + x_N' Q_f x_N,   x_{k+1} = A_k x_k + B_k u_k   (deviations, one tick each)
    K_k = (R + B_k' P_{k+1} B_k)^-1 B_k' P_{k+1} A_k,   P_k = Q + A_k' P_{k+1} (A_k - B_k K_k)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import expm

from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.reduced_model import INPUTS, STATES, linearise
from aerodima.optimisation.swing.turn_profile import turn_profile
from aerodima.workbench.batch.engine import ProgressLine
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import Feedback, FeedbackState, SwingFile
from aerodima.workbench.controllers.swing_law import SwingState, Tick
from aerodima.workbench.controllers.swing_tracker_law import SwingTracker, TrackerMemory
from aerodima.workbench.controllers.tail_law import Observation
from aerodima.workbench.errors import SwingError
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.simulate.simulation import simulate

FEEDBACK_NAMES: tuple[FeedbackState, ...] = ("car_roll", "car_roll_rate", "tail_roll", "tail_roll_rate")
_MODEL_ORDER = tuple(STATES.index(name) for name in ("roll", "roll_rate", "tail_roll", "tail_roll_rate"))
MOST_RATIO = 0.8
"""Sideways over vertical force of the front tyres up to which the model is linearised. Beyond it a car that lifts its
inner wheels loads its outer ones so much that the rigid model's inertia against rolling vanishes and changes its sign;
in the car suspension and tyres give way."""
_NOISES = ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")


@dataclass(frozen=True)
class LqrWeights:
    """What counts as much as what: one unit of cost for each of these deviations (Bryson's rule).

    Args:
        car_roll: rad.
        car_roll_rate: rad/s.
        tail_roll: rad.
        tail_roll_rate: rad/s.
        torque: N m.
        at_end: the deviations at the end of the horizon count this many times a tick's.
    """

    car_roll: float = 0.05
    car_roll_rate: float = 0.7
    tail_roll: float = 0.5
    tail_roll_rate: float = 8.0
    torque: float = 6.0
    at_end: float = 5.0

    @property
    def state_cost(self) -> FloatArray:
        """Q, shape (4, 4), in the order of `FEEDBACK_NAMES`."""
        return np.diag([getattr(self, name) ** -2.0 for name in FEEDBACK_NAMES])


@dataclass(frozen=True)
class Funnel:
    """How far each state may be from the nominal motion before the tracker gives the swing up.

    Wider than anything that a car still upright showed with +-30 % of force on the sail, 20 ms more delay and noise.
    """

    car_roll: float = 0.6
    car_roll_rate: float = 10.0
    tail_roll: float = 1.0
    tail_roll_rate: float = 25.0


def lqr_gains(A: FloatArray, B: FloatArray, Q: FloatArray, R: float, Q_end: FloatArray) -> FloatArray:
    """Gains of the finite-horizon regulator, shape (ticks, states).

    Args:
        A, B: discrete model of each tick, (ticks, n, n) and (ticks, n, 1).
        Q, Q_end: cost of the state at each tick and at the end, (n, n).
        R: cost of the control.
    """
    P = Q_end
    gains = np.empty(A.shape[:2])
    for k in reversed(range(len(A))):
        BP = B[k].T @ P
        K = (BP @ A[k]) / (R + BP @ B[k])
        P = Q + A[k].T @ P @ (A[k] - B[k] @ K)
        P = 0.5 * (P + P.T)
        gains[k] = K[0]
    return gains


def discretise(A: FloatArray, B: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Zero-order hold of (ticks, n, n) and (ticks, n, 1) over `step` s."""
    n = A.shape[-1]
    block = np.zeros((len(A), n + 1, n + 1))
    block[:, :n, :n], block[:, :n, n:] = A, B
    exponential = expm(step * block)
    return exponential[:, :n, :n], exponential[:, :n, n:]


def with_feedback(
    swing: SwingFile,
    scenario: Scenario,
    *,
    weights: LqrWeights | None = None,
    funnel: Funnel | None = None,
    beyond: float = 0.2,
) -> SwingFile:
    """The swing with gains for the car and turn of a scenario; feedback it had is replaced.

    Args:
        swing: knots with the gains of the joints.
        scenario: the turn; tail mode and direction are set to those of the swing.
        weights: of the regulator.
        funnel: of the tracker.
        beyond: how long the feedback goes on after the last knot, s; the tail's place is then that of the run.

    Raises:
        SwingError: the car has rolled over with the joints following the knots, or never triggered.
    """
    weights, funnel = weights or LqrWeights(), funnel or Funnel()
    quiet = _quiet(scenario, swing.direction)
    nominal = _nominal_run(swing, quiet)
    ticks = round((swing.knots.time_s[-1] + beyond) * quiet.controller.rate) + 1
    states, torque = nominal.states[:ticks], nominal.torque[:ticks]
    time = np.arange(len(states)) / quiet.controller.rate
    car = ReducedCar.of(quiet)
    profile = turn_profile(nominal.run_log, car, nominal.release, quiet.car.tyre_friction)
    side = 1.0 if swing.direction == "left" else -1.0
    planar = side * nominal.truth[: len(states)]
    inputs = profile.at(time)
    ratio = INPUTS.index("front_ratio")
    inputs[:, ratio] = np.clip(inputs[:, ratio], -MOST_RATIO, MOST_RATIO)
    A, B = linearise(planar, side * torque[:, None], inputs, car)
    order = list(_MODEL_ORDER)
    A, B = discretise(A[:, order][:, :, order], B[:, order], 1.0 / quiet.controller.rate)
    Q = weights.state_cost
    gains = lqr_gains(A, B, Q, weights.torque**-2.0, weights.at_end * Q)
    if not np.all(np.isfinite(gains)):
        raise SwingError(
            f"swing {swing.name}: no gains: the reduced model does not hold along this run; allowed: less friction"
        )
    feedback = Feedback(
        states=FEEDBACK_NAMES,
        time_s=tuple(time.tolist()),
        nominal=tuple(map(tuple, states.tolist())),
        roll_torque_n_m=tuple(torque.tolist()),
        roll_gains=tuple(map(tuple, gains.tolist())),
        pitch_torque_n_m=None,
        pitch_gains=None,
        funnel=tuple(getattr(funnel, name) for name in FEEDBACK_NAMES),
    )
    return swing.model_copy(update={"gains": swing.gains.model_copy(update={"feedback": feedback})})


def with_gains(swing: SwingFile, scenario: Scenario, progress: ProgressLine) -> SwingFile:
    """With feedback for the highest friction that the swing was seen to survive; without it where that fails."""
    found = swing.provenance.found
    sections: dict[str, dict[str, Any]] = {}
    if "survived_friction" in found:
        sections = {"car": {"tyre_friction": float(found["survived_friction"])}}
        sections["manoeuvre"] = {"speed": float(found["survived_speed_m_per_s"])}
    try:
        return with_feedback(swing, scenario.varied(**sections))
    except SwingError as error:
        progress(f"no feedback: {error}")
        return swing


@dataclass(frozen=True)
class _Nominal:
    """A run at the ticks from the release on, in the direction of the file.

    Attributes:
        states: as the tracker saw them, (ticks, 4) as `FEEDBACK_NAMES`.
        torque: of the roll motor, mean over each tick, N m, (ticks,).
        truth: true roll of the car and reported tail, not mirrored, (ticks, 4) as `reduced_model.STATES`.
        release: s.
        run_log: with all signals.
    """

    states: FloatArray
    torque: FloatArray
    truth: FloatArray
    release: float
    run_log: Any


def _nominal_run(swing: SwingFile, scenario: Scenario) -> _Nominal:
    plain = swing.model_copy(update={"gains": swing.gains.model_copy(update={"feedback": None})})
    law = _Listening.from_scenario(plain, scenario.varied(controller={"tracking": "joint_pd"}))
    log = simulate(scenario, law=law, stop_when_certain=True)
    summary = summarise(log, scenario.name)
    where = f"swing {swing.name} at {scenario.manoeuvre.speed:g} m/s, friction {scenario.car.tyre_friction:g}"
    if summary.trigger_time is None:
        raise SwingError(f"{where}: the swing was never released, so there is nothing to hold")
    if not summary.survived:
        raise SwingError(
            f"{where}: the car rolls over while its joints follow the knots; feedback is made around a turn that "
            "the swing survives"
        )
    heard = np.array([row for row in law.heard if row[1] in (SwingState.SWING, SwingState.SETTLE)])
    release = float(heard[0, 0])
    at = np.searchsorted(log.time, heard[:, 0] - 1e-9)
    period = 1.0 / scenario.controller.rate
    motor = log.signal("tail_roll_torque_n_m")
    torque = [motor[(log.time >= t - 1e-9) & (log.time < t + period - 1e-9)].mean() for t in heard[:, 0]]
    car_roll, car_roll_rate = (log.signal(name)[at] for name in ("roll_truth_rad", "gyro_x_truth_rad_per_s"))
    truth = np.column_stack([car_roll, heard[:, 4], car_roll_rate, heard[:, 5]])
    return _Nominal(heard[:, 2:], np.array(torque), truth, release, log)


def _quiet(scenario: Scenario, direction: str) -> Scenario:
    quiet = dict.fromkeys(_NOISES, 0.0)
    return scenario.varied(tail={"mode": "swing"}, manoeuvre={"direction": direction}, imu=quiet)


@dataclass(frozen=True)
class _Listening(SwingTracker):
    """A tracker whose view of the car is written down: time, state of the law, `FEEDBACK_NAMES`."""

    heard: list[tuple[float, ...]] = field(default_factory=list)

    def tick(self, memory: TrackerMemory, observation: Observation) -> Tick[TrackerMemory]:
        after, pitch, roll = super().tick(memory, observation)
        seen = (observation.time, after.state, after.car_roll, after.car_roll_rate)
        self.heard.append((*seen, observation.roll_angle, observation.roll_rate))
        return after, pitch, roll
