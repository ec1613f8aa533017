"""What is read off the turns of many reduced cars on the way: course, roll, heights of tail and board.

The course is read as `workbench.metrics.turn_course` reads that of a log.
"""

from __future__ import annotations

import numpy as np

from aerodima.optimisation.screening.vehicle_motion import RATES, V, W, tail_axes, up
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.metrics.turn_course import EXIT_YAW_RATE, course_over_ground
from aerodima.workbench.plants.tail import SAIL_TIP_MARGIN


class TurnRecord:
    """Of n cars in a turn to the left, from the start of the steering on.

    Attributes:
        exit_time: s since that start, of the first instant at which the wheels are straight again and the car yaws less
            than `EXIT_YAW_RATE`; NaN until there is one, as the next two.
        course: change from the start to the exit, rad; `sideslip` there, heading less course, rad.
        peak_roll: outwards, rad.
        lowest_tail, lowest_board: least height over the ground, m.

    Args:
        cars: n of them.
        state: when the steering begins (24, n).
    """

    def __init__(self, cars: Vehicles, state: FloatArray) -> None:
        n = cars.count
        self._cars, self._begun, self._before = cars, state, _course(state, cars)
        self.exit_time, self.course, self.sideslip = np.full((3, n), np.nan)
        self.peak_roll, self.lowest_tail, self.lowest_board = np.zeros(n), np.full(n, np.inf), np.full(n, np.inf)

    def see(self, time: float, state: FloatArray, straight: np.ndarray) -> None:
        """Told the states (24, n) at a time (s), and whose steering is over and wheels are straight (n)."""
        self.peak_roll = np.maximum(self.peak_roll, state[5])
        tail, board = _heights(state, self._cars)
        self.lowest_tail, self.lowest_board = np.minimum(self.lowest_tail, tail), np.minimum(self.lowest_board, board)
        leaves = np.isnan(self.exit_time) & straight & (np.abs(state[RATES][W][2]) < EXIT_YAW_RATE)
        if leaves.any():
            course = _course(state, self._cars)
            self.exit_time = np.where(leaves, time, self.exit_time)
            self.course = np.where(leaves, course - self._before, self.course)
            self.sideslip = np.where(leaves, state[3] - course, self.sideslip)

    def heading(self, state: FloatArray) -> FloatArray:
        """Change of it from the start to these states, rad."""
        return state[3] - self._begun[3]


def _course(state: FloatArray, cars: Vehicles) -> FloatArray:
    yaw, pitch, roll = state[3:6]
    return course_over_ground(state[RATES][V], state[RATES][W], roll, pitch, yaw, cars.com_x)[1]


def _heights(state: FloatArray, cars: Vehicles) -> tuple[FloatArray, FloatArray]:
    """Of the lower corner of the sail's tip and of the board over the ground, m; tail far up where there is none."""
    upright = up(state[4], state[5])
    x, _, e = tail_axes(state[6], state[7])
    corner = np.sum(upright * (cars.mount + cars.tip[0] * e), axis=0)
    low = state[2] + corner - np.abs(np.sum(upright * x, axis=0)) * cars.tip[1] - SAIL_TIP_MARGIN
    board = state[2] + np.min(np.sum(upright[:, None] * cars.board, axis=0), axis=0)
    return np.where(cars.has_tail > 0.0, low, np.inf), board
