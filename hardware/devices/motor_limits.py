"""What is left of a command after the limits: pure functions, joint coordinates."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.protocol.ak70 import MitCommand
from aerodima.workbench.errors import HardwareError


def check_command(command: MitCommand) -> None:
    """Raises `HardwareError` for NaN, infinity and negative gains: no limit makes sense of them."""
    if not all(math.isfinite(value) for value in astuple(command)):
        raise HardwareError(f"{command}: must be finite")
    if command.kp < 0 or command.kd < 0:
        raise HardwareError(f"{command}: gains must not be negative")


def pd_torque(command: MitCommand, position: float, speed: float) -> float:
    """Torque (N m) that the motor's loop makes of a command at `position` (rad) and `speed` (rad/s)."""
    return command.kp * (command.position - position) + command.kd * (command.velocity - speed) + command.torque


def limit_command(
    command: MitCommand, position: float, speed: float, settings: MotorSettings, most: float | None = None
) -> MitCommand:
    """The command within range, speed and gains, and with at most the allowed total torque at the measured state.

    At an end of the range, no velocity and no torque leads further out. A torque beyond the limit is reached by scaling
    kp, kd and torque alike: the balance of the loop stays, and the torque falls as the error does.

    Args:
        command: joint coordinates, checked.
        position, speed: of the joint as measured, rad and rad/s.
        most: torque that is allowed now, N m; the settings' limit when None.
    """
    most = settings.torque_limit if most is None else most
    velocity = _clip(command.velocity, settings.safety.speed_limit)
    torque = _clip(command.torque, most)
    if position >= settings.high:
        velocity, torque = min(velocity, 0.0), min(torque, 0.0)
    elif position <= settings.low:
        velocity, torque = max(velocity, 0.0), max(torque, 0.0)
    limited = MitCommand(
        position=min(max(command.position, settings.low), settings.high),
        velocity=velocity,
        kp=min(command.kp, settings.kp_max),
        kd=min(command.kd, settings.kd_max),
        torque=torque,
    )
    total = abs(pd_torque(limited, position, speed))
    return limited if total <= most else scale_gains(limited, most / total)


def scale_gains(command: MitCommand, factor: float) -> MitCommand:
    """The command with kp, kd and torque times `factor`."""
    return replace(command, kp=command.kp * factor, kd=command.kd * factor, torque=command.torque * factor)


def to_motor(command: MitCommand, settings: MotorSettings) -> MitCommand:
    """A command of the joint in the motor's own angle and signs."""
    return replace(
        command,
        position=settings.motor_angle(command.position),
        velocity=settings.direction * command.velocity,
        torque=settings.direction * command.torque,
    )


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
