"""What a turn does to the car, taken from a run of the full car: the inputs of the reduced model over time.

The profile is that of a turn, not of one run: divided by the tyre friction, so that it can be asked for another one,
and stretched to another entry speed. Both are approximations near the run it was taken from; the outer loop of the
optimisation runs the full car again with the new swing and takes the profile anew until nothing changes
(`consistency`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.reduced_model import INPUTS, motion
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import WHEELS
from aerodima.workbench.errors import SwingError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.turn_signals import turn_sign

SMOOTHING = 0.03
"""Width of the moving average over signals that carry tyre and suspension vibration, s; the reduced model has none
of it."""
ROLL_MOMENT = INPUTS.index("roll_moment")


@dataclass(frozen=True)
class TurnProfile:
    """Inputs of the reduced model over time, written for a left turn; time 0 is the release (trigger) of the swing.

    Attributes:
        time: s, shape (n,), increasing; begins before 0.
        inputs: (n, 6) as `reduced_model.INPUTS`, for the friction and the speed of the run.
        friction: tyre friction of the run.
        speed: at the start of the turn, m/s.
        roll, roll_rate: of the car in that run, outwards, rad and rad/s, shape (n,).
        trigger_time: time in the run at which time is 0, s.
    """

    time: FloatArray
    inputs: FloatArray
    friction: float
    speed: float
    roll: FloatArray
    roll_rate: FloatArray
    trigger_time: float

    def at(
        self, time: NDArray, friction: NDArray | float | None = None, speed: NDArray | float | None = None
    ) -> NDArray:
        """Inputs (..., 6) at times (s) for a tyre friction and an entry speed (m/s); by default those of the run."""
        return self.scaled(self.curve(time), friction, speed)

    def scaled(self, curve: NDArray, friction: Any = None, speed: Any = None) -> NDArray:
        """Inputs (..., 6) of the run for another friction or entry speed; complex steps pass through.

        Front ratio, yaw force and yaw rate grow with the friction, since the front tyres slide; the yaw rate falls
        with the speed, as the sideways force stays the same.
        """
        grip = 1.0 if friction is None else friction / self.friction
        pace = 1.0 if speed is None else speed / self.speed
        return curve * np.stack(np.broadcast_arrays(grip, grip, pace, pace, grip / pace, 1.0), axis=-1)

    def curve(self, time: NDArray) -> FloatArray:
        """Inputs (..., 6) of the run at times, s; constant beyond its ends."""
        return np.asarray(self._interpolant(np.clip(time, self.time[0], self.time[-1])))

    @cached_property
    def _interpolant(self) -> PchipInterpolator:
        return PchipInterpolator(self.time, self.inputs, axis=0)

    def state_at(self, time: float) -> tuple[float, float]:
        """Car roll (rad) and roll rate (rad/s) of the run at a time, s."""
        return float(np.interp(time, self.time, self.roll)), float(np.interp(time, self.time, self.roll_rate))


def turn_profile(
    run_log: RunLog, car: ReducedCar, release: float, friction: float, until_roll: float = 0.6
) -> TurnProfile:
    """The profile of a run with all signals.

    Args:
        run_log: of the full car, with truth.
        car: reduced car of the same scenario.
        release: time in the run that becomes 0, s.
        friction: tyre friction of the run.
        until_roll: roll at which the run counts as lost, rad: what comes after is not used.

    Raises:
        SwingError: the run holds no turn after the release.
    """
    side = turn_sign(run_log)
    time = run_log.time
    table = run_log.table
    column = {name: table[name].to_numpy(float) for name in table.columns if "truth" in name}
    roll = side * column["roll_truth_rad"]
    lost = np.flatnonzero(np.abs(roll) > until_roll)
    last = int(lost[0]) if len(lost) else len(time)
    if time[last - 1] <= release:
        raise SwingError(
            f"profile: the car has rolled over at {time[last - 1]:g} s, before the release at {release:g} s"
        )
    yaw = column["yaw_truth_rad"]
    smooth = _smoother(time)

    def sideways(stem: str) -> FloatArray:
        along_y = np.cos(yaw) * column[f"{stem}_y_truth_n"] - np.sin(yaw) * column[f"{stem}_x_truth_n"]
        return side * along_y

    front = smooth(np.sum([sideways(f"wheel_force_{wheel}") for wheel in WHEELS[:2]], axis=0))
    rear = smooth(np.sum([sideways(f"wheel_force_{wheel}") for wheel in WHEELS[2:]], axis=0))
    load = smooth(np.sum([column[f"wheel_force_{wheel}_z_truth_n"] for wheel in WHEELS], axis=0))
    force, moment = _tail_on_car(column, time, car, smooth, side)
    # The tail's moments about the rear axle load the front axle (pitch) and the rear tyres (yaw).
    front_load = ((load + force[2]) * car.com_x + moment[1]) / car.wheelbase
    front_share = (car.wheelbase - car.com_x) / car.com_x
    weight = (car.mass + car.tail_mass) * car.gravity
    yaw_force = (front * front_share + moment[2] / car.com_x - force[1] - rear) / weight
    inputs = np.column_stack(
        [
            front / np.maximum(front_load, 0.05 * weight),
            yaw_force,
            column["velocity_x_truth_m_per_s"],
            smooth(side * column["velocity_y_truth_m_per_s"]),
            smooth(side * column["gyro_z_truth_rad_per_s"]),
            np.zeros(len(time)),
        ]
    )
    roll_rate = side * column["gyro_x_truth_rad_per_s"]
    inputs[:, ROLL_MOMENT] = _unexplained_moment(run_log, side, inputs, smooth(roll), smooth(roll_rate), car, smooth)
    begin = max(0, int(np.searchsorted(time, release - 0.5)))
    use = slice(begin, last)
    start = int(np.searchsorted(time, release - 1e-9))
    return TurnProfile(
        time=time[use] - release,
        inputs=inputs[use],
        friction=friction,
        speed=float(column["velocity_x_truth_m_per_s"][begin]),
        roll=roll[use],
        roll_rate=roll_rate[use],
        trigger_time=float(time[start]),
    )


def _tail_on_car(
    column: dict[str, FloatArray],
    time: FloatArray,
    car: ReducedCar,
    smooth: Callable[[FloatArray], FloatArray],
    side: float,
) -> tuple[FloatArray, FloatArray]:
    """Force of the tail on the car and its moment about the body origin, (3, n), in axes that yaw with the car.

    Weight and air less the rate of the tail's momentum; written for a left turn. Of the moment of weight and momentum
    it has the part that the reduced model has: what the tail's place along the car makes of sideways and upward
    force. What the yawing of a swinging tail adds stays in the profile's `yaw_force`.
    """

    def vector(stem: str, unit: str) -> FloatArray:
        return np.array([column[f"{stem}_{axis}_truth_{unit}"] for axis in "xyz"])

    c, s = np.cos(column["yaw_truth_rad"]), np.sin(column["yaw_truth_rad"])

    def turned(values: FloatArray) -> FloatArray:
        return np.array([c * values[0] + s * values[1], c * values[1] - s * values[0], values[2]])

    origin = vector("position", "m")
    air, air_moment = vector("tail_force", "n"), vector("tail_force_moment", "n_m")
    air_moment = turned(air_moment - np.cross(origin, air, axis=0))
    inertial = np.array([-np.gradient(smooth(row), time) for row in vector("tail_momentum", "n_s")])
    inertial[2] -= car.tail_mass * car.gravity
    inertial, ahead = turned(inertial), turned(vector("tail_com", "m") - origin)[0]
    force = np.array([smooth(row) for row in turned(air)]) + inertial
    moment = np.array([smooth(row) for row in air_moment])
    moment[1] -= ahead * inertial[2]
    moment[2] += ahead * inertial[1]
    return force * [[1], [side], [1]], moment * [[side], [1], [side]]


def _unexplained_moment(
    run_log: RunLog,
    side: float,
    inputs: FloatArray,
    roll: FloatArray,
    roll_rate: FloatArray,
    car: ReducedCar,
    smooth: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Moment (N m) that the reduced model lacks to roll as the car of the run did; with it, it does exactly so.

    Near the limit the car balances, and a moment of 2 % of its weight's decides; what the model leaves out (pitch,
    one inner wheel lifting before the other) is of that size.
    """
    time = run_log.time
    tail = [
        np.column_stack([smooth(run_log.signal(f"tail_{joint}_{part}")) for joint in ("roll", "pitch")])
        for part in ("angle_rad", "rate_rad_per_s")
    ]
    accelerations = np.column_stack([np.gradient(rates, time) for rates in tail[1].T])
    turning = (tail[0] * [side, 1.0], tail[1] * [side, 1.0], accelerations * [side, 1.0])
    one = np.zeros(inputs.shape[1])
    one[ROLL_MOMENT] = 1.0
    without, _ = motion(roll, roll_rate, turning, inputs, car)
    with_one, _ = motion(roll, roll_rate, turning, inputs + one, car)
    return smooth((np.gradient(roll_rate, time) - without) / (with_one - without))


def _smoother(time: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Moving average of odd length over `SMOOTHING`, edges held."""
    half = max(1, round(0.5 * SMOOTHING / float(time[1] - time[0])))
    kernel = np.ones(2 * half + 1) / (2 * half + 1)

    def smooth(signal: FloatArray) -> FloatArray:
        return np.convolve(np.pad(signal, half, mode="edge"), kernel, "valid")

    return smooth
