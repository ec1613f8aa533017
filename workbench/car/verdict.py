"""Verdicts on a run of the car, for logs and for rollouts of the reduced car alike.

Functions of numbers or arrays, and the limits that they compare with. A log gives them its columns,
a rollout the states of its cars, in a turn whose sign is turned so that it is positive.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from aerodima.workbench.control.swing_law import SwingState

FLIP_TILT = math.radians(75.0)
"""Beyond this tilt the car has rolled over, rad."""
COS_FLIP_TILT = math.cos(FLIP_TILT)
"""Cosine of `FLIP_TILT`."""
END_TILT = math.radians(20.0)
"""Tilt at the end of a run beyond which a car with a wheel in the air has rolled over, rad."""
LOADED_FORCE = 0.1
"""A wheel, cage, board or tail touches the ground from this force on, N; a part in the air feels
exactly none."""
EXIT_YAW_RATE = 0.1
"""A car with straight wheels that yaws less than this has left the turn, rad/s. A large tail to one
side alone gives 0.065."""
TWO_WHEELS = 0.005
"""Two wheels of one side that are both higher than this have tipped up, m."""
LAST = 0.2
"""Time at the end of a run over which it is judged whether the car goes straight again, s."""
CALM_FOR = 0.1
"""Time for which the car must have been calm, s: a third of a period of roll on the suspension."""
CALM = {
    "gyro_x_truth_rad_per_s": 0.15,
    "gyro_y_truth_rad_per_s": 0.15,
    "gyro_z_truth_rad_per_s": EXIT_YAW_RATE,
    "velocity_y_truth_m_per_s": 0.2,
    "tilt_truth_rad": math.radians(3.0),
    "tail_pitch_rate_rad_per_s": 0.3,
    "tail_roll_rate_rad_per_s": 0.3,
}
"""Largest magnitudes of a calm car, by columns of a log. All its wheels bear load too, and the law
neither swings the tail nor is about to."""
CALM_SPIN = math.hypot(*(limit for name, limit in CALM.items() if name.startswith("gyro")))
"""A car that turns faster than this, rad/s, about whatever axis, is not calm."""
_COS_CALM = math.cos(CALM["tilt_truth_rad"])
_ROUNDING = 1e-9
"""Rounding of a time, s."""


def is_beyond_flip(up_z: Any) -> Any:
    """Returns whether a car has tilted beyond `FLIP_TILT`, from the cosine of its tilt."""
    return up_z < COS_FLIP_TILT


def has_flipped(max_tilt_passed: Any, end_tilt: Any, wheel_lifted: Any) -> Any:
    """Returns whether a car has rolled over, or lies at the end.

    Args:
        max_tilt_passed: whether the tilt of the car ever was beyond `FLIP_TILT`.
        end_tilt: angle of its z axis from the world's at the end, rad.
        wheel_lifted: whether a wheel bears no load then.
    """
    return max_tilt_passed | ((end_tilt > END_TILT) & wheel_lifted)


def is_loaded(force: Any) -> Any:
    """Returns whether a force of the ground (N) counts as contact."""
    return force > LOADED_FORCE


def is_busy(controller_state: Any) -> Any:
    """Returns whether the law swings the tail or is about to, from its `SwingState`."""
    return (controller_state == SwingState.DELAY) | (controller_state == SwingState.SWING)


def is_calm(motion: Mapping[str, Any], up_z: Any, loads: Iterable[Any], busy: Any) -> Any:
    """Returns whether a car is calm: it drives on and moves in no other way.

    Args:
        motion: values of the columns of `CALM` without the tilt.
        up_z: cosine of the tilt.
        loads: loads of the wheels, N, one by one.
        busy: whether the law is busy, see `is_busy`.
    """
    calm = (up_z >= _COS_CALM) & ~busy
    for name, limit in CALM.items():
        if name in motion:
            calm = calm & (np.abs(motion[name]) <= limit)
    for load in loads:
        calm = calm & is_loaded(load)
    return calm


def has_settled(time: Any, restless: Any) -> Any:
    """Returns whether a car that was restless last at `restless`, s, has settled at `time`, s."""
    return time - restless >= CALM_FOR - _ROUNDING


def has_left_turn(wheels_straight: Any, yaw_rate: Any) -> Any:
    """Returns whether a car with straight wheels yaws (rad/s) so little that its turn is over."""
    return wheels_straight & (np.abs(yaw_rate) < EXIT_YAW_RATE)


def goes_straight(yaw_rate: Any) -> Any:
    """Returns whether a car goes straight at the end, by its mean yaw rate over `LAST`, rad/s."""
    return np.abs(yaw_rate) <= EXIT_YAW_RATE


def side_lift(lifts: Any) -> Any:
    """Returns the larger height (m) of the lower wheel of each side.

    Args:
        lifts: heights of the wheels (4, ...), m, in the order of `signal_table.WHEELS`.
    """
    front_left, front_right, rear_left, rear_right = lifts
    return np.maximum(np.minimum(front_left, rear_left), np.minimum(front_right, rear_right))


def keeps_sides_down(lift: Any) -> Any:
    """Returns whether no two wheels of one side are in the air, by their `side_lift`, m; False for
    NaN.
    """
    return lift <= TWO_WHEELS


def touches_ground(tail: Any, board: Any, steered: Any) -> Any:
    """Returns whether a contact of tail or cage, or of the anti-ramp board, counts.

    The board is there to catch a car that gathers speed after a turn: it counts while the car is
    steered.
    """
    return tail | (board & steered)


def stays_upright(lift: Any, touched: Any, flipped: Any) -> Any:
    """Returns whether nothing but wheels carries a car, and not those of one side alone.

    Args:
        lift: lift of the side that is lifted higher, m, see `side_lift`.
        touched: whether a contact counts, see `touches_ground`.
        flipped: whether the car has rolled over, see `has_flipped`.
    """
    return keeps_sides_down(lift) & ~touched & ~flipped


def velocity_over_ground(
    v_WBo_B: Any, w_WB_B: Any, roll: Any, pitch: Any, com_x: Any
) -> tuple[Any, Any]:
    """Returns the velocity below the centre of mass, along the heading and to its left, m/s.

    Args:
        v_WBo_B, w_WB_B: velocity of the origin of B and angular velocity, in B (3, ...), m/s and
            rad/s.
        roll, pitch: attitude of B (...), rad.
        com_x: distance of the centre of mass of the car without tail arm ahead of the origin of B,
            m.
    """
    x = v_WBo_B[0]
    y = v_WBo_B[1] + w_WB_B[2] * com_x
    z = v_WBo_B[2] - w_WB_B[1] * com_x
    left = np.cos(roll) * y - np.sin(roll) * z
    up = np.sin(roll) * y + np.cos(roll) * z
    return np.cos(pitch) * x + np.sin(pitch) * up, left
