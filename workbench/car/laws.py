"""The laws of motors, servo, joints and wheels as functions of numbers.

Each is the only statement of its law: the systems of the plant, the reduced cars, the rig and the
hardware call it. Those whose arguments are `Any` take floats or arrays that broadcast. Torques are
positive along the axis of their joint.
"""

import math
from collections.abc import Sequence
from typing import Any

from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.elementwise import clip, maximum, minimum, tanh
from aerodima.workbench.scenario.car_parameters import (
    CarParameters,
    DriveParameters,
    ServoParameters,
)
from aerodima.workbench.scenario.tail_parameters import TailMotorParameters

ROLLING_RATE = 1.0
"""Rate (rad/s) of a wheel over which its rolling resistance is rounded off."""
FRAME_TOLERANCE = 1e-4
"""Share of a servo frame; a step that falls on the start of a frame up to rounding has begun it."""
NOW = (0.0, 1.0, 0.0)
"""Step of length 0, with which a law holds at the present instant."""


def pd_torque(
    angle: Any,
    rate: Any,
    target: Any,
    target_rate: Any,
    kp: Any,
    kd: Any,
    feedforward: Any = 0.0,
) -> Any:
    """Returns the torque (N m) that a motor in MIT mode is asked for, before any limit.

    tau = kp (q_d - q) + kd (qd_d - qd) + tau_ff; design section 6, manual of the AK70-10.

    Args:
        angle: joint angle q, rad.
        rate: joint rate qd, rad/s.
        target: target angle q_d, rad.
        target_rate: target rate qd_d, rad/s.
        kp: gain on the angle, N m/rad.
        kd: gain on the rate, N m s/rad.
        feedforward: feed-forward torque tau_ff, N m.
    """
    return kp * (target - angle) + kd * (target_rate - rate) + feedforward


def torque_bounds(
    rate: Any, torque_limit: Any, stall_torque: Any, no_load_speed: Any
) -> tuple[Any, Any]:
    """Returns the least and the largest torque (N m) of a motor at a rate.

    They are the peak torque and the torque-speed line tau_stall (1 - qd / qd_0) of an ideal DC
    machine: near the no-load speed the motor cannot push further, braking stays possible (design
    section 6).

    Args:
        rate: rate qd of the output, rad/s.
        torque_limit: peak torque, N m.
        stall_torque: stall torque tau_stall, N m.
        no_load_speed: no-load speed qd_0, rad/s.
    """
    speed_ratio = rate / no_load_speed
    forwards = maximum(0.0, stall_torque * (1.0 - speed_ratio))
    backwards = maximum(0.0, stall_torque * (1.0 + speed_ratio))
    return -minimum(torque_limit, backwards), minimum(torque_limit, forwards)


def joint_friction(rate: Any, coulomb: Any, viscous: Any, tanh_gain: Any) -> Any:
    """Returns the friction torque (N m) on a joint of the tail, against its rate.

    tau = -(Cf tanh(k qd) + Vf qd): thesis eq. 4.12 with the sign of ERRATA E14 and E15, where k is
    10 s/rad. Drake's joints have no Coulomb friction (design section 6).

    Args:
        rate: joint rate qd, rad/s.
        coulomb: Coulomb friction Cf, N m.
        viscous: viscous friction Vf, N m s/rad.
        tanh_gain: gain k inside the tanh, s/rad.
    """
    return -(coulomb * tanh(tanh_gain * rate) + viscous * rate)


def governor_torque(target_speed: Any, shaft_speed: Any, gain: Any, loss: Any, limit: Any) -> Any:
    """Returns the drive's torque (N m) on the shaft of the differential.

    tau = clip(k (w_d - w) + tau_loss, -limit, limit): the drive carries the rolling resistance of
    the wheels (design section 6).

    Args:
        target_speed: target speed w_d of the shaft, rad/s, positive forward.
        shaft_speed: speed w of the shaft, rad/s.
        gain: gain k, N m s/rad.
        loss: rolling resistance tau_loss of all wheels, N m, positive on a car that rolls forward.
        limit: largest torque of the drive, N m.
    """
    return clip(gain * (target_speed - shaft_speed) + loss, -limit, limit)


def rolling_resistance(rate: Any, torque: Any) -> Any:
    """Returns the torque (N m) of the ground against the rolling of a wheel.

    tau = -tau_0 tanh(w / `ROLLING_RATE`); design section 6.

    Args:
        rate: rate w of the wheel about its axle, rad/s.
        torque: torque tau_0 against a wheel that rolls, N m.
    """
    return -torque * tanh(rate / ROLLING_RATE)


def steady_speed(throttle: float, drive: DriveParameters) -> float:
    """Returns the speed (m/s) for a throttle in -1..1: the fitted line, mirrored for reverse, zero
    inside its dead band.

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
    """Returns the torque per shaft-speed error, N m s/rad: the governor's, or the motor's own from
    the car's speed response.
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
    """Returns the torque (N m) on the differential's shaft, by `governor_torque`.

    The throttle sets the target through the line of section 6.2. With governor k is stiff, so the
    wheel speed is held through the turn; without, k is the slope of the motor's torque-speed line
    and the speed droops with load. The line is that of the rolling car, so the drive carries its
    rolling resistance; at throttle 0 it is off. NaN counts as throttle 0; beyond +-1 is clipped.

    Args:
        throttle: throttle, -1..1.
        shaft_speed: speed of the shaft, rad/s, positive forward.
        drive: parameters of the drive: throttle line and torque limit.
        gain: gain k, N m s/rad, from `shaft_gain`.
        radius: radius at which the loaded rear tyres roll, m.
        loss: rolling resistance of all wheels, N m.
    """
    if throttle != throttle or throttle == 0.0:
        return 0.0
    target = steady_speed(clip(throttle, -1.0, 1.0), drive) / radius
    return governor_torque(target, shaft_speed, gain, loss, drive.torque_limit)


def ackermann(steering_angle: float, wheelbase: float, track: float) -> Pair:
    """Returns the angles (rad) of the left and right front wheel, positive to the left, that roll
    about one centre of turn.

    `steering_angle` is that of the wheel in the middle of the kinematic bicycle.
    """
    tangent = math.tan(steering_angle)
    half = 0.5 * track / wheelbase * tangent
    return math.atan2(tangent, 1.0 - half), math.atan2(tangent, 1.0 + half)


def steering_motion(frame: Sequence[float], time: float, rate: float) -> Pair:
    """Returns the bicycle steering angle, rad, and its rate, rad/s, at `time` s.

    Args:
        frame: start of the frame, s, angle at that time, rad, and angle that the servo moves to,
            rad.
        time: instant within the frame, s.
        rate: rate of the servo, rad/s.
    """
    begin, start, target = frame
    travel = rate * (time - begin)
    angle = clip(target, start - travel, start + travel)
    if angle == target:
        return angle, 0.0
    return angle, math.copysign(rate, target - start)


def servo_frame(
    last: Sequence[float] | None, time: float, command: float, servo: ServoParameters
) -> Sequence[float]:
    """Returns the servo's frame at `time` s, as `steering_motion` reads it.

    The servo reads its command once per frame and moves towards it at its rate; 30 degrees take
    0.14 s (thesis 7.1.1). The command is clipped to the servo's limit; NaN holds the last angle.

    Args:
        last: frame of the step before; None at the first step, at which the wheels stand
            straight.
        time: time of a step of the plant, s.
        command: commanded bicycle steering angle at that time, rad, positive to the left.
        servo: parameters of the servo: rate, limit and frame rate.
    """
    begin = math.floor(time * servo.frame_rate + FRAME_TOLERANCE) / servo.frame_rate
    if last is not None and begin <= last[0]:
        return last
    angle, _ = steering_motion(last or (0.0, 0.0, 0.0), begin, servo.rate)
    if math.isnan(command):
        target = angle
    else:
        target = clip(command, -servo.limit, servo.limit)
    return begin, angle, target


def knuckle_motion(
    angle: float, rate: float, servo: ServoParameters, car: CarParameters
) -> tuple[float, float, float, float]:
    """Returns angles (rad) and rates (rad/s) of left and right front wheel, from angle and rate of
    the bicycle's wheel.
    """
    if servo.linkage == "parallel":
        return angle, angle, rate, rate
    left, right = ackermann(angle, car.wheelbase, car.track)
    tangent = math.tan(angle)
    half = 0.5 * car.track / car.wheelbase
    turning = rate * (1.0 + tangent**2)
    inner = 1.0 - half * tangent
    outer = 1.0 + half * tangent
    return left, right, turning / (inner**2 + tangent**2), turning / (outer**2 + tangent**2)


def torque_speed_limits(motor: TailMotorParameters) -> Pair:
    """Returns stall torque (N m) and no-load speed (rad/s) at the output, from the pack voltage.

    Ideal DC machine: the torque constant in N m/A equals 1/speed_constant in SI units.
    """
    no_load_speed = motor.pack_voltage * motor.speed_constant / motor.gear_ratio
    stall_torque = (
        motor.pack_voltage / motor.winding_resistance / motor.speed_constant * motor.gear_ratio
    )
    return stall_torque, no_load_speed


def mit_torque(
    position: float,
    speed: float,
    command: Sequence[float],
    motor: TailMotorParameters,
    line: Pair,
    ahead: tuple[float, float, float] = NOW,
) -> float:
    """Returns the torque (N m) of one motor in MIT mode, positive along the joint axis.

    tau = kp (q_d - q) + kd (qd_d - qd) + tau_ff with gains clipped to the frame's range, all of it
    wrong by the error of the torque constant, then held inside the peak torque and the torque-speed
    line: near the no-load speed the motor cannot push further, braking stays possible.

    The firmware closes this loop at kHz, the plant steps at 2 ms: damping that acts on the rate of
    the beginning of a step would push a light joint back and forth (kd h / I > 2 for the pitch
    joint of a tail that lies sideways). So angle and rate are those of the end of the step, q + h v
    and v = qd + (tau + load) h / I, solved for tau.

    Args:
        position: joint angle, rad.
        speed: joint rate, rad/s.
        command: q_d rad, qd_d rad/s, kp N m/rad, kd N m s/rad, tau_ff N m.
        motor: parameters of the motor: limits, and error of its torque constant.
        line: stall torque, N m, and no-load speed, rad/s, from `torque_speed_limits`.
        ahead: length of the plant's step, s, inertia of the joint with the reflected rotor, kg m2,
            and torque on it from all but its motor, N m; by default the law holds at this instant.
    """
    target, target_rate, kp, kd, feedforward = command
    scale = 1.0 + motor.torque_error
    kp = scale * clip(kp, 0.0, motor.kp_max)
    kd = scale * clip(kd, 0.0, motor.kd_max)
    step, inertia, load = ahead
    coasting = speed + step * load / inertia
    torque = pd_torque(  # angles are counted from the present one
        step * coasting, coasting, target - position, target_rate, kp, kd, scale * feedforward
    )
    torque /= 1.0 + step * (kd + step * kp) / inertia
    lower, upper = torque_bounds(speed, motor.torque_limit, *line)
    return clip(torque, lower, upper)
