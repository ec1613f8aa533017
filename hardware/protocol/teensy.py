"""Strings between the computer and the Teensy (thesis 5.4.5), in the published form and in one that can be checked.

Command: `CAN MSG 1 ; CAN MSG 2 ; SERVO CMD ; THROTTLE CMD |`, each CAN message `ID ; STATE ; POS ; VEL ; KP ; KD ;
TOR |` standing in it as printed, so that a command has three `|`.
Reply: `ID 1 ; POS 1 ; VEL 1 ; CUR 1 ; ID 2 ; POS 2 ; VEL 2 ; CUR 2 ; ENC POS |`.

The published strings carry no checksum, no time, no fault and no sign that a motor has fallen silent. The `CHECKED`
form adds before the last `|` of a string `;*HH`, a CRC-8 over everything since the start of the string; to the command
the car's attitude, `;ROLL;PITCH;AGE` behind the throttle; and to the reply, per motor, a counter of CAN replies,
temperature and fault, then the Teensy's clock and its status.

The attitude is sent since the IMU hangs on the computer: with it the Teensy stops a car that lies on its side although
a drive goes on commanding. A chip of its own would have to be wired, calibrated and tested on the Teensy.

Units: rad, rad/s, N m/rad, N m s/rad, N m (the thesis calls the reply's field a current; it is the torque field of the
motor's frame), pulses in us, sail angle in degrees, clock in ms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

from aerodima.hardware.protocol.ak70 import MitCommand, check_motor_id
from aerodima.hardware.protocol.can_frame import FrameError

END = b"|"
SERVO_PULSES = (950, 1500, 2050)
"""Least, idle and most pulse of the steering servo, us (thesis 5.4.5)."""
THROTTLE_PULSES = (1100, 1500, 1900)
"""Least, idle and most pulse of the speed controller, us (thesis 5.4.5)."""


class StringForm(Enum):
    """Which form of the strings both ends speak."""

    PUBLISHED = "published"
    CHECKED = "checked"


class MotorRequest(IntEnum):
    """The field STATE: what the Teensy sends to the motor. The thesis does not print its values.

    EXIT: the exit frame. ENTER: the neutral command, the enter frame, the neutral command. COMMAND: the command.
    """

    EXIT = 0
    ENTER = 1
    COMMAND = 2


class TeensyStatus(IntEnum):
    """Status of the checked reply: why the Teensy has switched everything off.

    WATCHDOG_ACTED: no string that can be obeyed, or a restart. ATTITUDE: the car lies on its side, or its attitude is
    not known while it is to drive. BEATS_STOPPED: no heartbeat on the bus while the motors are armed.
    """

    RUNNING = 0
    WATCHDOG_ACTED = 1
    ATTITUDE = 2
    BEATS_STOPPED = 3


SWITCHED_OFF = {
    TeensyStatus.WATCHDOG_ACTED: "the watchdog of the Teensy has acted",
    TeensyStatus.ATTITUDE: "the Teensy has stopped the car: it lies on its side, or its attitude is not known",
    TeensyStatus.BEATS_STOPPED: "the Teensy has switched the motors off: no heartbeat on the bus",
}
"""What the Teensy has done and why, in words, by its status."""


@dataclass(frozen=True, slots=True)
class MotorOrder:
    """One CAN message of the command string.

    Attributes:
        motor_id: whom it is for.
        request: what the Teensy sends.
        command: of `COMMAND`; ignored otherwise.
    """

    motor_id: int
    request: MotorRequest
    command: MitCommand


@dataclass(frozen=True, slots=True)
class Attitude:
    """How the car stands. roll, pitch: rad. age: of the sample, ms; a larger one than the field holds is cut."""

    roll: float
    pitch: float
    age: int


@dataclass(frozen=True, slots=True)
class TeensyCommand:
    """Two motors and two pulses. servo, throttle: us. attitude: None if it is not known; in the checked form only."""

    motors: tuple[MotorOrder, MotorOrder]
    servo: int = SERVO_PULSES[1]
    throttle: int = THROTTLE_PULSES[1]
    attitude: Attitude | None = None


@dataclass(frozen=True, slots=True)
class MotorReport:
    """State of one motor as the Teensy passes it on.

    Attributes:
        motor_id: whose.
        position: rad. velocity: rad/s. torque: N m.
        replies: CAN replies counted modulo 256. temperature: degrees Celsius. fault: fault byte. All None in the
            published form.
    """

    motor_id: int
    position: float
    velocity: float
    torque: float
    replies: int | None = None
    temperature: int | None = None
    fault: int | None = None


@dataclass(frozen=True, slots=True)
class TeensyReply:
    """Both motors and the sail.

    Attributes:
        sail: degrees, 0 to 360.
        clock: ms since the Teensy started. status: of its watchdog. None in the published form.
    """

    motors: tuple[MotorReport, MotorReport]
    sail: float
    clock: int | None = None
    status: TeensyStatus | None = None


def make_command(command: TeensyCommand, form: StringForm) -> bytes:
    """The command string, with its last `|`.

    Raises:
        FrameError: NaN or infinity, a motor id that is not allowed or used twice, or a pulse out of range.
    """
    _check_ids(command.motors[0].motor_id, command.motors[1].motor_id)
    _check_pulse("servo", command.servo, SERVO_PULSES)
    _check_pulse("throttle", command.throttle, THROTTLE_PULSES)
    text = "|;".join(_write_order(order) for order in command.motors) + f"|;{command.servo};{command.throttle}"
    if form is StringForm.CHECKED:
        text += _write_attitude(command.attitude)
    return _close(text, form)


def make_reply(reply: TeensyReply, form: StringForm) -> bytes:
    """The reply string, with its `|`; for emulators and to compare with the firmware. Raises `FrameError` as above."""
    _check_ids(reply.motors[0].motor_id, reply.motors[1].motor_id)
    fields = [_write_report(report) for report in reply.motors] + [_number("sail", reply.sail)]
    if form is StringForm.CHECKED:
        for report in reply.motors:
            fields += [str(report.replies), str(report.temperature), str(report.fault)]
        fields += [str(reply.clock), str(int(reply.status or 0))]
    return _close(";".join(fields), form)


def decode_command(text: bytes, form: StringForm) -> TeensyCommand:
    """The command in one whole string. Raises `FrameError` for anything else."""
    parts = [_fields(part) for part in _open(text, form).split(END)]
    if len(parts) != 3 or parts[1][0] or parts[2][0]:
        raise FrameError(f"Teensy command {text!r}: must be two CAN messages and the pulses")
    motors, pulses = (_read_order(parts[0]), _read_order(parts[1][1:])), parts[2][1:]
    _check_ids(motors[0].motor_id, motors[1].motor_id)
    expected = 2 if form is StringForm.PUBLISHED else 5
    if len(pulses) != expected:
        raise FrameError(f"Teensy command {text!r}: {len(pulses)} fields behind the motors; allowed are {expected}")
    servo, throttle = (_read_integer("pulse", field) for field in pulses[:2])
    _check_pulse("servo", servo, SERVO_PULSES)
    _check_pulse("throttle", throttle, THROTTLE_PULSES)
    return TeensyCommand(motors, servo, throttle, _read_attitude(pulses[2:]) if pulses[2:] else None)


def decode_reply(text: bytes, form: StringForm) -> TeensyReply:
    """The reply in one whole string. Raises `FrameError` for anything else."""
    fields = _fields(_open(text, form))
    expected = 9 if form is StringForm.PUBLISHED else 17
    if len(fields) != expected:
        raise FrameError(f"Teensy reply {text!r}: {len(fields)} fields; the {form.value} form has {expected}")
    extra = [fields[9:12], fields[12:15]] if form is StringForm.CHECKED else [[], []]
    motors = (_read_report(fields[0:4], extra[0]), _read_report(fields[4:8], extra[1]))
    _check_ids(motors[0].motor_id, motors[1].motor_id)
    sail = _read_number("sail", fields[8])
    if form is StringForm.PUBLISHED:
        return TeensyReply(motors, sail)
    status = _read_integer("status", fields[16])
    return TeensyReply(motors, sail, _read_integer("clock", fields[15]), TeensyStatus(status))


def crc8(data: bytes) -> int:
    """CRC-8, polynomial x^8 + x^2 + x + 1, from 0: finds every burst of errors up to 8 bits long."""
    value = 0
    for byte in data:
        value = _CRC_TABLE[value ^ byte]
    return value


def _crc_of(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1 ^ 0x07) & 0xFF if byte & 0x80 else byte << 1
    return byte


_CRC_TABLE = tuple(_crc_of(byte) for byte in range(256))

_MOST_DIGITS = 12
_UNKNOWN_AGE = 65535
"""Age of an attitude that is not known, ms."""
_MOTOR_FIELDS = ("position", "velocity", "kp", "kd", "torque")
_NUMBERS = {
    "position": (-100.0, 100.0, 5),
    "velocity": (-200.0, 200.0, 4),
    "kp": (0.0, 500.0, 4),
    "kd": (0.0, 5.0, 5),
    "torque": (-200.0, 200.0, 4),
    "roll": (-3.2, 3.2, 4),
    "pitch": (-3.2, 3.2, 4),
    "sail": (0.0, 360.0, 3),
}
"""Least and most value that is read, and decimals that are written. Those of the motors are the widest that any
firmware profile can carry; the profile's own range is checked where it is known."""
_INTEGERS = {
    "id": (0, 255),
    "state": (0, max(MotorRequest)),
    "pulse": (0, 9999),
    "age": (0, _UNKNOWN_AGE),
    "replies": (0, 255),
    "temperature": (-40, 255),
    "fault": (0, 255),
    "clock": (0, 2**32 - 1),
    "status": (0, max(TeensyStatus)),
}


def _write_order(order: MotorOrder) -> str:
    request = str(int(MotorRequest(order.request)))
    return ";".join(
        [str(order.motor_id), request, *(_number(name, getattr(order.command, name)) for name in _MOTOR_FIELDS)]
    )


def _write_attitude(attitude: Attitude | None) -> str:
    if attitude is None:
        return f";0.0000;0.0000;{_UNKNOWN_AGE}"
    for name, angle in (("roll", attitude.roll), ("pitch", attitude.pitch)):
        least, most, _ = _NUMBERS[name]
        if not least <= angle <= most:
            raise FrameError(f"Teensy {name} {angle!r}: allowed is {least:g} to {most:g} rad")
    age = min(max(attitude.age, 0), _UNKNOWN_AGE - 1)
    return f";{_number('roll', attitude.roll)};{_number('pitch', attitude.pitch)};{age}"


def _read_attitude(fields: list[str]) -> Attitude | None:
    roll, pitch, age = (
        _read_number("roll", fields[0]),
        _read_number("pitch", fields[1]),
        _read_integer("age", fields[2]),
    )
    return None if age == _UNKNOWN_AGE else Attitude(roll, pitch, age)


def _write_report(report: MotorReport) -> str:
    state = (_number(name, getattr(report, name)) for name in ("position", "velocity", "torque"))
    return ";".join([str(report.motor_id), *state])


def _close(text: str, form: StringForm) -> bytes:
    data = text.encode("ascii")
    if form is StringForm.CHECKED:
        data += f";*{crc8(data):02X}".encode("ascii")
    return data + END


def _open(text: bytes, form: StringForm) -> bytes:
    """The string without its end and, in the checked form, without its checksum, which must be right."""
    if not text.endswith(END):
        raise FrameError(f"Teensy string {text!r}: does not end with '|'")
    body = text[:-1].strip(b" \r\n")
    if form is StringForm.PUBLISHED:
        return body
    content, separator, check = body.rpartition(b";*")
    if not separator or len(check) != 2 or f"{crc8(content):02X}".encode() != check:
        raise FrameError(f"Teensy string {text!r}: checksum is wrong or missing")
    return content


def _fields(body: bytes) -> list[str]:
    try:
        return [field.strip(" ") for field in body.decode("ascii").split(";")]
    except UnicodeDecodeError:
        raise FrameError(f"Teensy string {body!r}: holds bytes that are not ASCII") from None


def _read_order(fields: list[str]) -> MotorOrder:
    if len(fields) != 7:
        raise FrameError(f"CAN message {';'.join(fields)!r}: {len(fields)} fields; allowed are 7")
    request = MotorRequest(_read_integer("state", fields[1]))
    return MotorOrder(
        _read_integer("id", fields[0]), request, MitCommand(*map(_read_number, _MOTOR_FIELDS, fields[2:]))
    )


def _read_report(fields: list[str], extra: list[str]) -> MotorReport:
    position, velocity, torque = map(_read_number, ("position", "velocity", "torque"), fields[1:])
    health = map(_read_integer, ("replies", "temperature", "fault"), extra)
    return MotorReport(_read_integer("id", fields[0]), position, velocity, torque, *health)


def _read_number(name: str, field: str) -> float:
    least, most, _ = _NUMBERS[name]
    digits = field[1:] if field[:1] in ("-", "+") else field
    whole, _, decimals = digits.partition(".")
    if not whole.isdigit() or not (decimals == "" or decimals.isdigit()) or len(field) > _MOST_DIGITS:
        raise FrameError(f"Teensy {name} {field!r}: is not a decimal number")
    if not least <= float(field) <= most:
        raise FrameError(f"Teensy {name} {field}: allowed is {least:g} to {most:g}")
    return float(field)


def _read_integer(name: str, field: str) -> int:
    least, most = _INTEGERS[name]
    digits = field[1:] if field[:1] == "-" else field
    if not digits.isdigit() or len(field) > _MOST_DIGITS or not least <= int(field) <= most:
        raise FrameError(f"Teensy {name} {field!r}: allowed is a whole number from {least} to {most}")
    return int(field)


def _number(name: str, value: float) -> str:
    if not math.isfinite(value):
        raise FrameError(f"Teensy {name} {value!r}: must be finite")
    return f"{value:.{_NUMBERS[name][2]}f}"


def _check_ids(first: int, second: int) -> None:
    check_motor_id(first)
    check_motor_id(second)
    if first == second:
        raise FrameError(f"both motors have the id {first}: each needs its own")


def _check_pulse(name: str, pulse: int, pulses: tuple[int, int, int]) -> None:
    if isinstance(pulse, bool) or not isinstance(pulse, int) or not pulses[0] <= pulse <= pulses[2]:
        raise FrameError(f"{name} pulse {pulse!r} us: allowed is {pulses[0]} to {pulses[2]}")
