"""Strings of the Teensy: the published form to the letter, the checked form, and streams with noise."""

import dataclasses
import math

import pytest

from aerodima.hardware.devices.teensy_link import command_stream, reply_stream
from aerodima.hardware.protocol.ak70 import NEUTRAL, MitCommand
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.teensy import (
    MotorOrder,
    MotorReport,
    MotorRequest,
    StringForm,
    TeensyCommand,
    TeensyReply,
    TeensyStatus,
    crc8,
    decode_command,
    decode_reply,
    make_command,
    make_reply,
)

COMMAND = TeensyCommand(
    (
        MotorOrder(1, MotorRequest.COMMAND, MitCommand(-1.5, 8.0, 17.0, 5.0, 0.25)),
        MotorOrder(2, MotorRequest.EXIT, NEUTRAL),
    ),
    servo=1500,
    throttle=1622,
)
PUBLISHED_REPLY = TeensyReply((MotorReport(1, -1.5, 8.0, 0.25), MotorReport(2, 0.0, -0.5, -3.0)), sail=271.25)
CHECKED_REPLY = TeensyReply(
    (MotorReport(1, -1.5, 8.0, 0.25, 7, 31, 0), MotorReport(2, 0.0, -0.5, -3.0, 255, -5, 2)),
    sail=271.25,
    clock=4_000_000_000,
    status=TeensyStatus.WATCHDOG_ACTED,
)
REPLIES = {StringForm.PUBLISHED: PUBLISHED_REPLY, StringForm.CHECKED: CHECKED_REPLY}
FORMS = list(StringForm)


def test_published_command_has_the_printed_order_and_three_ends():
    assert make_command(COMMAND, StringForm.PUBLISHED) == (
        b"1;2;-1.50000;8.0000;17.0000;5.00000;0.2500|;2;0;0.00000;0.0000;0.0000;0.00000;0.0000|;1500;1622|"
    )


def test_published_reply_has_the_printed_order():
    assert make_reply(PUBLISHED_REPLY, StringForm.PUBLISHED) == (
        b"1;-1.50000;8.0000;0.2500;2;0.00000;-0.5000;-3.0000;271.250|"
    )


def test_checked_reply_adds_counter_temperature_fault_clock_status_and_checksum():
    body = b"1;-1.50000;8.0000;0.2500;2;0.00000;-0.5000;-3.0000;271.250;7;31;0;255;-5;2;4000000000;1"
    assert make_reply(CHECKED_REPLY, StringForm.CHECKED) == body + f";*{crc8(body):02X}|".encode()


def test_crc_is_the_one_of_the_catalogue():
    assert crc8(b"123456789") == 0xF4  # CRC-8/SMBUS, check value of the catalogue of parametrised CRCs


@pytest.mark.parametrize("form", FORMS)
def test_strings_survive_their_own_decoder(form):
    assert decode_command(make_command(COMMAND, form), form) == COMMAND
    assert decode_reply(make_reply(REPLIES[form], form), form) == REPLIES[form]


def test_spaces_and_line_ends_as_printed_in_the_thesis_are_read():
    text = b"\r\n1 ; -1.5 ; 8 ; 0.25 ; 2 ; 0 ; -0.5 ; -3 ; 271.25 |"
    assert decode_reply(text, StringForm.PUBLISHED) == PUBLISHED_REPLY


@pytest.mark.parametrize("form", FORMS)
def test_noise_before_the_first_delimiter_is_dropped(form):
    text = make_reply(REPLIES[form], form)
    assert reply_stream(form).feed(b"\xff\x00garbage;1;2|" + text) == [REPLIES[form]]
    assert command_stream(form).feed(b"5;|" + make_command(COMMAND, form)) == [COMMAND]


@pytest.mark.parametrize("cut", range(1, 60))
def test_stream_joined_in_the_middle_waits_for_the_next_string(cut):
    text = make_reply(PUBLISHED_REPLY, StringForm.PUBLISHED)
    stream = reply_stream(StringForm.PUBLISHED)
    assert stream.feed(text[cut:] + text) == ([PUBLISHED_REPLY] if cut < len(text) else [])


@pytest.mark.parametrize("form", FORMS)
def test_strings_cut_anywhere_arrive_whole(form):
    reply, command = make_reply(REPLIES[form], form), make_command(COMMAND, form)
    for size in (1, 2, 3, 7, 50, 500):
        replies, commands = reply_stream(form), command_stream(form)
        found = [item for start in range(0, 4 * len(reply), size) for item in replies.feed((reply * 4)[start:][:size])]
        assert found == [REPLIES[form]] * 3  # the first one ends the unsynchronised beginning
        found = [item for i in range(0, 4 * len(command), size) for item in commands.feed((command * 4)[i:][:size])]
        assert found == [COMMAND] * 3


@pytest.mark.parametrize("form", FORMS)
def test_damaged_string_is_dropped_and_the_next_one_read(form):
    text, reply = make_command(COMMAND, form), make_reply(REPLIES[form], form)
    stream = command_stream(form)
    assert stream.feed(b"|" + text[:20] + b"x" + text[21:] + text) == [COMMAND]
    assert stream.rejected > 0
    replies = reply_stream(form)
    assert replies.feed(b"|" + reply[:20] + reply[25:].replace(b";", b":") + reply) == [REPLIES[form]]
    assert replies.rejected == 1
    assert replies.last_error


def test_every_changed_byte_is_noticed_in_the_checked_form():
    text = make_reply(CHECKED_REPLY, StringForm.CHECKED)
    for place in range(len(text)):
        for byte in range(256):
            if byte == text[place]:
                continue
            changed = text[:place] + bytes([byte]) + text[place + 1 :]
            try:
                decoded = decode_reply(changed, StringForm.CHECKED)
            except FrameError:
                continue
            # blanks may stand between fields and around the string, nothing else may change unnoticed
            assert decoded == CHECKED_REPLY, changed


def test_every_lost_byte_is_noticed_in_the_checked_form():
    text = make_command(COMMAND, StringForm.CHECKED)
    for place in range(len(text)):
        with pytest.raises(FrameError):
            decode_command(text[:place] + text[place + 1 :], StringForm.CHECKED)


def test_endless_noise_does_not_grow():
    stream = reply_stream(StringForm.PUBLISHED)
    stream.feed(b"|")
    for _ in range(1000):
        assert not stream.feed(b"x" * 100)
    assert len(stream._open) <= 201
    assert stream.feed(b"|" + make_reply(PUBLISHED_REPLY, StringForm.PUBLISHED)) == [PUBLISHED_REPLY]


@pytest.mark.parametrize("field", ["position", "velocity", "kp", "kd", "torque"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_nan_is_never_written(field, value):
    order = dataclasses.replace(COMMAND.motors[0], command=dataclasses.replace(NEUTRAL, **{field: value}))
    with pytest.raises(FrameError, match=field):
        make_command(dataclasses.replace(COMMAND, motors=(order, COMMAND.motors[1])), StringForm.PUBLISHED)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"servo": 949}, "servo pulse 949 us: allowed is 950 to 2050"),
        ({"servo": 2051}, "servo pulse 2051"),
        ({"throttle": 1099}, "throttle pulse 1099 us: allowed is 1100 to 1900"),
        ({"throttle": 1901}, "throttle pulse 1901"),
        ({"throttle": 1500.0}, "throttle pulse"),
    ],
)
def test_pulses_out_of_range_are_refused(changes, message):
    with pytest.raises(FrameError, match=message):
        make_command(dataclasses.replace(COMMAND, **changes), StringForm.PUBLISHED)


def test_two_motors_with_one_id_are_refused():
    twin = dataclasses.replace(COMMAND.motors[1], motor_id=1)
    with pytest.raises(FrameError, match="both motors have the id 1"):
        make_command(TeensyCommand((COMMAND.motors[0], twin)), StringForm.PUBLISHED)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"|",
        b"1;2;3|",
        b"1;nan;0;0;2;0;0;0;0|",
        b"1;inf;0;0;2;0;0;0;0|",
        b"1;1e3;0;0;2;0;0;0;0|",
        b"1;0x1;0;0;2;0;0;0;0|",
        b"1;;0;0;2;0;0;0;0|",
        b"1;--1;0;0;2;0;0;0;0|",
        b"1;1_0;0;0;2;0;0;0;0|",
        b"1;0;0;0;2;0;0;0;361|",
        b"1;0;0;0;1;0;0;0;0|",
        b"0;0;0;0;2;0;0;0;0|",
        b"1;0;0;0;2;0;0;0;0;0|",
        b"1;101;0;0;2;0;0;0;0|",
        b"1;0;0;0;2;0;0;0;0",
        "1;0;0;0;2;0;0;0;\u0661|".encode(),
    ],
)
def test_reply_that_is_not_one_is_refused(text):
    with pytest.raises(FrameError):
        decode_reply(text, StringForm.PUBLISHED)
