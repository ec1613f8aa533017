"""Byte-exact vectors of the MIT frames.

The expected bytes are written out by hand from the field widths.
"""

import math

import pytest

from aerodima.hardware.protocol.ak70 import (
    AK70_10_V1_0_8,
    MANUAL_SAMPLE_CODE,
    MOST_ID,
    NEUTRAL,
    PROFILES,
    MitCommand,
    MitReply,
    decode_command,
    decode_reply,
    firmware_profile,
    is_special,
    make_command,
    make_enter,
    make_exit,
    make_neutral,
    make_reply,
    unwrap,
)
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.workbench.errors import HardwareError, UserError

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


def test_hold_vector_is_the_nearest_step():
    # -pi/2 rad: (12.5 - 1.5708) / 25 * 65535 = 28649.8 -> 28650 = 6FEA; truncation would give 6FE9
    assert round((12.5 - math.pi / 2) / 25 * 65535) == 0x6FEA
    assert math.floor((12.5 - math.pi / 2) / 25 * 65535) == 0x6FE9


@pytest.mark.parametrize("step", [0, 1, 2047, 2048, 4094, 4095])
@pytest.mark.parametrize(
    ("offset", "up"), [(-0.49, 0), (0.0, 0), (0.49, 0), (0.51, 1), (-0.51, -1)]
)
def test_every_field_rounds_to_the_nearest_step(step, offset, up):
    wanted = step + up
    if not 0 <= step + offset <= 4095:
        return
    value = (step + offset) / 4095
    command = MitCommand(0.0, value * 100 - 50, value * 500, value * 5, value * 50 - 25)
    if wanted == 4095:
        command = MitCommand(0.0, command.velocity, command.kp, command.kd, 0.0)
    bits = int.from_bytes(make_command(1, command, PROFILE).data, "big")
    assert [bits >> 36 & 0xFFF, bits >> 24 & 0xFFF, bits >> 12 & 0xFFF] == [wanted] * 3
    assert wanted == 4095 or bits & 0xFFF == wanted


def test_special_frames_are_seven_ff_and_a_letter():
    assert make_enter(2) == CanFrame(2, bytes.fromhex("FFFFFFFFFFFFFFFC"))
    assert make_exit(2) == CanFrame(2, bytes.fromhex("FFFFFFFFFFFFFFFD"))
    assert all(
        is_special(data)
        for data in (make_enter(2).data, make_exit(2).data, bytes.fromhex("FFFFFFFFFFFFFFFE"))
    )
    assert not is_special(make_neutral(2, PROFILE).data)


@pytest.mark.parametrize("last_byte", range(256))
def test_full_scale_command_that_is_a_special_frame_is_refused(last_byte):
    torque = -25 + (0xF00 + last_byte) * TORQUE_STEP
    with pytest.raises(FrameError, match="special frame"):
        make_command(1, MitCommand(12.5, 50, 500, 5, min(torque, 25.0)), PROFILE)


def test_full_scale_command_below_the_special_frames_is_sent():
    frame = make_command(1, MitCommand(12.5, 50, 500, 5, -25 + 0xEFF * TORQUE_STEP), PROFILE)
    assert frame.data == bytes.fromhex("FFFFFFFFFFFFFEFF")
    assert not is_special(frame.data)


@pytest.mark.parametrize("field", ["position", "velocity", "kp", "kd", "torque"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9, -1e9])
def test_nan_and_beyond_range_are_refused_by_field_name(field, value):
    values = {"position": 0.0, "velocity": 0.0, "kp": 0.0, "kd": 0.0, "torque": 0.0, field: value}
    with pytest.raises(FrameError, match=f"^{field} .*allowed is"):
        make_command(1, MitCommand(**values), PROFILE)


def test_position_just_beyond_the_wrap_is_never_commanded():
    make_command(1, MitCommand(12.5, 0, 0, 0, 0), PROFILE)
    with pytest.raises(FrameError, match="position"):
        make_command(1, MitCommand(math.nextafter(12.5, 13), 0, 0, 0, 0), PROFILE)


@pytest.mark.parametrize("motor_id", [0, MOST_ID + 1, 255, -1, 1.0, True])
def test_motor_ids_that_would_be_ambiguous_are_refused(motor_id):
    with pytest.raises(FrameError, match="motor id"):
        make_enter(motor_id)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("01 8000 800 800", MitReply(1, POSITION_STEP / 2, SPEED_STEP / 2, TORQUE_STEP / 2)),
        ("01 0000 000 000", MitReply(1, -12.5, -50.0, -25.0)),
        ("01 FFFF FFF FFF", MitReply(1, 12.5, 50.0, 25.0)),
        ("01 FFFF 000 FFF 19 00", MitReply(1, 12.5, -50.0, 25.0, 25.0, 0)),
        ("3F 0000 FFF 000 FF 05", MitReply(63, -12.5, 50.0, -25.0, 255.0, 5)),
    ],
)
@pytest.mark.parametrize("own_id", [False, True])
def test_reply_of_six_and_eight_bytes(data, expected, own_id):
    frame = CanFrame(expected.motor_id if own_id else 0, bytes.fromhex(data.replace(" ", "")))
    reply = decode_reply(frame, PROFILE)
    assert (reply.motor_id, reply.temperature, reply.fault) == (
        expected.motor_id,
        expected.temperature,
        expected.fault,
    )
    assert (reply.position, reply.velocity, reply.torque) == pytest.approx(
        (expected.position, expected.velocity, expected.torque), abs=1e-12
    )


@pytest.mark.parametrize("length", [0, 1, 5, 7])
def test_short_and_odd_replies_are_refused(length):
    with pytest.raises(FrameError, match=f"reply of {length} bytes"):
        decode_reply(CanFrame(0, bytes(length)), PROFILE)


def test_reply_with_more_bytes_than_the_profile_has_is_refused():
    with pytest.raises(FrameError, match="reply of 8 bytes; manual_sample_code sends 6"):
        decode_reply(CanFrame(0, bytes.fromhex("0180008008001900")), MANUAL_SAMPLE_CODE)


def test_v3_frame_is_refused_by_name():
    with pytest.raises(FrameError, match="V3 firmware"):
        decode_reply(CanFrame(0x2901, bytes(8), extended=True), PROFILE)


@pytest.mark.parametrize(
    ("arbitration_id", "first"), [(2, 1), (0, 0), (0, 0x40), (0x40, 0x40), (0x123, 1)]
)
def test_reply_under_a_foreign_id_is_refused(arbitration_id, first):
    with pytest.raises(FrameError, match="no reply"):
        decode_reply(CanFrame(arbitration_id, bytes([first, 0x80, 0, 0x80, 8, 0])), PROFILE)


def test_reply_survives_its_own_decoder_in_both_forms():
    for reply in (MitReply(5, 1.0, -2.0, 3.0), MitReply(5, 1.0, -2.0, 3.0, 41.0, 2)):
        decoded = decode_reply(make_reply(reply, PROFILE, arbitration_id=5), PROFILE)
        assert decoded.position == pytest.approx(1.0, abs=POSITION_STEP / 2)
        assert decoded.velocity == pytest.approx(-2.0, abs=SPEED_STEP / 2)
        assert decoded.torque == pytest.approx(3.0, abs=TORQUE_STEP / 2)
        assert (decoded.temperature, decoded.fault) == (reply.temperature, reply.fault)


def test_command_survives_decoding_within_half_a_step():
    command = MitCommand(-1.25, 3.0, 17.0, 2.5, -4.0)
    decoded = decode_command(make_command(1, command, PROFILE).data, PROFILE)
    assert decoded.position == pytest.approx(command.position, abs=POSITION_STEP / 2)
    assert decoded.velocity == pytest.approx(command.velocity, abs=SPEED_STEP / 2)
    assert decoded.kp == pytest.approx(command.kp, abs=500 / 4095 / 2)
    assert decoded.kd == pytest.approx(command.kd, abs=5 / 4095 / 2)
    assert decoded.torque == pytest.approx(command.torque, abs=TORQUE_STEP / 2)


@pytest.mark.parametrize(
    ("previous", "reading", "expected"),
    [
        (12.4, -12.4, 12.6),
        (-12.4, 12.4, -12.6),
        (37.4, 12.4, 37.4),
        (37.6, -12.4, 37.6),
        (0.0, 1.0, 1.0),
    ],
)
def test_reply_is_unwrapped_at_the_profile_range(previous, reading, expected):
    assert unwrap(previous, reading, PROFILE) == pytest.approx(expected, abs=1e-12)


def test_the_wrong_profile_reads_another_angle():
    frame = CanFrame(0, bytes.fromhex("01C000800800"))
    assert decode_reply(frame, PROFILE).position == pytest.approx(6.25, abs=1e-3)
    assert decode_reply(frame, MANUAL_SAMPLE_CODE).position == pytest.approx(47.75, abs=1e-2)


@pytest.mark.parametrize("name", ["ak70_10_v3", "V3.0", "AK70-10 V3"])
def test_v3_profile_is_refused_by_name(name):
    with pytest.raises(HardwareError, match="V3 firmware speaks another protocol"):
        firmware_profile(name)


def test_unknown_profile_lists_the_known_ones():
    with pytest.raises(UserError, match="ak70_10_v1_0_8, ak70_10_24_n_m"):
        firmware_profile("ak80")
    assert all(firmware_profile(name).name == name for name in PROFILES)


def test_unknown_fault_byte_is_a_fault():
    assert PROFILE.fault_name(0) == "none"
    assert PROFILE.fault_name(1) == "over-temperature"
    assert PROFILE.fault_name(77) == "unknown fault 77"


@pytest.mark.parametrize(
    ("arbitration_id", "extended"), [(0x800, False), (-1, False), (1 << 29, True)]
)
def test_can_id_that_does_not_exist_is_refused(arbitration_id, extended):
    with pytest.raises(FrameError, match="CAN id"):
        CanFrame(arbitration_id, b"", extended)


def test_can_frame_of_nine_bytes_is_refused():
    with pytest.raises(FrameError, match="9 bytes"):
        CanFrame(1, bytes(9))
