"""Monitors of one motor: whether it follows its commands, and whether a second one answers."""

from collections import deque

from aerodima.hardware.devices.motor_limits import commanded_torque
from aerodima.hardware.devices.motor_settings import MotorSafety
from aerodima.hardware.protocol.ak70 import MitCommand

_RECENT = 0.015
"""Time before a reply in which the command acted to which its torque belongs, s: at 100 Hz one of
the last three. A reply is made before the command that it answers acts."""
MAX_EXTRA = 2
"""Largest number of surplus replies, in cycles in a row, that may still be chance."""


class Debounce:
    """Timer of how long a condition has held, s."""

    def __init__(self) -> None:
        self._since: float | None = None

    def update(self, holds: bool, now: float) -> float:
        """Updates with the condition at `now` (s); returns its duration, 0 while it does not
        hold.
        """
        if not holds:
            self._since = None
            return 0.0
        if self._since is None:
            self._since = now
        return now - self._since


class TrackingMonitor:
    """Comparison of every reply of one motor with its commands, in joint coordinates.

    The torque of a reply must belong to one of the newest commands, at the angle and rate of the
    reply itself: no mass, no weight and no air is needed to tell. One that belongs to none of them
    is old, or frozen, however punctual it is. Nothing tells the age of a reply while the command
    does not change.
    """

    def __init__(self, safety: MotorSafety) -> None:
        self._safety = safety
        self.reset()

    def reset(self) -> None:
        """Forgets everything; the motor has no command."""
        self._weak = Debounce()
        self._behind = Debounce()
        self._recent: deque[tuple[float, MitCommand]] = deque()
        self._implausible = 0

    def update(
        self, command: MitCommand, position: float, speed: float, torque: float, now: float
    ) -> str:
        """Updates with a reply; returns why the motor does not follow, empty while it does.

        Args:
            command: command that was sent last.
            position: measured angle of the joint, rad.
            speed: measured speed of the joint, rad/s.
            torque: reported torque, N m.
            now: time of the reply, s, monotonic.
        """
        safety = self._safety
        if not self._recent or command is not self._recent[-1][1]:
            self._recent.append((now, command))
        while len(self._recent) > 1 and self._recent[1][0] <= now - _RECENT:
            self._recent.popleft()
        torques = [commanded_torque(recent, position, speed) for _, recent in self._recent]
        least = min(torques)
        most = max(torques)
        wanted = min(torques, key=abs)
        delivered = torque if wanted >= 0 else -torque
        weak = abs(wanted) > safety.follow_torque and delivered < safety.follow_share * abs(wanted)
        weak_for = self._weak.update(weak, now)
        error = command.position - position
        behind = command.kp > 0 and abs(error) > safety.tracking_error and error * speed <= 0.0
        behind_for = self._behind.update(behind, now)
        inaccuracy = 1.0 - safety.torque_share
        lower = least - inaccuracy * abs(least) - safety.torque_margin
        upper = most + inaccuracy * abs(most) + safety.torque_margin
        if lower <= torque <= upper:
            self._implausible = 0
        else:
            self._implausible += 1
        reported = f"does not follow: {torque:.1f} N m reported where"
        if self._implausible >= safety.strange_replies:
            asked = f"{least:.1f} to {most:.1f}"
            return f"{reported} {asked} are commanded; is it off, or are its replies old?"
        if weak_for >= safety.follow_time:
            return f"{reported} {wanted:.1f} are commanded; is it off?"
        if behind_for >= safety.tracking_time:
            return (
                f"does not follow: {error:+.2f} rad from its command; allowed is "
                f"{safety.tracking_error:g}"
            )
        return ""


class ReplyCount:
    """Counter of the unanswered frames to one motor, and of the replies that answer none of them.

    A computer that is held up sends late and reads late: several replies in one cycle are not too
    many while as many are owed. A frame that has no answer after `memory` was lost.

    Args:
        memory: time after which an unanswered frame counts as lost, s.

    Attributes:
        extra: number of surplus replies, in cycles in a row.
    """

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._unanswered: deque[float] = deque()
        self.extra = 0

    def clear(self) -> None:
        """Forgets everything: the motor is switched on anew."""
        self._unanswered.clear()
        self.extra = 0

    def add(self, frames: int, replies: int, now: float) -> None:
        """Adds what was sent and received in a cycle that ends at `now`, s."""
        while self._unanswered and now - self._unanswered[0] > self._memory:
            self._unanswered.popleft()
        self._unanswered.extend([now] * frames)
        while replies and self._unanswered:
            self._unanswered.popleft()
            replies -= 1
        # without frames of its own a motor may still be asked by the Teensy, which repeats its last
        # order
        if frames:
            self.extra = self.extra + replies if replies else 0
