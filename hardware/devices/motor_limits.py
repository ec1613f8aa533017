"""What one motor may do and whether it does it: limits of a command, I2t of its winding, following, count of replies.

Joint coordinates; times in s, monotonic.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import astuple, replace

from aerodima.hardware.devices.motor_settings import MotorSafety, MotorSettings
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


FADE = 0.2
"""Share of the budget over which the torque is taken back."""


class MotorLoad:
    """Load of one motor.

    Args:
        rated: torque that it bears for ever, N m.
        budget: (N m)^2 s above that.

    Attributes:
        used: (N m)^2 s, at least 0.
    """

    def __init__(self, rated: float, budget: float) -> None:
        self._rated, self._budget = rated, budget
        self._time: float | None = None
        self.used = 0.0

    def add(self, torque: float, now: float) -> None:
        """Takes a measured torque (N m) at `now`, s."""
        span = 0.0 if self._time is None else max(0.0, now - self._time)
        self.used = max(0.0, self.used + (torque * torque - self._rated * self._rated) * span)
        self._time = now

    @property
    def share(self) -> float:
        """Of the budget that is used; beyond 1 the motor does not obey."""
        return self.used / self._budget

    def allowed(self, peak: float) -> float:
        """Torque that it may make now (N m), of at most `peak`."""
        rated = min(self._rated, peak)
        return rated + min(1.0, max(0.0, (1.0 - self.share) / FADE)) * (peak - rated)


class Lasting:
    """For how long something has been so, s."""

    def __init__(self) -> None:
        self._since: float | None = None

    def look(self, is_so: bool, now: float) -> float:
        """Takes whether it is so at `now`; the time, 0 while it is not."""
        self._since = (now if self._since is None else self._since) if is_so else None
        return 0.0 if self._since is None else now - self._since


class Following:
    """One motor, looked at with every reply. Joint coordinates."""

    def __init__(self, safety: MotorSafety) -> None:
        self._safety = safety
        self._weak, self._behind = Lasting(), Lasting()

    def look(self, asked: MitCommand | None, position: float, speed: float, torque: float, now: float) -> str:
        """Why the motor does not follow, in words; empty while it does.

        Args:
            asked: the command that was sent last; None while nothing is asked of it.
            position, speed, torque: as measured at `now` (s, monotonic), rad, rad/s, N m.
        """
        if asked is None:
            self._weak.look(False, now)
            self._behind.look(False, now)
            return ""
        safety = self._safety
        wanted = pd_torque(asked, position, speed)
        delivered = torque if wanted >= 0 else -torque
        weak = abs(wanted) > safety.follow_torque and delivered < safety.follow_share * abs(wanted)
        weak_for = self._weak.look(weak, now)
        error = asked.position - position
        behind = asked.kp > 0 and abs(error) > safety.tracking_error and error * speed <= 0.0
        behind_for = self._behind.look(behind, now)
        if weak_for >= safety.follow_time:
            return f"does not follow: {torque:.1f} N m reported where {wanted:.1f} are commanded; is it off?"
        if behind_for >= safety.tracking_time:
            return f"does not follow: {error:+.2f} rad from its command; allowed is {safety.tracking_error:g}"
        return ""


MOST_EXTRA = 2
"""Replies too many, in cycles in a row, that may still be chance."""


class ReplyCount:
    """Frames to one motor that are still to be answered, and the replies that answer none of them.

    A computer that is held up sends late and reads late: several replies in one cycle are none too many while as many
    frames are owed. A frame that has no answer after `memory` was lost.

    Args:
        memory: s.

    Attributes:
        extra: replies too many, in cycles in a row.
    """

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._owed: deque[list[float]] = deque()
        self.extra = 0

    def clear(self) -> None:
        """Forgets everything: the motor is switched on anew."""
        self._owed.clear()
        self.extra = 0

    @property
    def too_many(self) -> bool:
        """Whether a second motor answers."""
        return self.extra > MOST_EXTRA

    def add(self, frames: int, replies: int, now: float) -> None:
        """Takes what went out and what came back in a cycle that ends at `now`, s."""
        while self._owed and now - self._owed[0][0] > self._memory:
            self._owed.popleft()
        if frames:
            self._owed.append([now, frames])
        while replies and self._owed:
            paid = min(replies, int(self._owed[0][1]))
            replies -= paid
            self._owed[0][1] -= paid
            if not self._owed[0][1]:
                self._owed.popleft()
        if frames:  # without frames of its own a motor may still be asked by the Teensy, which repeats its last order
            self.extra = self.extra + replies if replies else 0
