"""Text frames between the computer and the Teensy: those of thesis 5.4.5, with a checksum, a clock
and states added.

Printed command: `CAN MSG 1 ; CAN MSG 2 ; SERVO CMD ; THROTTLE CMD |`, each CAN message `ID ; STATE
; POS ; VEL ; KP ; KD ; TOR |` standing in it as printed, so that a command has three `|`.
Printed reply: `ID 1 ; POS 1 ; VEL 1 ; CUR 1 ; ID 2 ; POS 2 ; VEL 2 ; CUR 2 ; ENC POS |`.

These carry no checksum, no time, no fault and no sign that a motor has fallen silent. So the
command goes on with how the car stands, `;ROLL;PITCH;AGE;LEAN;YAW RATE` behind the throttle; the
reply with, per motor, a counter of CAN replies, temperature and fault (-1: the motor says neither),
then the Teensy's clock and its status; and before the last `|` of either stands `;*HH`, a CRC-8
over everything since the start of the text frame. The firmware reads commands and writes replies
(`src/strings.cpp`).

The attitude is sent because the IMU is connected to the computer: with it the Teensy stops a car
that lies on its side although a drive goes on commanding. The lean by the accelerometer and the yaw
rate at full steering are further evidence, for an attitude that is stuck. A chip of its own would
have to be wired, calibrated and tested on the Teensy.

Units: rad, rad/s, N m/rad, N m s/rad, N m (the thesis calls the reply's field a current; it is the
torque field of the motor's frame), pulses in us, sail angle in degrees, clock in ms.
"""

import re
from dataclasses import dataclass
from enum import IntEnum
from functools import cache

from aerodima.hardware.protocol.ak70 import COMMAND_FIELDS, MitCommand, MitReply, check_motor_id
from aerodima.hardware.protocol.can_frame import FrameError, check_field

END = b"|"
SERVO_PULSES = (950, 1500, 2050)
"""Least, idle and most pulse of the steering servo, us (thesis 5.4.5)."""
THROTTLE_PULSES = (1100, 1500, 1900)
"""Least, idle and most pulse of the speed controller, us (thesis 5.4.5)."""
_MAX_DIGITS = 12
"""Largest number of characters in a number."""
_DECIMAL = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?")
_WHOLE = re.compile(r"-?[0-9]+")
_REPLY_FIELDS = 17
"""Number of fields in a reply."""
_UNKNOWN_AGE = 65535
"""Age that is sent for an unknown attitude, ms."""
_UNKNOWN_FAULT = -1
"""Fault field of a motor whose replies carry neither temperature nor fault."""
NUMBERS = {
    "position": (-100.0, 100.0, 5),
    "velocity": (-200.0, 200.0, 4),
    "kp": (0.0, 500.0, 4),
    "kd": (0.0, 5.0, 5),
    "torque": (-200.0, 200.0, 4),
    "roll": (-3.2, 3.2, 4),
    "pitch": (-3.2, 3.2, 4),
    "lean": (0.0, 3.2, 4),
    "yaw_rate": (-40.0, 40.0, 4),
    "sail": (0.0, 360.0, 3),
}
"""Smallest and largest value that is read or allowed, and decimals that are written, by field. The
ranges of the motors are the widest that any firmware profile can carry; the profile's own range is
checked where it is known."""


class MotorRequest(IntEnum):
    """The field STATE: what the Teensy sends to the motor. The thesis does not print its values.

    EXIT: the exit frame. ENTER: the neutral command, the enter frame, the neutral command. COMMAND:
    the command.
    """

    EXIT = 0
    ENTER = 1
    COMMAND = 2


class TeensyStatus(IntEnum):
    """Status of a reply: why the Teensy has switched everything off.

    WATCHDOG_ACTED: no text frame that can be obeyed, or a restart. ATTITUDE: the car lies on its
    side, does not turn at full steering, or its attitude is not known while it is to drive.
    HEARTBEAT_STOPPED: no heartbeat on the bus while the motors are armed.
    """

    RUNNING = 0
    WATCHDOG_ACTED = 1
    ATTITUDE = 2
    HEARTBEAT_STOPPED = 3


SWITCHED_OFF = {
    TeensyStatus.WATCHDOG_ACTED: "the watchdog of the Teensy has acted",
    TeensyStatus.ATTITUDE: "the Teensy has stopped the car: it lies on its side, does not turn at "
    "full steering, or its attitude is not known",
    TeensyStatus.HEARTBEAT_STOPPED: "the Teensy has switched the motors off: no heartbeat on the "
    "bus",
}
"""Action of the Teensy and its reason in words, by the status."""


@dataclass(frozen=True, slots=True)
class MotorOrder:
    """One CAN message of the command text frame.

    Attributes:
        motor_id: id of the motor that receives it.
        request: what the Teensy sends to the motor.
        command: command that goes with the request `COMMAND`; ignored otherwise.
    """

    motor_id: int
    request: MotorRequest
    command: MitCommand


@dataclass(frozen=True, slots=True)
class Attitude:
    """Attitude of the car.

    Attributes:
        roll: roll angle, rad.
        pitch: pitch angle, rad.
        age: age of the sample, ms; a larger one than the field holds is cut.
        lean: lean by the accelerometer, rad from upright.
        yaw_rate: yaw rate, rad/s.
    """

    roll: float
    pitch: float
    age: int
    lean: float = 0.0
    yaw_rate: float = 0.0


@dataclass(frozen=True, slots=True)
class TeensyCommand:
    """Command to the two motors, the servo and the throttle.

    Attributes:
        motors: orders to the two motors.
        servo: pulse of the steering servo, us.
        throttle: pulse of the speed controller, us.
        attitude: attitude of the car; None if it is not known.
    """

    motors: tuple[MotorOrder, MotorOrder]
    servo: int = SERVO_PULSES[1]
    throttle: int = THROTTLE_PULSES[1]
    attitude: Attitude | None = None


@dataclass(frozen=True, slots=True)
class MotorReport:
    """State of one motor as the Teensy passes it on, and its count of CAN replies modulo 256."""

    state: MitReply
    replies: int


@dataclass(frozen=True, slots=True)
class TeensyReply:
    """Reply with the state of both motors and of the sail.

    Attributes:
        motors: reports of the two motors.
        sail: angle of the sail encoder, degrees, 0 to 360.
        clock: time since the Teensy started, ms.
        status: status of the Teensy.
    """

    motors: tuple[MotorReport, MotorReport]
    sail: float
    clock: int
    status: TeensyStatus


def make_command(command: TeensyCommand) -> bytes:
    """Makes the text frame of a command, with its last `|`.

    Raises:
        FrameError: NaN or a value out of `NUMBERS`, a motor id that is not allowed or used twice,
            or a pulse out of range.
    """
    _check_ids(*(order.motor_id for order in command.motors))
    _check_pulse("servo", command.servo, SERVO_PULSES)
    _check_pulse("throttle", command.throttle, THROTTLE_PULSES)
    orders = "|;".join(map(_write_order, command.motors))
    attitude = _write_attitude(command.attitude)
    data = f"{orders}|;{command.servo};{command.throttle}{attitude}".encode("ascii")
    return data + f";*{crc8(data):02X}".encode("ascii") + END


def decode_reply(text: bytes) -> TeensyReply:
    """Decodes the reply in one whole text frame. Raises `FrameError` for anything else."""
    fields = _open(text)
    if len(fields) != _REPLY_FIELDS:
        raise FrameError(
            f"Teensy reply {text!r}: {len(fields)} fields; allowed are {_REPLY_FIELDS}"
        )
    motors = (_read_report(fields[0:4], fields[9:12]), _read_report(fields[4:8], fields[12:15]))
    _check_ids(*(report.state.motor_id for report in motors))
    clock = _read_integer("clock", fields[15])
    status = _read_integer("status", fields[16])
    return TeensyReply(motors, _read_number("sail", fields[8]), clock, TeensyStatus(status))


def crc8(data: bytes) -> int:
    """Returns the CRC-8 with polynomial x^8 + x^2 + x + 1 and initial value 0; it finds every burst
    of errors of up to 8 bits.
    """
    value = 0
    for byte in data:
        value = _crc_of(value ^ byte)
    return value


@cache
def _crc_of(byte: int) -> int:
    for _ in range(8):
        if byte & 0x80:
            byte = (byte << 1 ^ 0x07) & 0xFF
        else:
            byte <<= 1
    return byte


_INTEGERS = {
    "id": (0, 255),
    "replies": (0, 255),
    "temperature": (-40, 255),
    "fault": (_UNKNOWN_FAULT, 255),
    "clock": (0, 2**32 - 1),
    "status": (0, max(TeensyStatus)),
}


def _write_order(order: MotorOrder) -> str:
    command = (_number(name, getattr(order.command, name)) for name in COMMAND_FIELDS)
    return ";".join([str(order.motor_id), str(int(order.request)), *command])


def _write_attitude(attitude: Attitude | None) -> str:
    if attitude is None:
        return f";0.0000;0.0000;{_UNKNOWN_AGE};0.0000;0.0000"
    age = min(max(attitude.age, 0), _UNKNOWN_AGE - 1)
    roll, pitch, lean, yaw_rate = (
        _number(name, getattr(attitude, name)) for name in ("roll", "pitch", "lean", "yaw_rate")
    )
    return f";{roll};{pitch};{age};{lean};{yaw_rate}"


def _open(text: bytes) -> list[str]:
    """Returns the fields of a text frame without its end and its checksum, which must be right."""
    content, separator, check = text[:-1].strip(b" \r\n").rpartition(b";*")
    if not text.endswith(END) or not separator or f"{crc8(content):02X}".encode() != check:
        raise FrameError(f"Teensy text frame {text!r}: its end or its checksum is wrong or missing")
    # A byte that is not ASCII is no part of a number.
    return [field.strip(" ") for field in content.decode("ascii", "replace").split(";")]


def _read_report(fields: list[str], extra: list[str]) -> MotorReport:
    position, velocity, torque = map(_read_number, ("position", "velocity", "torque"), fields[1:])
    replies, degrees, code = map(_read_integer, ("replies", "temperature", "fault"), extra)
    health = (None, None) if code == _UNKNOWN_FAULT else (float(degrees), code)
    motor_id = _read_integer("id", fields[0])
    return MotorReport(MitReply(motor_id, position, velocity, torque, *health), replies)


def _read_number(name: str, field: str) -> float:
    lowest, highest, _ = NUMBERS[name]
    if not _DECIMAL.fullmatch(field) or len(field) > _MAX_DIGITS:
        raise FrameError(f"Teensy {name} {field!r}: is not a decimal number")
    value = float(field)
    check_field(f"Teensy {name}", value, lowest, highest)
    return value


def _read_integer(name: str, field: str) -> int:
    lowest, highest = _INTEGERS[name]
    whole = _WHOLE.fullmatch(field) and len(field) <= _MAX_DIGITS
    if not whole or not lowest <= int(field) <= highest:
        raise FrameError(
            f"Teensy {name} {field!r}: allowed is a whole number from {lowest} to {highest}"
        )
    return int(field)


def _number(name: str, value: float) -> str:
    lowest, highest, decimals = NUMBERS[name]
    check_field(f"Teensy {name}", value, lowest, highest)
    return f"{value:.{decimals}f}"


def _check_ids(first: int, second: int) -> None:
    check_motor_id(first)
    check_motor_id(second)
    if first == second:
        raise FrameError(f"both motors have the id {first}: each needs its own")


def _check_pulse(name: str, pulse: int, pulses: tuple[int, int, int]) -> None:
    """Raises `FrameError` for a pulse (us) that is not within `pulses`."""
    if type(pulse) is not int or not pulses[0] <= pulse <= pulses[2]:
        raise FrameError(f"{name} pulse {pulse!r} us: allowed is {pulses[0]} to {pulses[2]}")
