"""Measures of a swerve: metres aside, change of course, sustained lateral acceleration.

One record, `Swerve`, holds a run of the full car or a batch of reduced cars, and one function each
measures it. Displacements are to the left of the course that a car has when the steering starts. An
obstacle sees the outline of the car, so what counts is the point of it that lies furthest to the
right; the centre of mass alone would reward a car for turning about it. Definitions: design section
10.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from aerodima.workbench.car.tip_up import LIFT_COLUMNS
from aerodima.workbench.car.turn_course import ground_velocity
from aerodima.workbench.car.turn_signals import STEERED, turn_sign
from aerodima.workbench.car.verdict import (
    FLIP_TILT,
    LAST,
    goes_straight,
    is_loaded,
    side_lift,
    stays_upright,
    touches_ground,
)
from aerodima.workbench.control.paths import place_outline
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.car_parameters import CarParameters

SOON = 0.5
"""First instant at which a displacement is read, s after the start of the steering."""
LATER = 1.0
"""Second instant, at which the change of course is read, too, s after the start of the steering."""
SUSTAINED = (0.5, 1.5)
"""Interval over which the lateral acceleration is averaged, s after the start of the steering."""
MAX_START_COURSE = 0.01
"""Largest course off the first heading of a car that starts straight, rad."""
MAX_START_YAW_RATE = 0.02
"""Largest mean yaw rate of a car that starts straight, over its straight, rad/s. A tail that
follows a noisy IMU shakes the body by 0.2 rad/s about a mean of zero."""
_ROUNDING = 1e-6
"""Rounding of a time, s."""


@dataclass(frozen=True)
class Swerve:
    """Motion of n cars in a swerve to the left.

    Attributes:
        time: time since the start of the steering (steps,), s; negative before it.
        x, y: position of the origin of B in W (steps, n), m.
        heading, course: directions of body and motion (steps, n), rad, unwrapped, positive to the
            left.
        speed: ground speed of the point under the centre of mass (steps, n), m/s.
        yaw_rate: yaw rate (steps, n), rad/s.
        roll: roll of the body, positive outwards (steps, n), rad.
        steering: steering command (steps, n), rad.
        lifts: heights of the wheels over the ground, in the order of `signal_table.WHEELS`
            (steps, 4, n), m.
        heights: heights of tail (and cage) and of the anti-ramp board over the ground (steps, 2,
            n), m; from a log 0 where the part touches the ground, infinite elsewhere.
        tail: pitch and roll of the tail's joints (steps, 2, n), rad; 0 without tail.
        lag: roll of the tail less its command (steps, n), rad.
        torques: torques of the motors of tail pitch and tail roll (steps, 2, n), N m.
        power: power of both motors together (steps, n), W.
        flipped: whether the car has flipped (n,).
        com_x: distance of the centre of mass of the car without tail arm ahead of the origin of B
            (n,), m.
        outline: corners of the car as seen from above, in B (2, corners, n), m.
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    course: FloatArray
    speed: FloatArray
    yaw_rate: FloatArray
    roll: FloatArray
    steering: FloatArray
    lifts: FloatArray
    heights: FloatArray
    tail: FloatArray
    lag: FloatArray
    torques: FloatArray
    power: FloatArray
    flipped: BoolArray
    com_x: FloatArray
    outline: FloatArray

    @property
    def steered(self) -> BoolArray:
        """Flags of the samples that count, those from the start of the steering on (steps,)."""
        return self.time >= -_ROUNDING

    def at(self, values: FloatArray, instant: float) -> FloatArray:
        """Interpolates values (steps, ...) at an instant after the start of the steering, s; NaN
        beyond the end of the run.
        """
        if instant > self.time[-1] + _ROUNDING:
            return np.full(values.shape[1:], np.nan)
        index = int(np.clip(np.searchsorted(self.time, instant), 1, len(self.time) - 1))
        before, after = self.time[index - 1 : index + 1]
        share = (instant - before) / (after - before)
        return values[index - 1] + share * (values[index] - values[index - 1])

    def to_the_left(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Returns how far places (..., n) in W, m, lie to the left of the course at the start."""
        course = self.at(self.course, 0.0)
        return np.cos(course) * y - np.sin(course) * x


Measure = Callable[[Swerve], FloatArray]
"""Function of a `Swerve` that returns a number for each car (n,), or rows of them (rows, n)."""


def car_outline(car: CarParameters) -> FloatArray:
    """Returns the corners of tyres and board as seen from above, in B (2, 6), m."""
    half_width = 0.5 * (car.track + car.tyre_width)
    corners = [(car.wheelbase + car.tyre_radius, half_width), (-car.tyre_radius, half_width)]
    if car.board:
        corners.append((car.board_x, 0.5 * car.board_width))
    else:
        corners.append(corners[-1])
    left = np.array(corners).T
    return np.concatenate([left, left * [[1.0], [-1.0]]], axis=1)


def outline_from_above(run_log: RunLog, after: Sequence[float] | FloatArray) -> FloatArray:
    """Returns how far the corners of a car are ahead and to the left (2, corners, instants), m, of
    its place and course at the start of the steering, at instants `after` that start, s; the log
    needs the columns of the motion only.
    """
    start, *then = np.searchsorted(
        run_log.time, run_log.number("manoeuvre", "turn_start") + np.array([0.0, *after])
    )
    side = turn_sign(run_log)
    _, course = ground_velocity(run_log)
    x = run_log.signal("position_x_truth_m")
    y = run_log.signal("position_y_truth_m")
    yaw = run_log.signal("yaw_truth_rad")
    outline = car_outline(CarParameters(**run_log.scenario["car"]))[..., None]
    placed = place_outline(outline, x[then] - x[start], y[then] - y[start], yaw[then])
    turned = place_outline(np.array(placed), 0.0, 0.0, -course[start])
    return np.array([turned[0], side * turned[1]])


def swerve_of(run_log: RunLog) -> Swerve:
    """Reads the swerve of a run of the car with ground truth; LogError for a missing column."""
    signal = run_log.signal
    table = run_log.table
    side = turn_sign(run_log)
    speed, course = ground_velocity(run_log)
    contact = {
        part: is_loaded(signal(f"ground_contact_{part}_truth_n"))
        for part in ("cage", "tail", "board")
    }
    touches = np.stack([contact["cage"] | contact["tail"], contact["board"]], axis=1)
    still = np.zeros(len(table))
    tail = dict.fromkeys(("pitch_angle_rad", "roll_angle_rad", "lag"), still)
    torques = np.zeros((len(table), 2))
    power = still
    if run_log.has_tail:
        tail = {name: signal(f"tail_{name}") for name in ("pitch_angle_rad", "roll_angle_rad")}
        tail["lag"] = tail["roll_angle_rad"] - signal("tail_roll_command_position_rad")
        torques = np.stack(
            [signal(f"tail_{joint}_torque_n_m") for joint in ("pitch", "roll")], axis=1
        )
        power = signal("tail_power_truth_w")
    car = CarParameters(**run_log.scenario["car"])
    return Swerve(
        time=run_log.time - run_log.number("manoeuvre", "turn_start"),
        x=signal("position_x_truth_m")[:, None],
        y=side * signal("position_y_truth_m")[:, None],
        heading=side * np.unwrap(signal("yaw_truth_rad"))[:, None],
        course=side * course[:, None],
        speed=speed[:, None],
        yaw_rate=side * signal("gyro_z_truth_rad_per_s")[:, None],
        roll=side * signal("roll_truth_rad")[:, None],
        steering=side * signal("steering_command_rad")[:, None],
        lifts=np.stack([signal(name) for name in LIFT_COLUMNS], axis=1)[..., None],
        heights=np.where(touches, 0.0, np.inf)[..., None],
        tail=np.stack([tail["pitch_angle_rad"], side * tail["roll_angle_rad"]], axis=1)[..., None],
        lag=side * tail["lag"][:, None],
        torques=(torques * [1.0, side])[..., None],
        power=power[:, None],
        flipped=np.array([np.max(signal("tilt_truth_rad")) > FLIP_TILT]),
        com_x=np.array([car.com_x]),
        outline=car_outline(car)[..., None],
    )


def aside(swerve: Swerve, after: float = SOON) -> FloatArray:
    """Returns how far the last point of the outline has moved aside (n,), m, in `after` s."""
    return _last_point(swerve, after) - _last_point(swerve, 0.0)


def _last_point(swerve: Swerve, instant: float) -> FloatArray:
    """Returns how far the outline's point furthest to the right lies to the left (n,), m."""
    origin = swerve.at(swerve.x, instant), swerve.at(swerve.y, instant)
    x, y = place_outline(swerve.outline, *origin, swerve.at(swerve.heading, instant))
    return np.min(swerve.to_the_left(x, y), axis=0)


def centre_aside(swerve: Swerve, after: float = SOON) -> FloatArray:
    """Returns how far the point under the centre of mass has moved aside (n,), m, in `after` s."""
    places = []
    for instant in (0.0, after):
        heading = swerve.at(swerve.heading, instant)
        x = swerve.at(swerve.x, instant) + swerve.com_x * np.cos(heading)
        y = swerve.at(swerve.y, instant) + swerve.com_x * np.sin(heading)
        places.append(swerve.to_the_left(x, y))
    return places[1] - places[0]


def course_change(swerve: Swerve) -> FloatArray:
    """Returns the change of course within `LATER` s of the start of the steering (n,), rad."""
    return swerve.at(swerve.course, LATER) - swerve.at(swerve.course, 0.0)


def sustained(swerve: Swerve) -> FloatArray:
    """Returns the mean lateral acceleration over `SUSTAINED` (n,), m/s2: speed times rate of the
    course.
    """
    first, last = SUSTAINED
    if last > swerve.time[-1] + _ROUNDING:
        return np.full(swerve.com_x.shape, np.nan)
    inside = (swerve.time >= first - _ROUNDING) & (swerve.time <= last + _ROUNDING)
    turned = trapezoid(swerve.speed[inside], swerve.course[inside], axis=0)
    return np.asarray(turned / (last - first))


def energy(swerve: Swerve) -> FloatArray:
    """Returns the positive work of the motors from the start of the steering on (n,), J."""
    inside = swerve.steered
    work = trapezoid(np.maximum(swerve.power[inside], 0.0), swerve.time[inside], axis=0)
    return np.asarray(work)


def max_side_lift(swerve: Swerve) -> FloatArray:
    """Returns the largest `verdict.side_lift` from the start of the steering on (n,), m."""
    return np.asarray(np.max(side_lift(np.moveaxis(swerve.lifts[swerve.steered], 1, 0)), axis=0))


def is_upright(swerve: Swerve) -> BoolArray:
    """Returns which cars stay upright once the steering starts (n,); see `stays_upright`."""
    inside = swerve.steered
    tail, board = np.moveaxis(swerve.heights[inside], 1, 0) <= 0.0
    is_steered = np.abs(swerve.steering[inside]) > STEERED
    touched = np.any(touches_ground(tail, board, is_steered), axis=0)
    return np.asarray(stays_upright(max_side_lift(swerve), touched, swerve.flipped))


def start_deviation(swerve: Swerve) -> FloatArray:
    """Returns how far cars are from a straight start (2, n): the angle from their first heading to
    their course when the steering starts, and their mean yaw rate until then, each over its largest
    value for a car that starts straight.
    """
    first = swerve.heading[0]
    course = swerve.at(swerve.course, 0.0) - first
    yaw_rate = (swerve.at(swerve.heading, 0.0) - first) / -swerve.time[0]
    return np.stack([course / MAX_START_COURSE, yaw_rate / MAX_START_YAW_RATE])


def starts_straight(swerve: Swerve) -> BoolArray:
    """Returns which cars start straight (n,), see `start_deviation`."""
    return np.all(np.abs(start_deviation(swerve)) <= 1.0, axis=0)


def end_yaw_rate(swerve: Swerve) -> FloatArray:
    """Returns the mean yaw rate over the last `LAST` seconds of the run (n,), rad/s."""
    last = swerve.yaw_rate[swerve.time > swerve.time[-1] - LAST]
    return np.asarray(np.mean(last, axis=0))


def swerve_counts(swerve: Swerve) -> BoolArray:
    """Returns which swerves count (n,): those of cars that start straight, stay upright to the end,
    and go straight again there.
    """
    ends_straight = goes_straight(end_yaw_rate(swerve))
    return np.asarray(is_upright(swerve) & starts_straight(swerve) & ends_straight)


def swerve_row(swerve: Swerve) -> Json:
    """Returns the measures of one car for a table; units are at the end of the names."""
    numbers = {
        "aside_soon_m": aside(swerve),
        "aside_later_m": aside(swerve, LATER),
        "centre_aside_soon_m": centre_aside(swerve),
        "centre_aside_later_m": centre_aside(swerve, LATER),
        "course_later_rad": course_change(swerve),
        "sustained_m_per_s2": sustained(swerve),
        "motor_energy_j": energy(swerve),
        "side_lift_m": max_side_lift(swerve),
        "end_yaw_rate_rad_per_s": end_yaw_rate(swerve),
    }
    truths = {
        "counts": swerve_counts(swerve),
        "is_upright": is_upright(swerve),
        "starts_straight": starts_straight(swerve),
    }
    row: Json = {name: float(values[0]) for name, values in numbers.items()}
    return row | {name: bool(values[0]) for name, values in truths.items()}
