"""A law that swings the tail as the steering starts, and leans it by the car's state. No Drake.

The tail waits at `pitch_angle`, its roll in the middle. No turn needs to be announced. The steering
asks for a share of the grip of the floor, to the left positive:

    demand = tanh(v^2 tan(delta) / (L grip))

with speed v, steering command delta and wheelbase L. A demand of at least `min_demand` releases a
swing; below half of it the wheels are straight. For `kick_time` the tail goes `kick_roll` to the
inside of the turn, then for `counter_time` `counter_roll` to the outside, below 0 to the inside.
The next swing is released as the wheels are turned to the other side, or to either side when this
one is over and they were straight. Both angles are multiplied by the `level`: the largest demand of
the swing, later the demand of the moment. Beside the swing the tail leans:

    lean = lean_gain demand
           + level (roll_gain (phi - phi_0) + roll_rate_gain dphi/dt + yaw_rate_gain (r - r_d))

with roll phi and yaw rate r; r_d is the yaw rate of the kinematic bicycle within the grip. With
straight wheels the level is zero, so that noise of the IMU does not move the tail, and the zero of
the roll, phi_0, follows the roll. Without a valid IMU the level's terms are zero.

The reference follows swing and lean together, limited to `most_roll`: at `out_speed` where they are
larger than the reference, to either side, else at `return_speed`.

The law is one function of arrays, `respond`, so that a batch of cars and the car itself run the
same lines.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.tail_law import NO_COMMAND, LawStep, Observation
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.scenario.law_parameters import ControllerParameters, FeedbackParameters
from aerodima.workbench.scenario.signal_table import IMU

ROLL = IMU.index("roll")
GYRO_X = IMU.index("gyro_x")
GYRO_Z = IMU.index("gyro_z")
MIDDLE = 0.1
"""Angle from the middle within which a reference counts as waiting in the log, rad."""
OVER = 10.0
"""Time since the release of a swing that is long over, s."""


class FeedbackSignals(NamedTuple):
    """Signals that the law reads, numbers or arrays of cars (n).

    Attributes:
        roll, roll_rate: roll and roll rate of the car, rad and rad/s, positive to the right.
        yaw_rate: yaw rate of the car, rad/s, positive to the left.
        speed: speed of the car, m/s.
        steering_angle: steering command, rad, positive to the left.
        valid: whether the IMU is fresh and without fault.
    """

    roll: Any
    roll_rate: Any
    yaw_rate: Any
    speed: Any
    steering_angle: Any
    valid: Any


class LawMemory(NamedTuple):
    """Values that the law carries from tick to tick, numbers or arrays (n).

    Attributes:
        reference: reference of the roll of the tail, rad.
        side: side of the last swing, +1 after steering to the left, -1 to the right, 0 where the
            wheels have been straight since.
        since: time since the release of that swing, s.
        level: factor on its angles and on the state of the car, 0 to 1.
        zero: roll of the car that counts as none, rad.
    """

    reference: Any
    side: Any
    since: Any
    level: Any
    zero: Any


def respond(
    gains: Any, wheelbase: Any, rate: float, memory: LawMemory, signals: FeedbackSignals
) -> LawMemory:
    """Returns the memory after one tick, with the reference that the roll motor is given.

    Args:
        gains: any object with the fields of `FeedbackParameters`, numbers or arrays (n).
        wheelbase: wheelbase of the car, m.
        rate: rate of the controller, Hz.
        memory: memory of the tick before.
        signals: signals at this tick.
    """
    curvature = np.tan(signals.steering_angle) / wheelbase
    demand = np.tanh(signals.speed**2 * curvature / gains.grip)
    swung = _release(gains, rate, memory, demand)
    straight = (np.abs(demand) < gains.min_demand / 2.0) * (swung.side == 0.0)
    followed = straight * signals.valid / (gains.zero_time * rate)
    zero = memory.zero + followed * (signals.roll - memory.zero)
    max_yaw_rate = gains.grip / np.maximum(signals.speed, 1.0)
    steered_yaw_rate = np.clip(signals.speed * curvature, -max_yaw_rate, max_yaw_rate)
    by_state = (
        gains.roll_gain * (signals.roll - zero)
        + gains.roll_rate_gain * signals.roll_rate
        + gains.yaw_rate_gain * (signals.yaw_rate - steered_yaw_rate)
    )
    lean = _swing(gains, swung) + gains.lean_gain * demand + swung.level * signals.valid * by_state
    reference = _follow(gains, rate, memory.reference, lean)
    return swung._replace(reference=reference, zero=zero)


def _release(gains: Any, rate: float, memory: LawMemory, demand: Any) -> LawMemory:
    """Returns the memory with side, time and level of the swing at this tick."""
    asked = np.abs(demand)
    over = memory.since >= gains.kick_time + gains.counter_time
    side = np.where(over * (asked < gains.min_demand / 2.0), 0.0, memory.side)
    released = (asked >= gains.min_demand) * (demand * side <= 0.0)
    side = np.where(released, np.where(demand > 0.0, 1.0, -1.0), side)
    since = np.where(released, 0.0, np.minimum(memory.since + 1.0 / rate, OVER))
    during = np.maximum(memory.level, asked * (demand * side > 0.0))
    level = np.where(released, asked, np.where(over, asked, during))
    return memory._replace(side=side, since=since, level=level)


def _swing(gains: Any, memory: LawMemory) -> Any:
    """Returns the roll of the swing at a tick, rad."""
    counter_end = gains.kick_time + gains.counter_time
    counter = np.where(memory.since < counter_end, gains.counter_roll, 0.0)
    to_the_outside = np.where(memory.since < gains.kick_time, -gains.kick_roll, counter)
    return memory.side * memory.level * to_the_outside


def _follow(gains: Any, rate: float, reference: Any, lean: Any) -> Any:
    """Returns the reference after one tick towards a lean, rad."""
    lean = np.clip(lean, -gains.most_roll, gains.most_roll)
    outwards = np.abs(lean) > np.abs(reference)
    max_step = np.where(outwards, gains.out_speed, gains.return_speed) / rate
    return reference + np.clip(lean - reference, -max_step, max_step)


@dataclass(frozen=True)
class FeedbackLaw:
    """The law (a `TailLaw`) of one car.

    Args:
        gains: parameters of the law.
        wheelbase: wheelbase of the car, m.
        rate: rate of the controller, Hz.
        pitch_hold: gains of the pitch joint, kp, N m/rad, and kd, N m s/rad.
    """

    gains: FeedbackParameters
    wheelbase: float
    rate: float
    pitch_hold: Pair
    memory_size = len(LawMemory._fields)

    @classmethod
    def from_scenario(cls, scenario: Any) -> "FeedbackLaw":
        """Makes the law of `scenario.feedback` with the car and the pitch hold of the scenario."""
        controller: ControllerParameters = scenario.controller
        wheelbase = scenario.car.wheelbase
        return cls(scenario.feedback, wheelbase, controller.rate, controller.hold_gains)

    def start(self) -> FloatArray:
        """Returns the memory (5), see `LawMemory`; NaN where an angle is not known yet."""
        return np.array(LawMemory(math.nan, 0.0, OVER, 0.0, math.nan))

    def step(self, memory: FloatArray, observation: Observation) -> LawStep:
        """Ticks once, see `TailLaw`.

        Without speed or steering nothing is demanded. A tail of unknown angle is not moved.
        """
        known = LawMemory(*memory.tolist())
        if not math.isfinite(known.reference):
            known = known._replace(reference=observation.roll_angle)
        if not math.isfinite(known.reference):
            return memory, NO_COMMAND, NO_COMMAND, int(SwingState.OFF)
        valid = observation.imu_valid
        roll = 0.0
        roll_rate = 0.0
        yaw_rate = 0.0
        if valid:
            roll = observation.imu[ROLL]
            roll_rate = observation.imu[GYRO_X]
            yaw_rate = observation.imu[GYRO_Z]
        if not math.isfinite(known.zero):
            known = known._replace(zero=roll)
        speed = 0.0
        steering_angle = 0.0
        if math.isfinite(observation.speed) and math.isfinite(observation.steering_angle):
            speed = observation.speed
            steering_angle = observation.steering_angle
        signals = FeedbackSignals(roll, roll_rate, yaw_rate, speed, steering_angle, valid)
        gains = self.gains
        after = respond(gains, self.wheelbase, self.rate, known, signals)
        reference = float(after.reference)
        pitch = np.array([gains.pitch_angle, 0.0, *self.pitch_hold, 0.0])
        command = np.array([reference, 0.0, gains.kp, gains.kd, 0.0])
        return np.array(after, float), pitch, command, int(_state(known.reference, after))


def _state(before: float, after: LawMemory) -> SwingState:
    """Returns the state for the log: whether the tail waits, goes out, or comes back."""
    if abs(after.reference) <= MIDDLE:
        return SwingState.HOLD
    if abs(after.reference) > abs(before):
        return SwingState.SWING
    return SwingState.RECOCK
