"""Settings and limits of a tail motor: what it can do, where it may go, when it is switched off."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from typing import Any

from aerodima.hardware.protocol.ak70 import MOST_ID, FirmwareProfile, MitCommand, check_motor_id
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario_file import load_section
from aerodima.workbench.scenario.tail_parameters import TailMotorParameters

FADE = 0.2
"""Share of the budget over which the torque is taken back."""
_RECENT = 0.015
"""s before a reply in which the command acted that its torque belongs to: at 100 Hz one of the last
three. A reply is made before the command that it answers acts."""
MOST_EXTRA = 2
"""Replies too many, in cycles in a row, that may still be chance."""


def check_command(command: MitCommand) -> None:
    """Raises `HardwareError` for NaN, infinity and negative gains: no limit makes sense of them."""
    if not all(math.isfinite(value) for value in astuple(command)):
        raise HardwareError(f"{command}: must be finite")
    if command.kp < 0 or command.kd < 0:
        raise HardwareError(f"{command}: gains must not be negative")


def pd_torque(command: MitCommand, position: float, speed: float) -> float:
    """Torque (N m) that the motor makes of a command at `position` (rad) and `speed` (rad/s)."""
    return (
        command.kp * (command.position - position)
        + command.kd * (command.velocity - speed)
        + command.torque
    )


def limit_command(
    command: MitCommand,
    position: float,
    speed: float,
    settings: MotorSettings,
    most: float | None = None,
) -> MitCommand:
    """The command within range, speed and gains, and with at most the allowed total torque at the
    measured state.

    At an end of the range, no velocity and no torque leads further out. A torque beyond the limit
    is reached by scaling kp, kd and torque alike: the balance of the loop stays, and the torque
    falls as the error does.

    Args:
        command: joint coordinates, checked.
        position, speed: of the joint as measured, rad and rad/s.
        most: torque that is allowed now, N m; the settings' limit when None.
    """
    most = settings.torque_limit if most is None else most
    velocity = _clip(command.velocity, settings.safety.speed_limit)
    torque = _clip(command.torque, most)
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
    total = abs(pd_torque(limited, position, speed))
    if total <= most:
        return limited
    return scale_gains(limited, most / total)


def scale_gains(command: MitCommand, factor: float) -> MitCommand:
    """The command with kp, kd and torque times `factor`."""
    return replace(
        command, kp=command.kp * factor, kd=command.kd * factor, torque=command.torque * factor
    )


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


class MotorLoad:
    """Load of one motor.

    Args:
        rated: torque that it bears for ever, N m.
        budget: (N m)^2 s above that.

    Attributes:
        used: (N m)^2 s, at least 0.
    """

    def __init__(self, rated: float, budget: float) -> None:
        self._rated = rated
        self._budget = budget
        self._time: float | None = None
        self.used = 0.0

    def add(self, torque: float, now: float) -> None:
        """Takes a measured torque (N m) at `now`, s."""
        if self._time is None:
            span = 0.0
        else:
            span = max(0.0, now - self._time)
        self.used = max(0.0, self.used + (torque * torque - self._rated * self._rated) * span)
        self._time = now

    @property
    def share(self) -> float:
        """Share of the budget that is used; beyond 1 the motor does not obey."""
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
        if not is_so:
            self._since = None
            return 0.0
        if self._since is None:
            self._since = now
        return now - self._since


class Following:
    """One motor, looked at with every reply. Joint coordinates.

    The torque of a reply must belong to one of the newest commands, at the angle and rate of the
    reply itself: no mass, no weight and no air is needed to tell. One that belongs to none of them
    is old, or frozen, however punctual it is. Nothing tells the age of a reply while the command
    does not change.
    """

    def __init__(self, safety: MotorSafety) -> None:
        self._safety = safety
        self._weak = Lasting()
        self._behind = Lasting()
        self._recent: deque[tuple[float, MitCommand]] = deque()
        self._strange = 0

    def look(
        self, asked: MitCommand | None, position: float, speed: float, torque: float, now: float
    ) -> str:
        """Why the motor does not follow, in words; empty while it does.

        Args:
            asked: the command that was sent last; None before the first one.
            position, speed, torque: as measured at `now` (s, monotonic), rad, rad/s, N m.
        """
        if asked is None:
            self._weak.look(False, now)
            self._behind.look(False, now)
            self._recent.clear()
            self._strange = 0
            return ""
        safety = self._safety
        if not self._recent or asked is not self._recent[-1][1]:
            self._recent.append((now, asked))
        while len(self._recent) > 1 and self._recent[1][0] <= now - _RECENT:
            self._recent.popleft()
        torques = [pd_torque(command, position, speed) for _, command in self._recent]
        wanted = min(torques, key=abs)
        delivered = torque if wanted >= 0 else -torque
        weak = abs(wanted) > safety.follow_torque and delivered < safety.follow_share * abs(wanted)
        weak_for = self._weak.look(weak, now)
        error = asked.position - position
        behind = asked.kp > 0 and abs(error) > safety.tracking_error and error * speed <= 0.0
        behind_for = self._behind.look(behind, now)
        least, most = self._believable(min(torques), max(torques))
        if least <= torque <= most:
            self._strange = 0
        else:
            self._strange += 1
        if self._strange >= safety.strange_replies:
            asks = f"{min(torques):.1f} to {max(torques):.1f}"
            why = "is it off, or are its replies old?"
            return f"does not follow: {torque:.1f} N m reported where {asks} are commanded; {why}"
        if weak_for >= safety.follow_time:
            return (
                f"does not follow: {torque:.1f} N m reported where {wanted:.1f} are commanded; "
                "is it off?"
            )
        if behind_for >= safety.tracking_time:
            return (
                f"does not follow: {error:+.2f} rad from its command; allowed is "
                f"{safety.tracking_error:g}"
            )
        return ""

    def _believable(self, least: float, most: float) -> tuple[float, float]:
        """Torques that a motor may report which is asked for `least` to `most`, N m."""
        safety = self._safety
        share = safety.torque_share
        more = 2.0 - safety.torque_share
        return (
            min(share * least, more * least) - safety.torque_margin,
            max(share * most, more * most) + safety.torque_margin,
        )


class ReplyCount:
    """Frames to one motor that are still to be answered, and the replies that answer none of them.

    A computer that is held up sends late and reads late: several replies in one cycle are none too
    many while as many frames are owed. A frame that has no answer after `memory` was lost.

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
        # without frames of its own a motor may still be asked by the Teensy, which repeats its last
        # order
        if frames:
            if replies:
                self.extra += replies
            else:
                self.extra = 0


class MotorSafety(QuantityModel):
    """When a motor is switched off by the computer, and how gently it is taken over."""

    speed_limit: float = quantity(
        "rad/s", "largest speed, commanded (clipped) and measured (fault)", gt=0, le=50
    )
    rated_torque: float = quantity("N m", "torque that the winding bears for ever", gt=0, le=50)
    overload: float = quantity(
        "N2 m2 s", "square of the torque above the rated one, over time", gt=0, le=1e5
    )
    overload_share: float = quantity("1", "of that at which the motor is switched off", gt=0, le=1)
    follow_torque: float = quantity(
        "N m", "commanded, from which the reported one is compared with it", gt=0, le=25
    )
    follow_share: float = quantity("1", "of the commanded torque that must be reported", gt=0, le=1)
    follow_time: float = quantity(
        "s", "with less, after which the motor counts as not following", gt=0, le=1
    )
    torque_share: float = quantity(
        "1", "of a command's torque, down or up, that belongs to it", gt=0, le=1
    )
    torque_margin: float = quantity(
        "N m", "beyond these shares, of a torque that belongs to a command", gt=0, le=5
    )
    strange_replies: int = quantity(
        "1", "replies in a row with a torque that belongs to no command", ge=1, le=100
    )
    tracking_error: float = quantity("rad", "between commanded and measured position", gt=0, le=3.2)
    tracking_time: float = quantity(
        "s", "beyond that error, not approaching, after which it counts", gt=0, le=5
    )
    temperature_limit: float = quantity("degC", "warmest reading", gt=0, le=150)
    range_margin: float = quantity(
        "rad", "how far beyond its range a joint may be measured", ge=0, le=1
    )
    jump_margin: float = quantity(
        "rad", "how much more than its speed allows a reading may change", ge=0, le=1
    )
    ramp_speed: float = quantity(
        "rad/s", "of the way from the measured position to the first command", gt=0, le=10
    )
    gain_ramp: float = quantity("s", "in which the gains come on", gt=0, le=5)
    missed_replies: int = quantity("1", "cycles in a row without a reply", ge=1, le=100)
    reply_time: float = quantity(
        "s", "in which a motor answers; shorter cycles are never missed", ge=0, le=0.1
    )
    enter_replies: int = quantity(
        "1", "replies to the neutral command before the motor is used", ge=1, le=100
    )
    enter_timeout: float = quantity("s", "for these replies", gt=0, le=5)
    probe_torque: float = quantity(
        "N m", "most torque with which the direction is tried", gt=0, le=5
    )
    command_timeout: float = quantity(
        "s", "without a command, after which the position is held", gt=0, le=1
    )
    stall_time: float = quantity("s", "longest gap between two cycles", gt=0, le=1)
    exit_burst: int = quantity("1", "exit frames sent at once", ge=1, le=50)
    exit_cycles: int = quantity("1", "cycles in which a further one is sent", ge=1, le=1000)


def load_motor_safety(changes: Mapping[str, Any] | None = None) -> MotorSafety:
    """The values of `models/parameters/hardware/motor_safety.yaml` with `changes` on top.

    Raises:
        ScenarioError: names key, value and what is allowed.
    """
    return load_section(model_path("parameters/hardware/motor_safety.yaml"), MotorSafety, changes)


@dataclass(frozen=True)
class MotorSettings:
    """One motor on its joint. Joint angle = direction * (motor angle - zero).

    Attributes:
        name: of the joint, for messages.
        motor_id: on the bus.
        profile: ranges of its firmware.
        safety: when it is switched off, and how gently it is taken over.
        low, high: range of the joint, rad.
        torque_limit: of the total PD torque, N m.
        kp_max: N m/rad.
        kd_max: N m s/rad.
        jump_speed: fastest change of position that is believed, rad/s.
        hold_kp, hold_kd: gains with which a position is held, N m/rad and N m s/rad.
        direction: +1 or -1: sign of the motor's angle against the joint's.
        zero: motor angle at joint angle 0, rad.

    Raises:
        HardwareError: a range that the profile cannot express, an id not allowed, a direction other
            than +1 and -1.
    """

    name: str
    motor_id: int
    profile: FirmwareProfile
    safety: MotorSafety
    low: float
    high: float
    torque_limit: float
    kp_max: float
    kd_max: float
    jump_speed: float
    hold_kp: float
    hold_kd: float
    direction: int = 1
    zero: float = 0.0

    def __post_init__(self) -> None:
        check_motor_id(self.motor_id)
        if self.direction not in (1, -1):
            raise HardwareError(f"{self.name}: direction {self.direction!r}; allowed is 1 or -1")
        if not self.low < self.high:
            raise HardwareError(f"{self.name}: range {self.low:g} to {self.high:g} rad is empty")
        ends = (self.motor_angle(self.low), self.motor_angle(self.high))
        # Below this a command looks like a reply of the motor, see
        # `aerodima.hardware.protocol.ak70.MOST_ID`.
        least = self.profile.position * (2 * (MOST_ID + 1) / 256 - 1)
        if not least < min(ends) or not max(ends) < self.profile.position:
            raise HardwareError(
                f"{self.name}: motor angles {min(ends):.3g} to {max(ends):.3g} rad; firmware "
                "profile "
                f"{self.profile.name} allows {least:.3g} to {self.profile.position:g} rad: set "
                "the zero nearer"
            )

    def motor_angle(self, joint: float) -> float:
        """Motor angle (rad) of a joint angle (rad)."""
        return self.zero + self.direction * joint

    def joint_angle(self, motor: float) -> float:
        """Joint angle (rad) of a motor angle (rad)."""
        return self.direction * (motor - self.zero)


def motor_settings(
    name: str,
    motor_id: int,
    profile: FirmwareProfile,
    parameters: TailMotorParameters,
    joint_range: tuple[float, float],
    hold_gains: tuple[float, float],
    direction: int = 1,
    zero: float = 0.0,
    safety: MotorSafety | None = None,
) -> MotorSettings:
    """Settings whose physical limits are the scenario's, never wider than the profile can express.

    Args:
        parameters: `scenario.tail_motor`.
        joint_range: low and high, rad (`scenario.tail.roll_limit` to either side, ...).
        hold_gains: kp and kd (`scenario.controller.hold_kp` and `hold_kd`).
        safety: `load_motor_safety()` when None.
    """
    kp_max = min(parameters.kp_max, profile.kp)
    kd_max = min(parameters.kd_max, profile.kd)
    return MotorSettings(
        name=name,
        motor_id=motor_id,
        profile=profile,
        safety=safety or load_motor_safety(),
        low=joint_range[0],
        high=joint_range[1],
        torque_limit=min(parameters.torque_limit, profile.torque),
        kp_max=kp_max,
        kd_max=kd_max,
        jump_speed=min(parameters.speed_range, profile.speed),
        hold_kp=min(hold_gains[0], kp_max),
        hold_kd=min(hold_gains[1], kd_max),
        direction=direction,
        zero=zero,
    )
