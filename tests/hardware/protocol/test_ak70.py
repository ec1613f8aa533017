"""Byte-exact vectors of the MIT frames.

The expected bytes are written out by hand from the field widths.
"""

import math
from dataclasses import fields, replace

import pytest

from aerodima.hardware.protocol.ak70 import (
    AK70_10_V1_0_8,
    MANUAL_SAMPLE_CODE,
    MAX_ID,
    NEUTRAL,
    PROFILES,
    MitCommand,
    decode_reply,
    firmware_profile,
    is_special,
    make_command,
    make_enter,
    make_exit,
    make_neutral,
    unwrap,
)
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.workbench.core.errors import HardwareError
from tests.refusals import assert_refused

PROFILE = AK70_10_V1_0_8
POSITION_STEP = 25.0 / 65535
SPEED_STEP = 100.0 / 4095
TORQUE_STEP = 50.0 / 4095


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        # position 16 | velocity 12 | kp 12 | kd 12 | torque 12; zero lies half way between 7FFF and
        # 8000 and rounds up
        (NEUTRAL, "8000 800 000 000 800"),
        (MitCommand(-12.5, 0, 0, 0, 0), "0000 800 000 000 800"),
        (MitCommand(12.5, 0, 0, 0, 0), "FFFF 800 000 000 800"),
        (MitCommand(0, -50, 0, 0, 0), "8000 000 000 000 800"),
        (MitCommand(0, 50, 0, 0, 0), "8000 FFF 000 000 800"),
        (MitCommand(0, 0, 500, 0, 0), "8000 800 FFF 000 800"),
        (MitCommand(0, 0, 0, 5, 0), "8000 800 000 FFF 800"),
        (MitCommand(0, 0, 0, 0, -25), "8000 800 000 000 000"),
        (MitCommand(0, 0, 0, 0, 25), "8000 800 000 000 FFF"),
        (MitCommand(-12.5, -50, 0, 0, -25), "0000 000 000 000 000"),
        # Table 6.4: hold at -90 degrees with (17, 5), swing with +8 rad/s and (0, 3)
        (MitCommand(-math.pi / 2, 0, 17, 5, 0), "6FEA 800 08B FFF 800"),
        (MitCommand(0, 8, 0, 3, 0), "8000 947 000 999 800"),
    ],
)
def test_command_bytes(command, expected):
    frame = make_command(1, command, PROFILE)
    assert frame == CanFrame(1, bytes.fromhex(expected.replace(" ", "")))
    assert not frame.extended


def test_special_frames_are_seven_ff_and_a_letter():
    assert make_enter(2) == CanFrame(2, bytes.fromhex("FFFFFFFFFFFFFFFC"))
    assert make_exit(2) == CanFrame(2, bytes.fromhex("FFFFFFFFFFFFFFFD"))
    assert all(
        is_special(data)
        for data in (make_enter(2).data, make_exit(2).data, bytes.fromhex("FFFFFFFFFFFFFFFE"))
    )
    assert not is_special(make_neutral(2, PROFILE).data)


def test_full_scale_commands_that_would_be_special_frames_are_refused():
    def full_scale(step):
        return make_command(1, MitCommand(12.5, 50, 500, 5, -25 + step * TORQUE_STEP), PROFILE)

    assert full_scale(0xEFF).data == bytes.fromhex("FFFFFFFFFFFFFEFF")
    assert not is_special(full_scale(0xEFF).data)
    for step in range(0xF00, 0xFFF):
        assert_refused(lambda step=step: full_scale(step), FrameError, "FFFFFFFFFFFFFF")


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("01 8000 800 800", (1, POSITION_STEP / 2, SPEED_STEP / 2, TORQUE_STEP / 2, None, None)),
        ("01 0000 000 000", (1, -12.5, -50.0, -25.0, None, None)),
        ("01 FFFF FFF FFF", (1, 12.5, 50.0, 25.0, None, None)),
        ("01 FFFF 000 FFF 19 00", (1, 12.5, -50.0, 25.0, 25.0, 0)),
        ("3F 0000 FFF 000 FF 05", (63, -12.5, 50.0, -25.0, 255.0, 5)),
    ],
)
def test_reply_of_six_and_eight_bytes(data, expected):
    content = bytes.fromhex(data.replace(" ", ""))
    for arbitration_id in (0, expected[0]):
        found = decode_reply(CanFrame(arbitration_id, content), PROFILE)
        assert found == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("previous", "reading", "expected"),
    [
        (12.4, -12.4, 12.6),
        (-12.4, 12.4, -12.6),
        (37.4, 12.4, 37.4),
        (37.6, -12.4, 37.6),
        (0.0, 1.0, 1.0),
        (0.0, 12.4, 12.4),
        (-7.0, 7.0, 7.0 - 25.0),
        (6.0, -6.4, -6.4),
    ],
)
def test_reply_is_unwrapped_at_the_profile_range(previous, reading, expected):
    assert unwrap(previous, reading, PROFILE) == pytest.approx(expected, abs=1e-12)


def test_unknown_fault_byte_is_a_fault():
    assert PROFILE.fault_name(0) == "none"
    assert PROFILE.fault_name(1) == "over-temperature"
    assert "77" in PROFILE.fault_name(77)


BEYOND = math.nextafter(12.5, 13)


@pytest.mark.parametrize(
    ("field", "value"),
    [("position", BEYOND)]
    + [
        (field.name, value)
        for field in fields(MitCommand)
        for value in (math.nan, math.inf, -math.inf, 1e9, -1e9)
    ],
)
def test_nan_and_beyond_range_are_refused_by_field_name(field, value):
    command = replace(NEUTRAL, **{field: value})
    assert_refused(lambda: make_command(1, command, PROFILE), FrameError, field, str(value))


def reply(data, arbitration_id=0, profile=PROFILE, extended=False):
    return lambda: decode_reply(CanFrame(arbitration_id, data, extended), profile)


STATE = bytes([0x80, 0, 0x80, 8, 0])
REFUSED = {
    **{f"motor id {wrong}": (lambda wrong=wrong: make_enter(wrong), FrameError, str(wrong))
       for wrong in (0, MAX_ID + 1, 255, -1, 1.0, True)},
    **{f"reply of {length} bytes": (reply(bytes(length)), FrameError, str(length))
       for length in (0, 1, 5, 7)},
    "longer than the profile's": (
        reply(b"\x01" + STATE + b"\x19\0", profile=MANUAL_SAMPLE_CODE), FrameError, "8"
    ),
    "V3 frame": (reply(bytes(8), 0x2901, extended=True), FrameError, "V3"),
    **{f"motor {first} under id {number}": (reply(bytes([first]) + STATE, number), FrameError,
                                            str(first))
       for number, first in ((2, 1), (0, 0), (0, 0x40), (0x40, 0x40), (0x123, 1))},
    **{name: (lambda name=name: firmware_profile(name), HardwareError, name)
       for name in ("ak70_10_v3", "V3.0", "AK70-10 V3", "ak80")},
    "no standard id": (lambda: CanFrame(0x800, b""), FrameError, "800"),
    "negative id": (lambda: CanFrame(-1, b""), FrameError, "-0x1"),
    "no extended id": (lambda: CanFrame(1 << 29, b"", True), FrameError, "0x20000000"),
    "nine bytes": (lambda: CanFrame(1, bytes(9)), FrameError, "9"),
}  # fmt: skip


@pytest.mark.parametrize("row", REFUSED.values(), ids=REFUSED)
def test_what_is_no_frame_of_a_motor_is_refused(row):
    assert_refused(*row)


def test_profiles_are_found_by_their_names():
    assert all(firmware_profile(name).name == name for name in PROFILES)
