"""Frames of the operator's radio: class, mode, throttle, steering, pitch tail, roll tail (thesis 5.4.5).

The published struct `BBffff` is packed little-endian here, 18 bytes. With native alignment it has 20 (ERRATA E30): that
form is refused by name, since its floats begin two bytes later. XBee modules guard a frame by their own checksum.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from aerodima.hardware.protocol.can_frame import FrameError

PACKED = struct.Struct("<BBffff")
_NATIVE_BYTES = struct.calcsize("@BBffff")
_ANGLE = math.pi
_LEAST_NORMAL = 2.0**-126
"""Smallest normal number of 32 bits. Round values in the other byte order come out below it."""


class RadioClass(IntEnum):
    """First byte of a frame. The thesis has a class that starts the logging; here a drive logs from its first cycle."""

    COMMAND = 1
    HEARTBEAT = 2
    EMERGENCY_STOP = 3


class RadioMode(IntEnum):
    """Second byte of a command."""

    IDLE = 0
    MANUAL = 1
    AUTO = 2
    CONTROL = 3
    """The operator drives, the tail swings by its law: the control drive mode of the thesis. It prints no values."""


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """What the operator asks for.

    Attributes:
        mode: who drives; IDLE nobody.
        throttle: -1 to 1. steering: rad, positive to the left. pitch_tail, roll_tail: rad.
    """

    mode: RadioMode
    throttle: float = 0.0
    steering: float = 0.0
    pitch_tail: float = 0.0
    roll_tail: float = 0.0


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """The operator's station lives; `counter` (0 to 255, wraps) differs from frame to frame."""

    counter: int


@dataclass(frozen=True, slots=True)
class EmergencyStop:
    """The operator wants everything off."""


RadioMessage = OperatorCommand | Heartbeat | EmergencyStop


def make_command(command: OperatorCommand) -> bytes:
    """18 bytes of a command. Raises `FrameError` for NaN and values out of range."""
    values = (command.throttle, command.steering, command.pitch_tail, command.roll_tail)
    _check(values)
    return PACKED.pack(RadioClass.COMMAND, RadioMode(command.mode), *values)


def make_heartbeat(counter: int) -> bytes:
    """18 bytes of a heartbeat; the counter is taken modulo 256."""
    return PACKED.pack(RadioClass.HEARTBEAT, counter % 256, 0.0, 0.0, 0.0, 0.0)


def make_emergency_stop() -> bytes:
    """18 bytes of an emergency stop."""
    return PACKED.pack(RadioClass.EMERGENCY_STOP, 0, 0.0, 0.0, 0.0, 0.0)


def decode(data: bytes) -> RadioMessage:
    """The message in a frame.

    Raises:
        FrameError: another length (20 bytes are named as native alignment), an unknown class or mode, NaN, a value out
            of range, or a heartbeat with values where zeros must be.
    """
    if len(data) == _NATIVE_BYTES:
        raise FrameError(f"radio frame of {len(data)} bytes: native alignment of BBffff; allowed is '<', {PACKED.size}")
    if len(data) != PACKED.size:
        raise FrameError(f"radio frame of {len(data)} bytes; allowed is {PACKED.size}")
    message_class, second, *values = PACKED.unpack(data)
    if message_class == RadioClass.COMMAND:
        _check(values)
        if second not in tuple(RadioMode):
            raise FrameError(f"radio mode {second}; allowed: {_names(RadioMode)}")
        return OperatorCommand(RadioMode(second), *values)
    if message_class not in tuple(RadioClass):
        raise FrameError(f"radio class {message_class}; allowed: {_names(RadioClass)}")
    if message_class == RadioClass.EMERGENCY_STOP:
        return EmergencyStop()  # whatever the rest says: a stop too many harms nobody
    if data[2:] != bytes(PACKED.size - 2):
        raise FrameError(f"radio heartbeat carries values {values}; allowed are zeros")
    return Heartbeat(second)


class HeartbeatMonitor:
    """Tells whether the operator's station lives: the counter must change, repeating an old frame is not life."""

    def __init__(self) -> None:
        self._counter: int | None = None
        self._time: float | None = None

    def receive(self, heartbeat: Heartbeat, time: float) -> None:
        """Takes a heartbeat that arrived at `time` (s, monotonic)."""
        if heartbeat.counter != self._counter:
            self._counter, self._time = heartbeat.counter, time

    def age(self, time: float) -> float:
        """Seconds since the counter last changed; infinite before the first heartbeat."""
        return math.inf if self._time is None else time - self._time


def _check(values: tuple[float, ...] | list[float]) -> None:
    limits = (("throttle", 1.0), ("steering", _ANGLE), ("pitch tail", _ANGLE), ("roll tail", _ANGLE))
    for (name, limit), value in zip(limits, values, strict=True):
        if not abs(value) <= limit * (1 + 1e-6):  # also catches NaN; the margin is the rounding to a 32-bit float
            raise FrameError(f"radio {name} {value!r}: allowed is -{limit:g} to {limit:g}")
        if 0 < abs(value) < _LEAST_NORMAL:
            raise FrameError(f"radio {name} {value!r}: is the sender's byte order big-endian? allowed is little-endian")


def _names(kind: type[IntEnum]) -> str:
    return ", ".join(f"{item.value} ({item.name.lower()})" for item in kind)
