"""Does a motor do what it is told? Commanded against reported torque, and commanded against measured position.

A motor that has switched itself off (a brown-out, an exit frame of somebody else) still answers every frame: only what
it does not do shows it.
"""

from __future__ import annotations

from aerodima.hardware.devices.motor_limits import pd_torque
from aerodima.hardware.devices.motor_settings import MotorSafety
from aerodima.hardware.protocol.ak70 import MitCommand


class Following:
    """One motor, looked at with every reply. Joint coordinates."""

    def __init__(self, safety: MotorSafety) -> None:
        self._safety = safety
        self._weak_since: float | None = None
        self._behind_since: float | None = None

    def look(self, asked: MitCommand | None, position: float, speed: float, torque: float, now: float) -> str:
        """Why the motor does not follow, in words; empty while it does.

        Args:
            asked: the command that was sent last; None while nothing is asked of it.
            position, speed, torque: as measured at `now` (s, monotonic), rad, rad/s, N m.
        """
        if asked is None:
            self._weak_since = self._behind_since = None
            return ""
        safety = self._safety
        wanted = pd_torque(asked, position, speed)
        delivered = torque if wanted >= 0 else -torque
        weak = abs(wanted) > safety.follow_torque and delivered < safety.follow_share * abs(wanted)
        self._weak_since = _since(weak, self._weak_since, now)
        error = asked.position - position
        behind = asked.kp > 0 and abs(error) > safety.tracking_error and error * speed <= 0.0
        self._behind_since = _since(behind, self._behind_since, now)
        if self._weak_since is not None and now - self._weak_since >= safety.follow_time:
            return f"does not follow: {torque:.1f} N m reported where {wanted:.1f} are commanded; is it off?"
        if self._behind_since is not None and now - self._behind_since >= safety.tracking_time:
            return f"does not follow: {error:+.2f} rad from its command; allowed is {safety.tracking_error:g}"
        return ""


def _since(is_so: bool, since: float | None, now: float) -> float | None:
    """When a state began; None while it is not so."""
    return (now if since is None else since) if is_so else None
