"""Messages of a u-blox receiver: UBX NAV-PVT, out of a stream with other messages and noise.

Layout: u-blox 8 / M8 protocol specification, UBX-13003221. `make_nav_pvt` is for emulators.
"""

import math
import struct
from dataclasses import dataclass

from aerodima.hardware.protocol.byte_stream import cut_frames
from aerodima.hardware.protocol.can_frame import FrameError

_START = b"\xb5"
"""First byte of a frame."""
_HEAD = b"\xb5\x62\x01\x07\x5c\x00"
"""Bytes before the payload of a NAV-PVT: start, class, id and length."""
_PAYLOAD = struct.Struct("<8x 3B B 4x i B B 38x i 4x I 20x")
"""Hour, minute, second and what of the time is valid; nanoseconds; kind of fix and its flags; speed
over ground, mm/s; its accuracy, mm/s."""
_VALID_TIME = 0x02
"""Bit of the time that is valid."""
_FIX_OK = 0x01
"""Bit of a fix within the receiver's own limits."""
_MAX_PAYLOAD = 256
"""Longer messages are stepped over byte by byte; a false start in noise must not hold up good
frames for long."""
_MAX_SPEED = 515.0
"""m/s; receivers stop at 1000 knots."""
_MAX_ACCURACY = 1.0
"""Largest standard deviation of a speed that is believed, m/s: a seventh of the limit of
speed."""
_FIXES = (2, 3, 4)
"""2D, 3D, GNSS with dead reckoning."""


@dataclass(frozen=True, slots=True)
class GpsSample:
    """One navigation solution.

    Attributes:
        speed: over ground, m/s; NaN without a fix.
        fix: the receiver trusts its solution, and its speed is accurate enough.
        time_of_day: UTC, s since midnight; None while it is not known.
    """

    speed: float
    fix: bool = True
    time_of_day: float | None = None


class GpsStream:
    """Samples out of the receiver's bytes.

    Attributes:
        rejected: frames with a wrong checksum or fields that cannot be.
    """

    def __init__(self) -> None:
        self._open = b""
        self.rejected = 0

    def feed(self, data: bytes) -> list[GpsSample]:
        """Adds bytes; returns the samples that became complete, oldest first."""
        samples, self._open = cut_frames(self._open + data, _START, self._cut)
        return samples

    def _cut(self, data: bytes) -> tuple[int, GpsSample | None]:
        if not data.startswith(_HEAD[:2]) and len(data) > 1:
            return 1, None
        if len(data) < len(_HEAD):
            return 0, None
        length = int.from_bytes(data[4:6], "little")
        total = length + 8
        if length <= _MAX_PAYLOAD and len(data) < total:
            return 0, None
        if length > _MAX_PAYLOAD or ubx_checksum(data[2 : total - 2]) != data[total - 2 : total]:
            self.rejected += 1
            return 1, None
        if not data.startswith(_HEAD):
            return total, None
        try:
            return total, decode_nav_pvt(data[:total])
        except FrameError:
            self.rejected += 1
            return total, None


def decode_nav_pvt(frame: bytes) -> GpsSample:
    """Decodes the sample in a whole frame of a NAV-PVT.

    Raises `FrameError` for a speed that cannot be.
    """
    hours, minutes, seconds, valid, nanoseconds, kind, flags, speed, accuracy = (
        _PAYLOAD.unpack_from(frame, len(_HEAD))
    )
    if not flags & _FIX_OK or kind not in _FIXES or accuracy > 1000.0 * _MAX_ACCURACY:
        speed = math.nan
    elif not 0.0 <= speed <= 1000.0 * _MAX_SPEED:
        raise FrameError(f"GPS speed {speed!r} mm/s; allowed is 0 to {1000.0 * _MAX_SPEED:g}")
    clock = 3600.0 * hours + 60.0 * minutes + seconds + 1e-9 * nanoseconds
    known = bool(valid & _VALID_TIME)
    return GpsSample(speed / 1000.0, math.isfinite(speed), clock if known else None)


def make_nav_pvt(sample: GpsSample) -> bytes:
    """Makes the frame of a sample; for emulators.

    Raises `FrameError` for a speed that is none.
    """
    if sample.fix and not 0.0 <= sample.speed <= _MAX_SPEED:
        raise FrameError(f"GPS speed {sample.speed!r} m/s; allowed is 0 to {_MAX_SPEED:g}")
    minutes, seconds = divmod(sample.time_of_day or 0.0, 60.0)
    hours, minutes = divmod(int(minutes), 60)
    body = _HEAD[2:] + _PAYLOAD.pack(
        hours % 24,
        minutes,
        int(seconds),
        _VALID_TIME * (sample.time_of_day is not None),
        round(seconds % 1.0 * 1e9),
        3 * sample.fix,
        _FIX_OK * sample.fix,
        round(sample.speed * 1000) if sample.fix else 0,
        0,
    )
    return _HEAD[:2] + body + ubx_checksum(body)


def ubx_checksum(data: bytes) -> bytes:
    """The two bytes of the 8-bit Fletcher sum over class, id, length and payload."""
    first = 0
    second = 0
    for byte in data:
        first = first + byte & 0xFF
        second = second + first & 0xFF
    return bytes([first, second])
