"""The operator's radio: commands, heartbeats and stops to the car, reports from it (thesis 5.4.5).

To the car: class, mode, throttle, steering, pitch tail, roll tail. The published struct `BBffff` is
packed little-endian here, 18 bytes. With native alignment it has 20 (ERRATA E30): that form is
refused by name, since its floats begin two bytes later. XBee modules guard a frame by their own
checksum.

From the car, 20 times per second, packed little-endian: class (4; another layout has another),
sequence, flags (1 armed, 2 the emergency stop came, 4 and 8 what the car asks the operator for, 16
the car has no tail), number of the car, mode last heard, fault codes of
`aerodima.workbench.scenario.signal_table.STATUS_SOURCES`, eight 32-bit floats, then the worst fault
in words. 43 to 100 bytes, as many as the smallest modules carry.
"""

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from aerodima.hardware.protocol.can_frame import FrameError, check_field

PACKED = struct.Struct("<BBffff")
_NATIVE_BYTES = struct.calcsize("@BBffff")
_ANGLE = math.pi
_MIN_NORMAL = 2.0**-126
"""Smallest normal number of 32 bits. Round values in the other byte order come out below it."""
REPORT_CLASS = 4
"""First byte of a report, and version of its layout: another layout has another class, or an older
console would read wrong values."""
FAULT_CODES = 6
"""Number of fault codes in a report, one per source of `signal_table.STATUS_SOURCES`."""
REPORT_PERIOD = 0.05
"""Time between two reports, s."""
_HEAD = struct.Struct(f"<BBBBB{FAULT_CODES}B8f")
_MAX_BYTES = 100
"""Longest report with its text, bytes."""
_ARMED = 1
"""Bit of the flags: the car is armed."""
_STOPPED = 2
"""Bit of the flags: the emergency stop came."""
_PROMPT_SHIFT = 2
"""Place of `prompt` in the flags, bits."""
_NO_TAIL = 16
"""Bit of the flags: the car has no tail."""
_NUMBERS = (
    "yaw_rate",
    "roll",
    "tail_pitch",
    "tail_roll",
    "torque_pitch",
    "torque_roll",
    "speed",
    "operator_age",
)
"""Fields of a report that are 32-bit floats, in their order."""


class RadioClass(IntEnum):
    """First byte of a frame.

    The thesis has a class that starts the logging; here a drive logs from its first cycle.
    """

    COMMAND = 1
    HEARTBEAT = 2
    EMERGENCY_STOP = 3


class RadioMode(IntEnum):
    """Second byte of a command."""

    IDLE = 0
    MANUAL = 1
    AUTO = 2
    CONTROL = 3
    """The operator drives, the tail swings by its law: the control drive mode of the thesis, which
    prints no values."""


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """Command of the operator.

    Attributes:
        mode: mode that says who drives; in IDLE nobody does.
        throttle: commanded throttle, -1 to 1.
        steering: commanded steering angle, rad, positive to the left.
        pitch_tail: commanded pitch angle of the tail, rad.
        roll_tail: commanded roll angle of the tail, rad.
    """

    mode: RadioMode
    throttle: float = 0.0
    steering: float = 0.0
    pitch_tail: float = 0.0
    roll_tail: float = 0.0


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Sign that the operator's station lives; `counter` (0 to 255, wraps) counts upwards."""

    counter: int


@dataclass(frozen=True, slots=True)
class EmergencyStop:
    """Request of the operator to switch everything off."""


RadioMessage = OperatorCommand | Heartbeat | EmergencyStop


def make_command(command: OperatorCommand) -> bytes:
    """Makes the 18 bytes of a command. Raises `FrameError` for NaN and values out of range."""
    values = (command.throttle, command.steering, command.pitch_tail, command.roll_tail)
    _check(values)
    return PACKED.pack(RadioClass.COMMAND, RadioMode(command.mode), *values)


def make_heartbeat(counter: int) -> bytes:
    """Makes the 18 bytes of a heartbeat; the counter is taken modulo 256."""
    return PACKED.pack(RadioClass.HEARTBEAT, counter % 256, 0.0, 0.0, 0.0, 0.0)


def make_emergency_stop() -> bytes:
    """Makes the 18 bytes of an emergency stop."""
    return PACKED.pack(RadioClass.EMERGENCY_STOP, 0, 0.0, 0.0, 0.0, 0.0)


def decode(data: bytes) -> RadioMessage:
    """Decodes the message in a frame.

    Raises:
        FrameError: another length (20 bytes are named as native alignment), an unknown class or
            mode, NaN, a value out of range, or a heartbeat with values where zeros must be.
    """
    if len(data) == _NATIVE_BYTES:
        raise FrameError(
            f"radio frame of {len(data)} bytes: native alignment of BBffff; allowed is '<', "
            f"{PACKED.size}"
        )
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


def _check(values: tuple[float, ...] | list[float]) -> None:
    limits = (
        ("throttle", 1.0),
        ("steering", _ANGLE),
        ("pitch tail", _ANGLE),
        ("roll tail", _ANGLE),
    )
    for (name, limit), value in zip(limits, values, strict=True):
        margin = limit * (1 + 1e-6)  # for the rounding to a 32-bit float
        check_field(f"radio {name}", value, -margin, margin)
        if 0 < abs(value) < _MIN_NORMAL:
            raise FrameError(
                f"radio {name} {value!r}: is the sender's byte order big-endian? allowed is "
                "little-endian"
            )


def _names(kind: type[IntEnum]) -> str:
    return ", ".join(f"{item.value} ({item.name.lower()})" for item in kind)


class OperatorPrompt(IntEnum):
    """Prompt of an armed car to its operator before it drives."""

    NONE = 0
    RETURN_TO_IDLE = 1
    """The switch stands on AUTO, MANUAL or CONTROL from before: it must be seen in IDLE first."""
    SELECT_MODE = 2
    """It was seen in IDLE; AUTO, MANUAL and CONTROL are obeyed from now on."""


@dataclass(frozen=True, slots=True)
class CarReport:
    """One report of the car.

    Attributes:
        armed: whether the car takes commands.
        stopped: whether the operator's emergency stop came; it stays.
        mode: mode of the last command that the car heard.
        faults: fault codes of the sources in their order, `FAULT_CODES` of them; 0 for none.
        yaw_rate: yaw rate of the car, rad/s.
        roll: roll angle of the chassis, rad.
        tail_pitch: pitch angle of the tail, rad.
        tail_roll: roll angle of the tail, rad.
        torque_pitch: torque of the pitch motor, N m.
        torque_roll: torque of the roll motor, N m.
        speed: speed of the car, m/s.
        operator_age: time since the operator was heard alive, s; infinite before.
        text: the worst fault in words, cut to what the frame holds.
        prompt: what the operator must do before the car drives.
        car: number of the car among those that share a radio channel, 0 to 255.
        has_tail: whether the car has tail motors; without them their faults, angles and torques
            mean nothing.
    """

    armed: bool
    stopped: bool
    mode: RadioMode
    faults: tuple[int, ...] = (0,) * FAULT_CODES
    yaw_rate: float = 0.0
    roll: float = 0.0
    tail_pitch: float = 0.0
    tail_roll: float = 0.0
    torque_pitch: float = 0.0
    torque_roll: float = 0.0
    speed: float = 0.0
    operator_age: float = math.inf
    text: str = ""
    prompt: OperatorPrompt = OperatorPrompt.NONE
    has_tail: bool = True
    car: int = 0


def make_report(report: CarReport, sequence: int = 0) -> bytes:
    """Makes the bytes of a report; the sequence is taken modulo 256."""
    flags = _ARMED * report.armed | _STOPPED * report.stopped | report.prompt << _PROMPT_SHIFT
    flags |= _NO_TAIL * (not report.has_tail)
    numbers = (getattr(report, name) for name in _NUMBERS)
    head = _HEAD.pack(
        REPORT_CLASS, sequence % 256, flags, report.car, report.mode, *report.faults, *numbers
    )
    return head + report.text.encode()[: _MAX_BYTES - _HEAD.size]


def decode_report(data: bytes) -> CarReport:
    """Decodes the report in a frame.

    Raises:
        FrameError: another class or length, an unknown mode or flag, or NaN.
    """
    check_field("car report length", len(data), _HEAD.size, _MAX_BYTES, "bytes")
    report_class, _, flags, car, mode, *rest = _HEAD.unpack_from(data)
    prompt = (flags & ~_NO_TAIL) >> _PROMPT_SHIFT
    faults = rest[:FAULT_CODES]
    numbers = rest[FAULT_CODES:]
    known = mode in tuple(RadioMode) and prompt in tuple(OperatorPrompt)
    if report_class != REPORT_CLASS or not known or any(map(math.isnan, numbers)):
        raise FrameError(
            f"car report of class {report_class} with mode {mode}, flags {flags}, {numbers}; "
            f"allowed: class {REPORT_CLASS}, modes and flags that are known, no NaN"
        )
    return CarReport(
        bool(flags & _ARMED),
        bool(flags & _STOPPED),
        RadioMode(mode),
        tuple(faults),
        **dict(zip(_NUMBERS, numbers, strict=True)),
        text=data[_HEAD.size :].decode(errors="ignore"),
        prompt=OperatorPrompt(prompt),
        has_tail=not flags & _NO_TAIL,
        car=car,
    )
