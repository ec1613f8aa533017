"""Course of a turn over the ground, and the time that it takes, from the steering command on.

The course is the direction of motion over the ground of one point of the chassis: the point on the
ground under the centre of mass of the car without tail arm (`car.com_x`). A spin turns the body,
not the course, and roll turns neither: the centre of mass itself, `car.com_height` above, swings
with the roll rate, so that its own velocity points up to 6 degrees past the course while a car
comes down from its outer wheels. The course is read when the turn is over: the wheels are straight
again and the yaw rate is below `EXIT_YAW_RATE`. Everything is from the ground truth, with signs
turned so that the turn is positive. Definitions: design section 10.
"""

import math
from dataclasses import dataclass

import numpy as np

from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.car.verdict import has_left_turn, velocity_over_ground
from aerodima.workbench.core.array_types import ArrayPair
from aerodima.workbench.logs.schema import RunLog


@dataclass(frozen=True)
class TurnCourse:
    """Exit of a turn; every field is None without one.

    Attributes:
        exit_time_s: time of the exit since the steering command: the first instant with straight
            wheels and a yaw rate below `EXIT_YAW_RATE`.
        course_change_rad: course at the exit less that at the steering command, into the turn.
        exit_heading_change_rad: same difference for the body's heading.
        exit_sideslip_rad: heading less course at the exit: positive when the nose points further
            into the turn.
        exit_speed_m_per_s: ground speed at the exit.
    """

    exit_time_s: float | None
    course_change_rad: float | None
    exit_heading_change_rad: float | None
    exit_sideslip_rad: float | None
    exit_speed_m_per_s: float | None


def turn_course(run_log: RunLog) -> TurnCourse:
    """Returns the course of a run's turn.

    Raises:
        LogError: no ground truth, or as for `metrics_of`.
    """
    signals = turn_signals(run_log, "truth")
    speed, course = ground_velocity(run_log)
    first = np.flatnonzero(signals.from_start)[0]
    course = signals.sign * course
    straight = signals.from_start & ~signals.in_window
    over = np.flatnonzero(has_left_turn(straight, signals.yaw_rate))
    if over.size == 0:
        return TurnCourse(None, None, None, None, None)
    at = over[0]
    heading = signals.yaw[at]
    return TurnCourse(
        exit_time_s=float(signals.time[at] - signals.window[0]),
        course_change_rad=float(course[at] - course[first]),
        exit_heading_change_rad=float(heading - signals.yaw[first]),
        exit_sideslip_rad=math.remainder(float(heading - course[at]), 2.0 * math.pi),
        exit_speed_m_per_s=float(speed[at]),
    )


def ground_velocity(run_log: RunLog) -> ArrayPair:
    """Returns the ground speed (m/s) and course (rad, unwrapped, positive to the left) of a run,
    each (n,).
    """
    v_WBo_B = run_log.vector("velocity", "truth_m_per_s")
    w_WB_B = run_log.vector("gyro", "truth_rad_per_s")
    roll = run_log.signal("roll_truth_rad")
    pitch = run_log.signal("pitch_truth_rad")
    yaw = run_log.signal("yaw_truth_rad")
    com_x = run_log.number("car", "com_x")
    ahead, left = velocity_over_ground(v_WBo_B.T, w_WB_B.T, roll, pitch, com_x)
    return np.hypot(ahead, left), np.unwrap(yaw + np.arctan2(left, ahead))
