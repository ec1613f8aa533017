"""Batches of reduced cars while they drive: what turns and swerves share.

`compiled.steps.run` steps a rollout: its `tick` asks the laws, its `step` drives and judges.
"""

import math
from typing import Any

import numpy as np

from aerodima.workbench.car.reduced.dynamics import equations, step
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.states import (
    EPS_SQRT,
    RATES,
    Commands,
    V,
    W,
    tail_axes,
    up_in_body,
)
from aerodima.workbench.car.tail_plant import SAIL_TIP_MARGIN
from aerodima.workbench.car.verdict import is_beyond_flip, velocity_over_ground
from aerodima.workbench.core.array_types import ArrayPair, BoolArray, FloatArray, IntArray

STEP = 0.002
"""Length of a step, s: that of the plant in `models/parameters/simulation.yaml`."""


class Rollout:
    """A batch of cars that are stepped together.

    Attributes:
        state: states of the cars (24, n).
        gone: whether a car has flipped (n); its state then stays as it is.
        loads: loads of the wheels before the last step (4, n), N.

    Args:
        cars: parameters of the n cars.
        state: states at the beginning (24, n).
        imu_delay: age of the IMU's signals that the laws see, ticks.
        length: length of a step, s.
    """

    def __init__(
        self, cars: VehicleParams, state: FloatArray, imu_delay: int, length: float
    ) -> None:
        n = cars.count
        self._cars = cars
        self._length = length
        self._tail = np.zeros((2, 4, n))
        self.state = state
        self.gone = np.zeros(n, bool)
        self.loads = np.zeros((4, n))
        self._imu = np.repeat(self._motion()[None], 1 + imu_delay, axis=0)

    def _motion(self) -> FloatArray:
        """Returns roll, roll rate and yaw rate (3, n) of the cars, rad and rad/s."""
        w_x, _, w_z = self.state[RATES][W]
        return np.stack([self.state[5], w_x, w_z])

    def _measure(self) -> FloatArray:
        """Returns what the IMU tells the laws at a tick (3, n): the motion of some ticks ago."""
        self._imu = np.concatenate([self._imu[1:], self._motion()[None]])
        return self._imu[0]

    def _command(self, pitch: FloatArray, roll: FloatArray) -> None:
        """Commands the motors until the next tick, (4, n) each; a car without tail has none."""
        self._tail = np.stack([pitch, roll]) * self._cars.has_tail

    def _drive(self, steering: FloatArray, shaft_speed: FloatArray) -> None:
        """Drives one step with an angle of the front wheels (n), rad, and a speed (n) that the
        governor is asked for, rad/s.
        """
        before = self.state
        both = np.stack([steering, steering])
        system = equations(before, Commands(both, shaft_speed, self._tail), self._cars)
        self.loads = system.loads
        self.state = np.where(self.gone, before, step(before, system, self._length))
        self.gone = self.gone | is_beyond_flip(up_in_body(self.state)[2])


def tick_flags(index: IntArray, rate: float, length: float) -> BoolArray:
    """Returns which steps of a length (s) begin with a tick of a controller of this rate, Hz."""
    return index % round(1.0 / (length * rate)) == 0


def delay_ticks(scenario: Any) -> int:
    """Returns how many ticks of the controller the IMU's signals are old."""
    return math.ceil(scenario.imu.delay * scenario.controller.rate - 1e-9)


def over_ground(state: FloatArray, x: FloatArray) -> ArrayPair:
    """Returns course (n), rad, and speed (n), m/s, of the places x (n), m, of n cars; the course is
    less than half a turn from the heading.
    """
    yaw, pitch, roll = state[3:6]
    rates = state[RATES]
    ahead, left = velocity_over_ground(rates[V], rates[W], roll, pitch, x)
    speed = np.sqrt(ahead * ahead + left * left + EPS_SQRT)
    half_angle = np.arctan(left / (speed + ahead + EPS_SQRT))  # arctan2 cannot be compiled
    return yaw + 2.0 * half_angle, speed


def heights(state: FloatArray, cars: VehicleParams) -> ArrayPair:
    """Returns the heights (n) of the sail's lower tip corner and of the board over the ground, m;
    that of the tail is infinite where there is none.
    """
    upright = up_in_body(state)
    x, _, e = tail_axes(state[6], state[7])
    z = state[2]
    distance, width = cars.tip
    corner = np.sum(upright * (cars.mount + distance * e), axis=0)
    slope = np.sqrt(np.sum(upright * x, axis=0) ** 2 + EPS_SQRT)
    low = z + corner - slope * width - SAIL_TIP_MARGIN
    corners = np.sum(upright[:, None] * cars.board, axis=0)
    board = z + np.min(corners, axis=0)
    return np.where(cars.has_tail > 0.0, low, np.inf), board
