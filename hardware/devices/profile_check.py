"""Does the firmware profile fit what the motors answer? The frames carry no version; their numbers betray it.

The ratio between the change of position and the reported velocity depends on the ranges of both: turned by hand, a
motor whose profile is right reports the speed at which its position changes. The range of the torque cannot be told
this way: 24 and 25 N m differ by 4 %, and profiles that differ in nothing else stay undecided.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerodima.hardware.protocol.ak70 import decode_reply
from aerodima.hardware.protocol.ak70_profiles import PROFILES, FirmwareProfile
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.errors import HardwareError

_RATIO_TOLERANCE = 0.2
_WARMEST, _COLDEST = 120.0, -30.0


@dataclass(frozen=True)
class ProfileEvidence:
    """What the replies say about a profile.

    Attributes:
        replies: how many were read.
        reply_length: bytes of each.
        speed_ratio: change of position over the integral of the reported velocity: 1 if the profile is right; None if
            the motor was not turned enough to tell.
    """

    replies: int
    reply_length: int
    speed_ratio: float | None


def check_profile(profile: FirmwareProfile, replies: Sequence[tuple[float, CanFrame]]) -> ProfileEvidence:
    """Checks a profile against replies of one motor to the neutral command.

    Args:
        replies: (arrival in s, frame), in order, at 20 Hz or more; best with the motor turned by hand by half a radian.

    Raises:
        HardwareError: no replies, V3 firmware, replies of another length, a temperature that cannot be, or a speed that
            does not belong to the change of position; names the profiles that would fit.
    """
    if not replies:
        raise HardwareError(f"firmware profile {profile.name}: no reply of the motor to check it with")
    lengths = {len(frame.data) for _, frame in replies}
    decoded = [decode_reply(frame, profile) for _, frame in replies]
    if len(lengths) > 1:
        raise HardwareError(
            f"firmware profile {profile.name}: replies of {sorted(lengths)} bytes: two motors on one id?"
        )
    warm = [reply.temperature for reply in decoded if reply.temperature is not None]
    if warm and not _COLDEST <= np.median(warm) <= _WARMEST:
        raise HardwareError(f"firmware profile {profile.name}: {np.median(warm):g} degC cannot be: wrong offset?")
    ratio = _speed_ratio(profile, replies)
    if ratio is not None and abs(ratio - 1.0) > _RATIO_TOLERANCE:
        fitting = [name for name, other in PROFILES.items() if _fits(other, replies)]
        raise HardwareError(
            f"firmware profile {profile.name}: the position changes {ratio:.3g} times as fast as the reported speed; "
            f"profiles that fit: {', '.join(fitting) or 'none that is known'}"
        )
    return ProfileEvidence(len(replies), lengths.pop(), ratio)


def _fits(profile: FirmwareProfile, replies: Sequence[tuple[float, CanFrame]]) -> bool:
    if not {len(frame.data) for _, frame in replies} <= set(profile.reply_lengths):
        return False
    ratio = _speed_ratio(profile, replies)
    return ratio is not None and abs(ratio - 1.0) <= _RATIO_TOLERANCE


def _speed_ratio(profile: FirmwareProfile, replies: Sequence[tuple[float, CanFrame]]) -> float | None:
    """Least-squares slope of the position over the integral of the velocity; None with too little motion."""
    decoded = [decode_reply(frame, profile) for _, frame in replies]
    times = np.array([time for time, _ in replies])
    velocity = np.array([reply.velocity for reply in decoded])
    position = np.unwrap(np.array([reply.position for reply in decoded]), period=2 * profile.position)
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(times))])
    x, y = travelled - travelled.mean(), position - position.mean()
    # A resting motor reports half a step of speed, which adds up to a slow false travel.
    false_travel = profile.speed / 4095 * (times[-1] - times[0])
    if np.ptp(x) < 4 * false_travel + 0.1 or np.ptp(y) < 1e-3:
        return None
    return float(x @ y / (x @ x))
