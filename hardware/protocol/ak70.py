"""MIT mode of the AK70-10: firmware profiles; commands, special frames and replies as bytes (design
section 14).

Manual V1.0.8. A command has the motor's id as standard CAN id and 8 bytes, most significant bit
first: position 16 bits, velocity 12, kp 12, kd 12, torque 12. A reply names its motor in the first
byte: id 8, position 16, velocity 12, torque 12 and, in the long form, temperature 8 and fault 8;
its CAN id may be the motor's or 0.

The frames carry no version, so the user chooses the profile, which says what numbers the fields
stand for, and it is checked before the car is armed (`aerodima.hardware.driving.drive_checks`).
Sources disagree: the manual V1.0.8 has 25 N m, 24 and 24.8 N m are printed elsewhere for the same
motor, and the sample code of the manual has another position range. The functions `make_*` build a
frame and touch nothing.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from aerodima.hardware.protocol.can_frame import CanFrame, FrameError, check_field
from aerodima.workbench.core.errors import HardwareError

FAULT_NAMES: Mapping[int, str] = {
    1: "over-temperature",
    2: "over-current",
    3: "over-voltage",
    4: "under-voltage",
    5: "encoder",
    6: "phase current unbalance",
}
"""Names of the fault bytes in the 8-byte reply; 0 is none. The list is that of public drivers of
the series and equals the manual's."""
MIN_ID = 1
"""Least motor id that is allowed: 0 may be the CAN id of every reply."""
MAX_ID = 0x3F
"""Largest motor id that is allowed. A reply begins with the id and a command with the upper byte of
its position, under the same CAN id: with ids up to 0x3F an echoed command looks like a reply only
below half of the position range, where `aerodima.hardware.devices.tail_motor` never commands, and
0xFF begins the special frames."""
COMMAND_FIELDS = ("position", "velocity", "kp", "kd", "torque")
"""Fields of a command, most significant bits first; those of `MitCommand` in their order."""
_REPLY_FIELDS = ("position", "velocity", "torque")
"""Fields of a reply behind its id, most significant bits first."""
_RESERVED = b"\xff" * 7
ENTER = 0xFC
"""Last byte of the special frame that enters a motor."""
EXIT = 0xFD
"""Last byte of the special frame that exits a motor."""
ZERO = 0xFE
"""Last byte of the special frame that sets the zero of a motor."""
_SHORT_REPLY = 6
"""Number of bytes in a reply without temperature and fault."""
LONG_REPLY = 8
"""Number of bytes in a reply with both, and in a special frame."""


@dataclass(frozen=True)
class FirmwareProfile:
    """Ranges of one firmware. A field of n bits spans its range in 2^n - 1 steps.

    Attributes:
        name: name by which a user chooses the profile.
        position: range of the position to either side, rad; the reported position wraps here.
        speed: range of the velocity to either side, rad/s.
        torque: range of the torque to either side, N m.
        kp: upper end of the range of kp, which begins at 0, N m/rad.
        kd: upper end of the range of kd, which begins at 0, N m s/rad.
        reply_lengths: lengths of the replies that this firmware sends, bytes; 6 without, 8 with
            temperature and fault.
        temperature_offset: offset that is subtracted from the temperature byte, degrees Celsius.
            Sources disagree between 0 and 40; 0 reads too warm rather than too cold.
        source: place where the ranges are printed.
    """

    name: str
    position: float
    speed: float
    torque: float
    kp: float
    kd: float
    source: str
    reply_lengths: tuple[int, ...] = (6, 8)
    temperature_offset: float = 0.0

    def fault_name(self, code: int) -> str:
        """Returns the name of a fault byte; an unknown code is named by its number, never taken for
        none.
        """
        if code == 0:
            return "none"
        return FAULT_NAMES.get(code, f"unknown fault {code}")


AK70_10_V1_0_8 = FirmwareProfile(
    "ak70_10_v1_0_8", 12.5, 50.0, 25.0, 500.0, 5.0, "AK series manual V1.0.8, MIT mode"
)
AK70_10_24_N_M = FirmwareProfile(
    "ak70_10_24_n_m", 12.5, 50.0, 24.0, 500.0, 5.0, "public driver, AK70-10 V1.1"
)
AK70_10_24_8_N_M = FirmwareProfile(
    "ak70_10_24_8_n_m", 12.5, 50.0, 24.8, 500.0, 5.0, "peak torque of the data sheet"
)
MANUAL_SAMPLE_CODE = FirmwareProfile(
    "manual_sample_code",
    95.5,
    30.0,
    18.0,
    500.0,
    5.0,
    "sample code of the AK series manual",
    reply_lengths=(6,),
)

PROFILES: Mapping[str, FirmwareProfile] = {
    profile.name: profile
    for profile in (AK70_10_V1_0_8, AK70_10_24_N_M, AK70_10_24_8_N_M, MANUAL_SAMPLE_CODE)
}


def firmware_profile(name: str) -> FirmwareProfile:
    """Returns the profile of that name.

    Raises:
        HardwareError: unknown name; lists the known ones, and refuses V3 firmware by name.
    """
    if "v3" in name.lower():
        raise HardwareError(
            f"firmware profile {name!r}: V3 firmware speaks another protocol (extended ids) and "
            "is not supported; "
            f"allowed: {', '.join(PROFILES)}"
        )
    if name not in PROFILES:
        raise HardwareError(f"firmware profile {name!r} is unknown; allowed: {', '.join(PROFILES)}")
    return PROFILES[name]


@dataclass(frozen=True)
class MitCommand:
    """Command to the motor's own loop: torque = kp (position - q) + kd (velocity - qd) + torque.

    Attributes:
        position: target position, rad.
        velocity: target velocity, rad/s.
        kp: position gain, N m/rad.
        kd: velocity gain, N m s/rad.
        torque: feed-forward torque, N m.
    """

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


NEUTRAL = MitCommand(0.0, 0.0, 0.0, 0.0, 0.0)
"""Command with zero gains and zero torque: the motor answers with its state and does (next to)
nothing. An even number of values has no middle one, so the torque on the wire is half a step,
0.006 N m."""


class MitReply(NamedTuple):
    """State of one motor.

    Attributes:
        motor_id: id of the motor, from the first byte.
        position: measured position, rad, wrapped to the profile's range.
        velocity: measured velocity, rad/s.
        torque: measured torque, N m.
        temperature: temperature of the motor, degrees Celsius; None in the 6-byte form.
        fault: fault byte, 0 for none; None in the 6-byte form.
    """

    motor_id: int
    position: float
    velocity: float
    torque: float
    temperature: float | None = None
    fault: int | None = None


def make_enter(motor_id: int) -> CanFrame:
    """Makes the frame that switches MIT mode on.

    The motor may jump to its last command: send `NEUTRAL` next.
    """
    return _special(motor_id, ENTER)


def make_exit(motor_id: int) -> CanFrame:
    """Makes the frame that switches the motor off."""
    return _special(motor_id, EXIT)


def make_neutral(motor_id: int, profile: FirmwareProfile) -> CanFrame:
    """Makes a command with zero gains and zero torque, to read the state."""
    return make_command(motor_id, NEUTRAL, profile)


def make_command(motor_id: int, command: MitCommand, profile: FirmwareProfile) -> CanFrame:
    """Makes the frame of a command, every field rounded to the nearest step.

    Raises:
        FrameError: id not allowed; a value is NaN, infinite or beyond the profile's range; or the
            frame would begin with the seven FF of the special frames.
    """
    check_motor_id(motor_id)
    data = _pack(command, COMMAND_FIELDS, profile).to_bytes(8, "big")
    if data.startswith(_RESERVED):
        raise FrameError(
            f"command {command}: at full scale it is the special frame {data.hex().upper()}"
        )
    return CanFrame(motor_id, data)


def decode_command(data: bytes, profile: FirmwareProfile) -> MitCommand:
    """Decodes the command in 8 bytes, as the motor reads it.

    Raises `FrameError` for another length or a special frame.
    """
    if len(data) != 8 or data.startswith(_RESERVED):
        raise FrameError(f"{data.hex().upper()!r} is not a command of 8 bytes")
    return MitCommand(*_unpack(int.from_bytes(data, "big"), COMMAND_FIELDS, profile))


def make_reply(reply: MitReply, profile: FirmwareProfile) -> CanFrame:
    """Makes the frame that a motor would answer with; for emulators.

    Without a fault byte it is the 6-byte form.

    Raises:
        FrameError: a value is NaN or beyond the range of its field.
    """
    check_motor_id(reply.motor_id)
    data = bytes([reply.motor_id]) + _pack(reply, _REPLY_FIELDS, profile).to_bytes(5, "big")
    if reply.fault is not None:
        degrees = (reply.temperature or 0.0) + profile.temperature_offset
        warm = _encode("temperature", degrees, 0.0, 255.0, 255, "degrees above the offset")
        data += bytes([warm, reply.fault])
    return CanFrame(0, data)


def decode_reply(frame: CanFrame, profile: FirmwareProfile) -> MitReply:
    """Decodes the state in a reply.

    Raises:
        FrameError: an extended id (V3 firmware or servo mode), a length that the profile does not
            have, a motor id that is not allowed, or a CAN id that is neither 0 nor the motor's.
    """
    if frame.extended:
        raise FrameError(
            f"{frame}: extended id: the motor has V3 firmware or is in servo mode; MIT mode with "
            "standard ids is needed"
        )
    data = frame.data
    if len(data) not in profile.reply_lengths:
        lengths = " or ".join(map(str, profile.reply_lengths))
        raise FrameError(f"{frame}: reply of {len(data)} bytes; {profile.name} sends {lengths}")
    motor_id = data[0]
    if not MIN_ID <= motor_id <= MAX_ID or frame.arbitration_id not in (0, motor_id):
        raise FrameError(
            f"{frame}: no reply: it names motor {motor_id} under the CAN id {frame.arbitration_id}"
        )
    bits = int.from_bytes(data[1:_SHORT_REPLY], "big")
    position, velocity, torque = _unpack(bits, _REPLY_FIELDS, profile)
    if len(data) == _SHORT_REPLY:
        return MitReply(motor_id, position, velocity, torque)
    temperature = data[6] - profile.temperature_offset
    return MitReply(motor_id, position, velocity, torque, temperature, data[7])


def unwrap(previous: float, reading: float, profile: FirmwareProfile) -> float:
    """Restores the count of turns: returns the angle (rad) nearest to `previous` that reads as
    `reading`.

    Valid while the motor turns less than the profile's range, half of the wrap, between two
    replies.
    """
    span = 2.0 * profile.position
    return reading + span * round((previous - reading) / span)


def is_special(data: bytes) -> bool:
    """Returns whether these are the bytes of an enter, exit or zero frame."""
    return len(data) == LONG_REPLY and data.startswith(_RESERVED) and data[7] in (ENTER, EXIT, ZERO)


def check_motor_id(motor_id: int) -> None:
    """Raises `FrameError` for an id that a motor of this project cannot have."""
    if type(motor_id) is not int or not MIN_ID <= motor_id <= MAX_ID:
        raise FrameError(f"motor id {motor_id!r}: allowed is {MIN_ID} to {MAX_ID}")


def _special(motor_id: int, last: int) -> CanFrame:
    check_motor_id(motor_id)
    return CanFrame(motor_id, _RESERVED + bytes([last]))


def _field(name: str, profile: FirmwareProfile) -> tuple[float, float, int, str]:
    """Returns lowest and highest value of a field, its bits and its unit."""
    fields = {
        "position": (-profile.position, profile.position, 16, "rad"),
        "velocity": (-profile.speed, profile.speed, 12, "rad/s"),
        "torque": (-profile.torque, profile.torque, 12, "N m"),
        "kp": (0.0, profile.kp, 12, "N m/rad"),
        "kd": (0.0, profile.kd, 12, "N m s/rad"),
    }
    return fields[name]


def _pack(values: MitCommand | MitReply, names: Sequence[str], profile: FirmwareProfile) -> int:
    """Returns the bits of fields, the first one in the most significant bits."""
    packed = 0
    for name in names:
        low, high, bits, unit = _field(name, profile)
        steps = (1 << bits) - 1
        packed = packed << bits | _encode(name, getattr(values, name), low, high, steps, unit)
    return packed


def _unpack(packed: int, names: Sequence[str], profile: FirmwareProfile) -> list[float]:
    """Returns the values of the fields in these bits, in the order of `names`."""
    values = []
    for name in reversed(names):
        low, high, bits, _ = _field(name, profile)
        steps = (1 << bits) - 1
        values.append(low + (packed & steps) * (high - low) / steps)
        packed >>= bits
    return values[::-1]


def _encode(name: str, value: float, low: float, high: float, steps: int, unit: str) -> int:
    check_field(name, value, low, high, unit)
    return math.floor((value - low) * steps / (high - low) + 0.5)
