"""A law that leans the tail by the state of the car, without an announced turn. No Drake.

The tail waits at `pitch_angle`, its roll in the middle. Steering and IMU ask for a roll of the
tail:

    lean = lean_gain tanh(v^2 tan(delta) / (L a_grip))
           + roll_gain phi + roll_rate_gain dphi/dt + yaw_rate_gain (r - r_d)

with speed v, steering command delta, wheelbase L, the lateral acceleration a_grip that a floor
gives, roll phi and yaw rate r. The first term is the lateral acceleration of the kinematic bicycle,
limited by the floor, and r_d is its yaw rate under the same limit. A negative `lean_gain` leans the
tail to the inside of the turn. The reference follows the lean, limited to `most_roll`: at
`out_speed` where the lean is larger than the reference, to either side, else at `return_speed`.
When the wheels are straight again, the tail comes back by itself, to be there for the next turn to
either side. Without a valid IMU the tail is held still.

The law is one function of arrays, `respond`, so that a batch of cars and the car itself run the
same lines.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.tail_law import NO_COMMAND, LawStep, Observation
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.law_parameters import ControllerParameters, FeedbackParameters
from aerodima.workbench.scenario.signal_table import IMU

ROLL = IMU.index("roll")
GYRO_X = IMU.index("gyro_x")
GYRO_Z = IMU.index("gyro_z")
MIDDLE = 0.1
"""rad; a reference nearer to the middle counts as waiting in the log."""


class FeedbackSignals(NamedTuple):
    """Signals that the law reads, numbers or arrays of cars (n).

    Attributes:
        roll, roll_rate: of the car, rad and rad/s, positive to the right.
        yaw_rate: of the car, rad/s, positive to the left.
        speed: m/s.
        steering_angle: command, rad, positive to the left.
        valid: whether the IMU is fresh and without fault.
    """

    roll: Any
    roll_rate: Any
    yaw_rate: Any
    speed: Any
    steering_angle: Any
    valid: Any


class Response(NamedTuple):
    """Command to the roll motor, numbers or arrays (n).

    Attributes:
        reference: rad, of the roll of the tail; the memory of the law.
        state: of `SwingState`.
    """

    reference: Any
    state: Any


def respond(
    gains: Any, wheelbase: Any, rate: float, reference: Any, signals: FeedbackSignals
) -> Response:
    """Returns the response of the law to one tick.

    Args:
        gains: any object with the fields of `FeedbackParameters`, numbers or arrays (n).
        wheelbase: m.
        rate: of the controller, Hz.
        reference: of the step before, rad.
        signals: signals.
    """
    curvature = np.tan(signals.steering_angle) / wheelbase
    most_yaw = gains.grip / np.maximum(signals.speed, 1.0)
    lean = (
        gains.lean_gain * np.tanh(signals.speed**2 * curvature / gains.grip)
        + gains.roll_gain * signals.roll
        + gains.roll_rate_gain * signals.roll_rate
        + gains.yaw_rate_gain
        * (signals.yaw_rate - np.clip(signals.speed * curvature, -most_yaw, most_yaw))
    )
    lean = np.clip(lean, -gains.most_roll, gains.most_roll)
    outwards = np.abs(lean) > np.abs(reference)
    most = np.where(outwards, gains.out_speed, gains.return_speed) / rate
    moved = np.where(signals.valid, np.clip(lean - reference, -most, most), 0.0)
    moving = np.where(outwards, SwingState.SWING, SwingState.RECOCK)
    state = np.where(np.abs(reference + moved) > MIDDLE, moving, SwingState.HOLD)
    return Response(reference + moved, state)


@dataclass(frozen=True)
class FeedbackLaw:
    """The law (a `TailLaw`) of one car.

    Args:
        gains: of the law.
        wheelbase: m.
        rate: Hz.
        pitch_hold: kp, N m/rad, and kd, N m s/rad, of the pitch joint.
    """

    gains: FeedbackParameters
    wheelbase: float
    rate: float
    pitch_hold: tuple[float, float]
    memory_size = 1

    @classmethod
    def from_scenario(cls, scenario: Any) -> "FeedbackLaw":
        """Makes the law of `scenario.feedback` with the car and the pitch hold of the scenario."""
        controller: ControllerParameters = scenario.controller
        hold = (controller.hold_kp, controller.hold_kd)
        return cls(scenario.feedback, scenario.car.wheelbase, controller.rate, hold)

    def start(self) -> FloatArray:
        """Returns the memory (1): reference of the roll of the tail, rad; NaN before its angle was
        known.
        """
        return np.array([math.nan])

    def step(self, memory: FloatArray, observation: Observation) -> LawStep:
        """Ticks once, see `TailLaw`.

        Without speed or steering, roll and roll rate decide alone. A tail of unknown angle is not
        moved.
        """
        if math.isfinite(memory[0]):
            reference = float(memory[0])
        else:
            reference = observation.roll_angle
        if not math.isfinite(reference):
            return memory, NO_COMMAND, NO_COMMAND, int(SwingState.OFF)
        steering = observation.steering_angle
        valid = observation.imu_valid
        roll = 0.0
        roll_rate = 0.0
        yaw_rate = 0.0
        speed = 0.0
        steering_angle = 0.0
        if valid:
            roll = observation.imu[ROLL]
            roll_rate = observation.imu[GYRO_X]
        if math.isfinite(observation.speed) and math.isfinite(steering):
            speed = observation.speed
            steering_angle = steering
            if valid:
                yaw_rate = observation.imu[GYRO_Z]
        signals = FeedbackSignals(roll, roll_rate, yaw_rate, speed, steering_angle, valid)
        gains = self.gains
        response = respond(gains, self.wheelbase, self.rate, reference, signals)
        pitch = np.array([gains.pitch_angle, 0.0, *self.pitch_hold, 0.0])
        moved = float(response.reference)
        command = np.array([moved, 0.0, gains.kp, gains.kd, 0.0])
        return np.array([moved]), pitch, command, int(response.state)
