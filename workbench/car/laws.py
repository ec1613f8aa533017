"""The laws of motors, servo, joints and wheels as functions of numbers.

Each takes floats or arrays that broadcast, and is the only home of its law: the systems of the
plant, the reduced cars, the rig and the hardware call it. Torques are positive along the axis of
their joint.
"""

from __future__ import annotations

from typing import Any

from aerodima.workbench.core.elementwise import clip, maximum, minimum, tanh

ROLLING_RATE = 1.0
"""Rate (rad/s) of a wheel over which its rolling resistance is rounded off."""


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
        angle: q of the joint, rad.
        rate: qd, rad/s.
        target: q_d, rad.
        target_rate: qd_d, rad/s.
        kp: N m/rad.
        kd: N m s/rad.
        feedforward: tau_ff, N m.
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
        rate: qd of the output, rad/s.
        torque_limit: peak torque, N m.
        stall_torque: tau_stall, N m.
        no_load_speed: qd_0, rad/s.
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
        rate: qd, rad/s.
        coulomb: Cf, N m.
        viscous: Vf, N m s/rad.
        tanh_gain: k, s/rad.
    """
    return -(coulomb * tanh(tanh_gain * rate) + viscous * rate)


def governor_torque(target_speed: Any, shaft_speed: Any, gain: Any, loss: Any, limit: Any) -> Any:
    """Returns the drive's torque (N m) on the shaft of the differential.

    tau = clip(k (w_d - w) + tau_loss, -limit, limit): the drive carries the rolling resistance of
    the wheels (design section 6).

    Args:
        target_speed: w_d, rad/s, positive forward.
        shaft_speed: w, rad/s.
        gain: k, N m s/rad.
        loss: tau_loss, rolling resistance of all wheels, N m, positive on a car that rolls forward.
        limit: N m.
    """
    return clip(gain * (target_speed - shaft_speed) + loss, -limit, limit)


def rolling_resistance(rate: Any, torque: Any) -> Any:
    """Returns the torque (N m) of the ground against the rolling of a wheel.

    tau = -tau_0 tanh(w / `ROLLING_RATE`); design section 6.

    Args:
        rate: w of the wheel about its axle, rad/s.
        torque: tau_0, N m, of a wheel that rolls.
    """
    return -torque * tanh(rate / ROLLING_RATE)


def servo_step(angle: Any, command: Any, travel: Any) -> Any:
    """Returns the servo's angle (rad) after it has moved towards the command by at most `travel`.

    Args:
        angle: where the servo stands, rad.
        command: where it moves to, rad.
        travel: rate of the servo times the time that passes, rad.
    """
    return clip(command, angle - travel, angle + travel)
