"""What every control law for the tail sees and gives: the thesis' swing, the tracker of swing files. No Drake."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

UNKNOWN_IMU = (math.nan,) * 9


@dataclass(frozen=True)
class Observation:
    """What a law sees at one tick. NaN means "not known".

    Args:
        time: s.
        yaw_rate: rad/s, positive to the left.
        roll_angle: tail roll, rad, positive to the right.
        pitch_angle: tail pitch, rad.
        planned_turn: +1 left, -1 right, from the start of the run on; 0 when no turn is announced.
        imu_valid: the yaw rate is fresh and without fault.
        roll_rate: of the tail, rad/s.
        pitch_rate: of the tail, rad/s.
        imu: (9), as `ports.IMU`.
        speed: of the car, m/s.
        steering_angle: commanded, rad, positive to the left.
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


class TailLaw(Protocol):
    """A control law for the tail."""

    @property
    def rate(self) -> float:
        """Controller rate, Hz."""

    @property
    def memory_size(self) -> int:
        """Number of floats that the law carries from tick to tick."""

    def start(self) -> np.ndarray:
        """Memory (memory_size,) before the first tick."""

    def step(self, memory: np.ndarray, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """One tick: new memory, pitch command (5), roll command (5), state number. Must not change its arguments.

        The state number is what the log holds as `controller_state`; reports read it as `swing_law.SwingState`.
        """


NO_COMMAND = np.zeros(5)
"""Gains of zero: the motors are free."""
NO_COMMAND.flags.writeable = False

EPSILON = 1e-9
"""s; a tick that falls on a limit up to rounding counts as having reached it."""


def sign(value: float) -> float:
    """-1, 0 or +1; 0 for NaN."""
    return float(value > 0.0) - float(value < 0.0)
