"""Protocol of every control law for the tail: the signals of the station that it sees, and its
commands.

No Drake.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.signal_table import IMU, STATUS, TAIL_STATE

UNKNOWN_IMU = (math.nan,) * 9
"""Nine values of an IMU that is not known."""
NO_COMMAND = np.zeros(5)
"""Command with gains of zero: the motors are free."""
NO_COMMAND.flags.writeable = False
EPSILON = 1e-9
"""Time within which a tick counts as having reached a limit, s; it allows for rounding."""
AGE_LIMIT = 0.1
"""Age beyond which a signal counts as silent, s."""


@dataclass(frozen=True)
class Observation:
    """Signals that a law sees at one tick. NaN means "not known".

    Args:
        time: time of the tick, s.
        yaw_rate: yaw rate of the car, rad/s, positive to the left.
        roll_angle: tail roll, rad, positive to the right.
        pitch_angle: tail pitch, rad.
        planned_turn: announced turn, +1 left, -1 right, from the start of the run on; 0 when no
            turn is announced.
        imu_valid: whether the yaw rate is fresh and without fault.
        roll_rate: rate of the tail's roll, rad/s.
        pitch_rate: rate of the tail's pitch, rad/s.
        imu: signals of the IMU (9), as `signal_table.IMU`.
        speed: speed of the car, m/s.
        steering_angle: commanded steering angle, rad, positive to the left.
    """

    time: float
    yaw_rate: float
    roll_angle: float
    pitch_angle: float
    planned_turn: float
    imu_valid: bool
    roll_rate: float = math.nan
    pitch_rate: float = math.nan
    imu: tuple[float, ...] = UNKNOWN_IMU
    speed: float = math.nan
    steering_angle: float = math.nan


LawStep = tuple[FloatArray, FloatArray, FloatArray, int]
"""Result of a tick of a law: memory, pitch command (5), roll command (5), number of the state."""


class TailLaw(Protocol):
    """A control law for the tail."""

    @property
    def rate(self) -> float:
        """Returns the controller rate, Hz."""

    @property
    def memory_size(self) -> int:
        """Returns the number of floats that the law carries from tick to tick."""

    def start(self) -> FloatArray:
        """Returns the memory (memory_size,) before the first tick."""

    def step(self, memory: FloatArray, observation: Observation) -> LawStep:
        """Returns new memory, pitch command (5), roll command (5) and state number of one tick.

        Must not change its arguments.

        The state number is what the log holds as `controller_state`; reports read it as
        `swing_law.SwingState`.
        """


def sign(value: float) -> float:
    """Returns -1, 0 or +1; 0 for NaN."""
    return float(value > 0.0) - float(value < 0.0)


def observe(
    time: float,
    tail_state: FloatArray,
    imu: FloatArray,
    status: FloatArray,
    planned_turn: float,
    speed: FloatArray | None,
    age_limit: float = AGE_LIMIT,
    *,
    steering_angle: float = math.nan,
) -> Observation:
    """Returns the observation of a law at `time` s; a signal that is older than `age_limit` s or
    has a fault code is unknown.

    A GPS is late by nature: its speed counts until its fault code is set. `speed` is None where
    there is none. `steering_angle` is the driver's command, rad.
    """
    tail = TAIL_STATE.read(tail_state)
    motion = IMU.read(imu)
    health = STATUS.read(status)
    roll_known = _fresh(health.tail_roll_age, health.tail_roll_fault, age_limit)
    pitch_known = _fresh(health.tail_pitch_age, health.tail_pitch_fault, age_limit)
    imu_valid = _fresh(health.imu_age, health.imu_fault, age_limit)
    known_speed = math.nan
    if speed is not None and health.speed_fault == 0.0:
        known_speed = float(speed[0])
    return Observation(
        time=time,
        yaw_rate=motion.gyro_z,
        roll_angle=tail.roll_angle if roll_known else math.nan,
        pitch_angle=tail.pitch_angle if pitch_known else math.nan,
        planned_turn=planned_turn,
        imu_valid=imu_valid,
        roll_rate=tail.roll_rate if roll_known else math.nan,
        pitch_rate=tail.pitch_rate if pitch_known else math.nan,
        imu=motion if imu_valid else UNKNOWN_IMU,
        speed=known_speed,
        steering_angle=steering_angle,
    )


def _fresh(age: float, fault: float, age_limit: float) -> bool:
    """Returns whether a signal of an age (s) and a fault code is fresh, False for NaN too."""
    return age <= age_limit and fault == 0.0
