"""Messages of a u-blox receiver: UBX NAV-PVT, out of a stream with other messages and noise.

Frames are cut out here; their checksums and fields are read and written by pyubx2
(NAV-PVT: u-blox 8 / M8 protocol specification, UBX-13003221). `make_nav_pvt` is for emulators.
"""

import math
from dataclasses import dataclass
from typing import Any

from aerodima.hardware.protocol.byte_stream import cut_frames
from aerodima.hardware.protocol.can_frame import FrameError, check_field

_START = b"\xb5"
"""First byte of a frame."""
_HEAD = b"\xb5\x62\x01\x07\x5c\x00"
"""Bytes before the payload of a NAV-PVT: start, class, id and length."""
_FRAME_BYTES = 100
"""Length of a NAV-PVT: head, payload of 92 bytes and checksum."""
_MAX_SPEED = 515.0
"""Largest possible speed, m/s; receivers stop at 1000 knots."""
_MAX_ACCURACY = 1.0
"""Largest standard deviation of a speed that is believed, m/s: a seventh of the limit of
speed."""
_FIXES = (2, 3, 4)
"""Types of fix that count: 2D, 3D, GNSS with dead reckoning."""


@dataclass(frozen=True, slots=True)
class GpsSample:
    """One navigation solution.

    Attributes:
        speed: speed over ground, m/s; NaN without a fix.
        fix: whether the receiver trusts its solution, and its speed is accurate enough.
        time_of_day: time of day in UTC, s since midnight; None while it is not known.
    """

    speed: float
    fix: bool = True
    time_of_day: float | None = None


class GpsStream:
    """Parser of the samples in the receiver's bytes."""

    def __init__(self) -> None:
        self._open = b""

    def feed(self, data: bytes) -> list[GpsSample]:
        """Adds bytes; returns the samples that became complete, oldest first."""
        samples, self._open = cut_frames(self._open + data, _START, _cut)
        return samples


def _cut(data: bytes) -> tuple[int, GpsSample | None]:
    if not _HEAD.startswith(data[: len(_HEAD)]):  # of another message, or noise
        return 1, None
    if len(data) < _FRAME_BYTES:
        return 0, None
    try:
        return _FRAME_BYTES, decode_nav_pvt(data[:_FRAME_BYTES])
    except FrameError:
        return 1, None


def decode_nav_pvt(frame: bytes) -> GpsSample:
    """Decodes the sample in a whole UBX frame.

    Raises `FrameError` if it is no NAV-PVT, its checksum is wrong, or its speed is impossible.
    """
    import pyubx2

    try:
        message: Any = pyubx2.UBXReader.parse(frame)
        speed = message.gSpeed / 1000.0
        accurate = message.sAcc / 1000.0 <= _MAX_ACCURACY
        fix = bool(message.gnssFixOk) and message.fixType in _FIXES and accurate
        known = bool(message.validTime)
        clock = message.hour * 3600.0 + message.min * 60.0 + message.second + message.nano * 1e-9
    except Exception as error:  # the library documents no closed set of exceptions
        raise FrameError(f"GPS: no NAV-PVT: {error}") from None
    if fix:
        check_field("GPS speed", speed, 0.0, _MAX_SPEED, "m/s")
    return GpsSample(speed if fix else math.nan, fix, clock if known else None)


def make_nav_pvt(sample: GpsSample) -> bytes:
    """Makes the UBX frame of a sample; for emulators."""
    import pyubx2

    clock = 0.0 if sample.time_of_day is None else sample.time_of_day
    minutes, seconds = divmod(clock, 60.0)
    hours, minutes = divmod(minutes, 60.0)
    return pyubx2.UBXMessage(
        "NAV",
        "NAV-PVT",
        pyubx2.GET,
        year=2026,
        month=1,
        day=1,
        hour=int(hours) % 24,
        min=int(minutes),
        second=int(seconds),
        nano=round((seconds % 1.0) * 1e9),
        validDate=1,
        validTime=int(sample.time_of_day is not None),
        fixType=3 if sample.fix else 0,
        gnssFixOk=int(sample.fix),
        gSpeed=round(sample.speed * 1000) if sample.fix else 0,
    ).serialize()
