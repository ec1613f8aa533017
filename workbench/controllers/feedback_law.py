"""A law that steers the tail by the state of the car, without an announced turn. No Drake.

The tail waits upright. A demand for a roll rate of the tail is the sum of what the steering predicts and of what the
IMU measures:

    demand = steering_gain tanh(v^2 tan(delta) / (L a_grip)) + roll_gain phi + roll_rate_gain dphi/dt

with speed v, steering command delta, wheelbase L, the lateral acceleration a_grip that a floor gives, and roll phi. The
first term is the lateral acceleration of the kinematic bicycle, limited by the floor. In a turn to the left the car
rolls to the right, so a positive demand swings the tail to the right: reaction and air push the car back.
A demand below `threshold` lets the tail go: it returns at `return_speed`, which disturbs little, and may swing again at
any time, to either side. Without a valid IMU the tail is held still.

The law is one function of arrays, `respond`, so that a batch of cars and the car itself run the same lines.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.config.car_parameters import ControllerParameters, FeedbackParameters
from aerodima.workbench.config.signal_table import IMU
from aerodima.workbench.controllers.swing_law import SwingState
from aerodima.workbench.controllers.tail_law import NO_COMMAND, Observation

ROLL, GYRO_X = IMU.index("roll"), IMU.index("gyro_x")


class Seen(NamedTuple):
    """What the law looks at, numbers or arrays of cars (n).

    Attributes:
        roll, roll_rate: of the car, rad and rad/s, positive to the right.
        speed: m/s; steering_angle: command, rad, positive to the left.
        tail_roll: of the tail, rad, positive to the right.
        valid: whether the IMU is fresh and without fault.
    """

    roll: Any
    roll_rate: Any
    speed: Any
    steering_angle: Any
    tail_roll: Any
    valid: Any


class Response(NamedTuple):
    """Command to the roll motor and the state behind it, numbers or arrays (n).

    Attributes:
        reference: rad, where the returning tail is led; the memory of the law.
        position, velocity, kp, kd: rad, rad/s, N m/rad, N m s/rad.
        state: of `SwingState`.
    """

    reference: Any
    position: Any
    velocity: Any
    kp: Any
    kd: Any
    state: Any


def respond(gains: Any, wheelbase: Any, rate: float, reference: Any, seen: Seen) -> Response:
    """One step of the law.

    Args:
        gains: any object with the fields of `FeedbackParameters`, numbers or arrays (n).
        wheelbase: m; rate: of the controller, Hz.
        reference: of the step before, rad.
        seen: signals.
    """
    predicted = np.tanh(seen.speed**2 * np.tan(seen.steering_angle) / (wheelbase * gains.grip))
    demand = gains.steering_gain * predicted + gains.roll_gain * seen.roll + gains.roll_rate_gain * seen.roll_rate
    demand = np.where(seen.valid, demand, 0.0)
    swings = np.abs(demand) > gains.threshold
    side = np.sign(demand)
    ahead = side * seen.tail_roll + gains.brake_time * np.minimum(np.abs(demand), gains.most_speed)
    ended = swings & (ahead >= gains.most_roll)
    target = np.clip(0.0, reference - gains.return_speed / rate, reference + gains.return_speed / rate)
    returning = ~swings & (np.abs(reference) > 1e-9) & seen.valid
    led = np.where(seen.valid, target, reference)
    reference = np.where(swings, np.clip(seen.tail_roll, -gains.most_roll, gains.most_roll), led)
    position = np.where(ended, side * gains.most_roll, np.where(swings, 0.0, reference))
    speed = np.where(returning, -np.sign(reference) * gains.return_speed, 0.0)
    velocity = np.where(swings & ~ended, np.clip(demand, -gains.most_speed, gains.most_speed), speed)
    kp = np.where(ended, gains.end_kp, np.where(swings, 0.0, gains.return_kp))
    kd = np.where(ended, gains.end_kd, np.where(swings, gains.swing_kd, gains.return_kd))
    moving = np.where(returning, SwingState.RECOCK, SwingState.HOLD)
    state = np.where(ended, SwingState.SETTLE, np.where(swings, SwingState.SWING, moving))
    return Response(reference, position, velocity, kp, kd, state)


@dataclass(frozen=True)
class FeedbackLaw:
    """The law (a `TailLaw`) of one car.

    Args:
        gains: of the law.
        wheelbase: m.
        rate: Hz.
        pitch_command: (5), which holds the pitch joint.
    """

    gains: FeedbackParameters
    wheelbase: float
    rate: float
    pitch_command: np.ndarray
    memory_size = 2

    @classmethod
    def from_scenario(cls, scenario: Any) -> "FeedbackLaw":
        """The law of `scenario.feedback` with the car and the pitch hold of the scenario."""
        controller: ControllerParameters = scenario.controller
        pitch = np.array([controller.pitch_angle, 0.0, controller.hold_kp, controller.hold_kd, 0.0])
        return cls(scenario.feedback, scenario.car.wheelbase, controller.rate, pitch)

    def start(self) -> np.ndarray:
        """Memory (2): reference of the returning tail, rad (NaN before its angle was known), and its last angle."""
        return np.array([math.nan, math.nan])

    def step(self, memory: np.ndarray, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """One tick, see `TailLaw`. An unknown speed predicts nothing; an unknown tail angle is the last known one."""
        known = math.isfinite(observation.roll_angle)
        tail_roll = observation.roll_angle if known else float(memory[1])
        if not math.isfinite(tail_roll):
            return memory, NO_COMMAND, NO_COMMAND, int(SwingState.OFF)
        reference = float(memory[0]) if math.isfinite(memory[0]) else tail_roll
        steering = observation.steering_angle
        seen = Seen(
            roll=observation.imu[ROLL] if observation.imu_valid else 0.0,
            roll_rate=observation.imu[GYRO_X] if observation.imu_valid else 0.0,
            speed=observation.speed if math.isfinite(observation.speed) else 0.0,
            steering_angle=steering if math.isfinite(steering) else 0.0,
            tail_roll=tail_roll,
            valid=observation.imu_valid and known,
        )
        found = respond(self.gains, self.wheelbase, self.rate, reference, seen)
        roll = np.array([float(found.position), float(found.velocity), float(found.kp), float(found.kd), 0.0])
        return np.array([float(found.reference), tail_roll]), self.pitch_command, roll, int(found.state)
