"""Limits of the commands to one motor, and the load of its winding."""

import math
from dataclasses import replace

from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.protocol.ak70 import MitCommand
from aerodima.workbench.car.laws import pd_torque
from aerodima.workbench.core.errors import HardwareError

FADE = 0.2
"""Fraction of the budget over which the torque is taken back."""


def check_command(command: MitCommand) -> None:
    """Raises `HardwareError` for NaN, infinity and negative gains: no limit makes sense of them."""
    if not all(map(math.isfinite, vars(command).values())):
        raise HardwareError(f"{command}: must be finite")
    if command.kp < 0 or command.kd < 0:
        raise HardwareError(f"{command}: gains must not be negative")


def commanded_torque(command: MitCommand, position: float, speed: float) -> float:
    """Returns the torque (N m) that a command asks for at `position` (rad) and `speed` (rad/s)."""
    torque: float = pd_torque(
        position,
        speed,
        command.position,
        command.velocity,
        command.kp,
        command.kd,
        command.torque,
    )
    return torque


def limit_command(
    command: MitCommand,
    position: float,
    speed: float,
    settings: MotorSettings,
    max_torque: float | None = None,
) -> MitCommand:
    """Limits a command to range, speed and gains, and to the allowed total torque at the measured
    state.

    At an end of the range, no velocity and no torque leads further out. A torque beyond the limit
    is reached by scaling kp, kd and torque alike: the balance of the loop stays, and the torque
    falls as the error does.

    Args:
        command: command in joint coordinates that `check_command` has passed.
        position: measured angle of the joint, rad.
        speed: measured speed of the joint, rad/s.
        settings: settings of the motor.
        max_torque: torque that is allowed now, N m; the settings' limit when None.
    """
    limit = settings.torque_limit if max_torque is None else max_torque
    velocity = clip(command.velocity, settings.safety.speed_limit)
    torque = clip(command.torque, limit)
    if position >= settings.high:
        velocity = min(velocity, 0.0)
        torque = min(torque, 0.0)
    elif position <= settings.low:
        velocity = max(velocity, 0.0)
        torque = max(torque, 0.0)
    limited = MitCommand(
        position=min(max(command.position, settings.low), settings.high),
        velocity=velocity,
        kp=min(command.kp, settings.kp_max),
        kd=min(command.kd, settings.kd_max),
        torque=torque,
    )
    total = abs(commanded_torque(limited, position, speed))
    if total <= limit:
        return limited
    return scale_gains(limited, limit / total)


def scale_gains(command: MitCommand, factor: float) -> MitCommand:
    """Multiplies kp, kd and torque of a command by `factor`."""
    return replace(
        command, kp=command.kp * factor, kd=command.kd * factor, torque=command.torque * factor
    )


def to_motor(command: MitCommand, settings: MotorSettings) -> MitCommand:
    """Converts a command of the joint to the motor's own angle and signs."""
    return replace(
        command,
        position=settings.motor_angle(command.position),
        velocity=settings.direction * command.velocity,
        torque=settings.direction * command.torque,
    )


def clip(value: float, limit: float) -> float:
    """Limits a value to `limit` on either side of 0."""
    return min(max(value, -limit), limit)


class MotorLoad:
    """Thermal load (I2t) of the winding of one motor.

    Args:
        rated: torque that the winding bears indefinitely, N m.
        budget: load above the rated torque that it bears, (N m)^2 s.

    Attributes:
        used: part of the budget that is used, (N m)^2 s, at least 0.
    """

    def __init__(self, rated: float, budget: float) -> None:
        self._rated = rated
        self._budget = budget
        self._time = math.inf
        self.used = 0.0

    def add(self, torque: float, now: float) -> None:
        """Adds a measured torque (N m) at `now`, s."""
        span = max(0.0, now - self._time)
        self.used = max(0.0, self.used + (torque * torque - self._rated * self._rated) * span)
        self._time = now

    @property
    def share(self) -> float:
        """Fraction of the budget that is used; beyond 1 the motor does not obey."""
        return self.used / self._budget

    def allowed(self, peak: float) -> float:
        """Returns the torque that the motor may make now (N m), at most `peak`."""
        rated = min(self._rated, peak)
        return rated + min(1.0, max(0.0, (1.0 - self.share) / FADE)) * (peak - rated)
