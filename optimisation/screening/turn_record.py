"""What is read off the turns of many reduced cars on the way: course, roll, heights of tail and board.

The course is read as `workbench.metrics.turn_course` reads that of a log, but at the instant of the exit, between two
steps: so it changes smoothly with what the driver and the tail do. Complex steps pass through.
"""

from __future__ import annotations

import numpy as np

from aerodima.optimisation.screening.vehicle_motion import RATES, STATES, TINY, V, W, tail_axes, up
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.metrics.settling import CALM, CALM_FOR, EXIT_YAW_RATE
from aerodima.workbench.metrics.turn_course import velocity_over_ground
from aerodima.workbench.metrics.turn_signals import LOADED_FORCE
from aerodima.workbench.plants.tail import SAIL_TIP_MARGIN

_COS_CALM = np.cos(CALM["tilt_truth_rad"])
_CALM_STATES = {
    **{f"w_{axis}": CALM[f"gyro_{axis}_truth_rad_per_s"] for axis in "xyz"},
    "v_y": CALM["velocity_y_truth_m_per_s"],
    **{name: CALM[name + "_rad_per_s"] for name in ("tail_pitch_rate", "tail_roll_rate")},
}
_CALM_PLACES = [STATES.index(name) for name in _CALM_STATES]


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
        straight: when the wheels are straight again (n), s since then.
    """

    def __init__(self, cars: Vehicles, state: FloatArray, straight: FloatArray) -> None:
        n = cars.count
        self._cars, self._begun, self._straight, self._course = cars, state, straight, course(state, cars)
        self._seen = (0.0, state)
        self._limits = np.outer(list(_CALM_STATES.values()), np.ones(n))
        self._limits[-2:, cars.has_tail == 0.0] = np.inf
        self._restless, self._settled = straight.real, np.full(n, np.nan)
        self.exit_time, self.course, self.sideslip = np.full((3, n), np.nan)
        self.peak_roll, self.lowest_tail, self.lowest_board = np.zeros(n), np.full(n, np.inf), np.full(n, np.inf)

    def see(self, time: float, state: FloatArray) -> None:
        """Told the states (24, n) at a time since the start of the steering, s."""
        self.peak_roll = np.maximum(self.peak_roll, state[5])
        tail, board = heights(state, self._cars)
        self.lowest_tail, self.lowest_board = np.minimum(self.lowest_tail, tail), np.minimum(self.lowest_board, board)
        leaves = np.isnan(self.exit_time) & (time > self._straight.real) & (np.abs(state[14].real) < EXIT_YAW_RATE)
        if leaves.any():
            (earlier, before), length = self._seen, time - self._seen[0]
            side = np.where(state[14].real < 0.0, -1.0, 1.0)
            fall = side * (before[14] - state[14])
            calm = np.where(
                fall.real > 0.0, (side * before[14] - EXIT_YAW_RATE) / np.where(fall == 0.0, 1.0, fall), 0.0
            )
            share = np.clip(np.maximum(calm, (self._straight - earlier) / length), 0.0, 1.0)
            then, now = course(before, self._cars), course(state, self._cars)
            exit_course = then + share * (now - then)
            heading = before[3] + share * (state[3] - before[3])
            self.exit_time = np.where(leaves, earlier + share * length, self.exit_time)
            self.course = np.where(leaves, exit_course - self._course, self.course)
            self.sideslip = np.where(leaves, heading - exit_course, self.sideslip)
        self._seen = (time, state)

    def settle(self, time: float, state: FloatArray, loads: FloatArray, busy: np.ndarray) -> None:
        """Told the loads of the wheels (4, n), N, and whose law is busy: settled is who a log says has."""
        calm = (np.abs(state[_CALM_PLACES].real) <= self._limits).all(axis=0)
        calm &= (up(state[4], state[5])[2].real > _COS_CALM) & (loads.real > LOADED_FORCE).all(axis=0) & ~busy
        self._restless = np.where(calm, self._restless, np.maximum(self._restless, time))
        first = np.isnan(self._settled) & (time - self._restless >= CALM_FOR - 1e-9)
        self._settled = np.where(first, state[3], self._settled)

    def heading(self, state: FloatArray) -> FloatArray:
        """Change of it from the start until the car settled (`workbench.metrics.settling`), else to these states."""
        return np.where(np.isnan(self._settled), state[3], self._settled) - self._begun[3]


def course(state: FloatArray, cars: Vehicles) -> FloatArray:
    """Of n cars (n), rad, less than half a turn from their heading."""
    yaw, pitch, roll = state[3:6]
    ahead, left = velocity_over_ground(state[RATES][V], state[RATES][W], roll, pitch, cars.com_x)
    # Twice the half angle: there is no arctan2 of complex steps.
    return yaw + 2.0 * np.arctan(left / (np.sqrt(ahead * ahead + left * left + TINY) + ahead + TINY))


def heights(state: FloatArray, cars: Vehicles) -> tuple[FloatArray, FloatArray]:
    """Of the lower corner of the sail's tip and of the board over the ground, m; tail far up where there is none."""
    upright = up(state[4], state[5])
    x, _, e = tail_axes(state[6], state[7])
    corner = np.sum(upright * (cars.mount + cars.tip[0] * e), axis=0)
    low = state[2] + corner - np.sqrt(np.sum(upright * x, axis=0) ** 2 + TINY) * cars.tip[1] - SAIL_TIP_MARGIN
    board = state[2] + np.min(np.sum(upright[:, None] * cars.board, axis=0), axis=0)
    return np.where(cars.has_tail > 0.0, low, np.inf), board
