"""Brushless drive on the rear differential; steering servo with its linkage (design section 6)."""

import math
from collections.abc import Sequence

from aerodima.workbench.scenario.car_parameters import (
    CarParameters,
    DriveParameters,
    ServoParameters,
)

FRAME_TOLERANCE = 1e-4
"""Of a frame of the servo; a step that falls on its begin up to rounding has it begun."""


def steady_speed(throttle: float, drive: DriveParameters) -> float:
    """Speed (m/s) for a throttle in -1..1: the fitted line, mirrored for reverse, zero inside its
    dead band.

    Without governor the motor does not overcome its load below `breakaway_throttle` (thesis 6.2).
    """
    if not drive.governor and abs(throttle) < drive.breakaway_throttle:
        return 0.0
    forward = max(0.0, drive.throttle_gain * abs(throttle) + drive.throttle_offset)
    if throttle > 0:
        return forward
    if throttle < 0:
        return -forward
    return 0.0


def shaft_gain(drive: DriveParameters, car: CarParameters) -> float:
    """Torque per shaft-speed error, N m s/rad: the governor's, or the motor's own from the car's
    speed response.
    """
    if drive.governor:
        return drive.governor_gain
    return (car.mass * car.tyre_radius**2 + drive.rotor_inertia) / drive.time_constant


def shaft_torque(
    throttle: float,
    shaft_speed: float,
    drive: DriveParameters,
    gain: float,
    radius: float,
    loss: float = 0.0,
) -> float:
    """Torque (N m) on the differential's shaft: clip(k (w_target - w) + loss, +-limit).

    The throttle sets the target through the line of section 6.2. With governor k is stiff, so the
    wheel speed is held through the turn; without, k is the slope of the motor's torque-speed line
    and the speed droops with load. The line is that of the rolling car, so the drive carries its
    rolling resistance; at throttle 0 it is off. NaN counts as throttle 0; beyond +-1 is clipped.

    Args:
        throttle: -1..1.
        shaft_speed: rad/s, positive forward.
        drive: line, torque limit.
        gain: k, N m s/rad, from `shaft_gain`.
        radius: m, of the loaded rear tyres as they roll.
        loss: rolling resistance of all wheels, N m.
    """
    if throttle != throttle or throttle == 0.0:
        return 0.0
    target = steady_speed(min(max(throttle, -1.0), 1.0), drive) / radius
    limit = drive.torque_limit
    return min(max(gain * (target - shaft_speed) + loss, -limit), limit)


def ackermann(steering_angle: float, wheelbase: float, track: float) -> tuple[float, float]:
    """Angles (rad) of the left and right front wheel, positive to the left, that roll about one
    centre of turn.

    `steering_angle` is that of the wheel in the middle of the kinematic bicycle.
    """
    tangent = math.tan(steering_angle)
    half = 0.5 * track / wheelbase * tangent
    return math.atan2(tangent, 1.0 - half), math.atan2(tangent, 1.0 + half)


def knuckle_angles(
    steering_angle: float, servo: ServoParameters, car: CarParameters
) -> tuple[float, float]:
    """Angles (rad) of the left and right front wheel for a steering angle, by the linkage."""
    if servo.linkage == "parallel":
        return steering_angle, steering_angle
    return ackermann(steering_angle, car.wheelbase, car.track)


def steering_motion(frame: Sequence[float], time: float, rate: float) -> tuple[float, float]:
    """Bicycle steering angle, rad, and its rate, rad/s, at `time` s.

    Args:
        frame: begin s, angle at that time rad, angle rad that the servo moves to.
        time: s.
        rate: of the servo, rad/s.
    """
    begin, start, target = frame
    travel = rate * (time - begin)
    if abs(target - start) <= travel:
        return target, 0.0
    side = 1.0 if target > start else -1.0
    return start + side * travel, side * rate


def servo_frame(
    last: Sequence[float] | None, time: float, command: float, servo: ServoParameters
) -> Sequence[float]:
    """What the servo does at `time` s, as `steering_motion` reads it.

    The servo reads its command once per frame and moves towards it at its rate; 30 degrees take
    0.14 s (thesis 7.1.1). The command is clipped to the servo's limit; NaN holds the last angle.

    Args:
        last: the frame of a step before; None at the first step, at which the wheels stand
            straight.
        time: of a step of the plant, s.
        command: bicycle steering angle at that time, rad, positive to the left.
        servo: rate, limit, frame rate.
    """
    begin = math.floor(time * servo.frame_rate + FRAME_TOLERANCE) / servo.frame_rate
    if last is not None and begin <= last[0]:
        return last
    angle, _ = steering_motion(last or (0.0, 0.0, 0.0), begin, servo.rate)
    return (
        begin,
        angle,
        angle if math.isnan(command) else min(max(command, -servo.limit), servo.limit),
    )


def knuckle_motion(
    angle: float, rate: float, servo: ServoParameters, car: CarParameters
) -> tuple[float, float, float, float]:
    """Angles (rad) and rates (rad/s) of left and right front wheel, for those of the bicycle."""
    left, right = knuckle_angles(angle, servo, car)
    if servo.linkage == "parallel":
        return left, right, rate, rate
    tangent = math.tan(angle)
    half = 0.5 * car.track / car.wheelbase
    turning = rate * (1.0 + tangent**2)
    inner = 1.0 - half * tangent
    outer = 1.0 + half * tangent
    return left, right, turning / (inner**2 + tangent**2), turning / (outer**2 + tangent**2)
