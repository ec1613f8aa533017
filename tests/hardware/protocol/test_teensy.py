"""Strings of the Teensy: the printed fields and the added ones to the letter, and streams with
noise.
"""

import math
from dataclasses import replace

import pytest

from aerodima.hardware.devices.teensy_link import ReplyStream
from aerodima.hardware.protocol.ak70 import NEUTRAL, MitCommand, MitReply
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.teensy import (
    Attitude,
    MotorOrder,
    MotorReport,
    MotorRequest,
    TeensyCommand,
    TeensyReply,
    TeensyStatus,
    crc8,
    decode_reply,
    make_command,
)
from tests.refusals import assert_refused

COMMAND = TeensyCommand(
    (
        MotorOrder(1, MotorRequest.COMMAND, MitCommand(-1.5, 8.0, 17.0, 5.0, 0.25)),
        MotorOrder(2, MotorRequest.EXIT, NEUTRAL),
    ),
    servo=1500,
    throttle=1622,
)
REPLY = TeensyReply(
    (
        MotorReport(MitReply(1, -1.5, 8.0, 0.25, 31, 0), 7),
        MotorReport(MitReply(2, 0.0, -0.5, -3.0, -5, 2), 255),
    ),
    sail=271.25,
    clock=4_000_000_000,
    status=TeensyStatus.WATCHDOG_ACTED,
)


def closed(body):
    return body + f";*{crc8(body):02X}|".encode()


TEXT = closed(
    b"1;-1.50000;8.0000;0.2500;2;0.00000;-0.5000;-3.0000;271.250;7;31;0;255;-5;2;4000000000;1"
)


@pytest.mark.parametrize(
    ("attitude", "fields"),
    [
        (None, b";0.0000;0.0000;65535;0.0000;0.0000"),
        (Attitude(0.1, -0.2, 8, 0.3, -1.5), b";0.1000;-0.2000;8;0.3000;-1.5000"),
        (Attitude(0, 0, 10**9), b"65534;0.0000;0.0000"),
    ],
)
def test_a_command_has_the_printed_order_and_three_ends_then_attitude_and_checksum(
    attitude, fields
):
    printed = (
        b"1;2;-1.50000;8.0000;17.0000;5.00000;0.2500|"
        b";2;0;0.00000;0.0000;0.0000;0.00000;0.0000|;1500;1622"
    )
    text = make_command(replace(COMMAND, attitude=attitude))
    assert text.startswith(printed)
    body = text[:-5]
    assert body.endswith(fields)
    assert closed(body) == text


def test_a_reply_is_read():
    assert decode_reply(TEXT) == REPLY


def test_crc_is_the_one_of_the_catalogue():
    assert (
        crc8(b"123456789") == 0xF4
    )  # CRC-8/SMBUS, check value of the catalogue of parametrised CRCs


def test_spaces_and_line_ends_as_printed_in_the_thesis_are_read():
    body = (
        b"1 ; -1.5 ; 8 ; 0.25 ; 2 ; 0 ; -0.5 ; -3 ; 271.25 ; 7 ; 31 ; 0 ; 255 ; -5 ; 2 ; "
        b"4000000000 ; 1 "
    )
    assert decode_reply(b"\r\n" + closed(body)) == REPLY


@pytest.mark.parametrize("cut", range(1, 60))
def test_stream_joined_in_the_middle_waits_for_the_next_string(cut):
    assert ReplyStream().feed(TEXT[cut:] + TEXT) == [REPLY]


def test_every_changed_byte_is_noticed():
    for place in range(len(TEXT)):
        for byte in range(256):
            if byte == TEXT[place]:
                continue
            changed = TEXT[:place] + bytes([byte]) + TEXT[place + 1 :]
            try:
                decoded = decode_reply(changed)
            except FrameError:
                continue
            # blanks may stand between fields and around the string, nothing else may change
            # unnoticed
            assert decoded == REPLY, changed


def test_every_lost_byte_is_noticed():
    for place in range(len(TEXT)):
        shorter = TEXT[:place] + TEXT[place + 1 :]
        assert_refused(lambda text=shorter: decode_reply(text), FrameError)


def test_endless_noise_does_not_grow():
    stream = ReplyStream()
    stream.feed(b"|")
    for _ in range(1000):
        assert not stream.feed(b"x" * 100)
    assert len(stream._open) <= 201
    assert stream.feed(b"|" + TEXT) == [REPLY]


PUSH, REST = COMMAND.motors
WRONG = [
    *(
        (
            {
                "motors": (
                    replace(PUSH, command=replace(NEUTRAL, **{name: value})),
                    COMMAND.motors[1],
                )
            },
            name,
            str(value),
        )
        for name in ("position", "velocity", "kp", "kd", "torque")
        for value in (math.nan, math.inf)
    ),
    ({"servo": 949}, "servo", "949"),
    ({"servo": 2051}, "servo", "2051"),
    ({"throttle": 1099}, "throttle", "1099"),
    ({"throttle": 1901}, "throttle", "1901"),
    ({"throttle": 1500.0}, "throttle", "1500.0"),
    ({"attitude": Attitude(3.3, 0.0, 1)}, "roll", "3.3"),
    ({"attitude": Attitude(0.0, math.nan, 1)}, "pitch", "nan"),
    ({"attitude": Attitude(0.0, 0.0, 1, -0.1)}, "lean", "-0.1"),
    ({"attitude": Attitude(0.0, 0.0, 1, 0.1, 41.0)}, "yaw_rate", "41"),
    ({"motors": (PUSH, replace(REST, motor_id=1))}, "id", "1"),
]


@pytest.mark.parametrize(("changes", "key", "value"), WRONG)
def test_values_out_of_range_are_refused(changes, key, value):
    command = replace(COMMAND, **changes)
    assert_refused(lambda: make_command(command), FrameError, key, value)


HEALTH = b";0;20;0;0;20;0;5;0"


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"|",
        TEXT[:-1],
        TEXT[:-5] + b"|",
        closed(b"1;2;3"),
        *(
            closed(fields + HEALTH)
            for fields in (
                b"1;nan;0;0;2;0;0;0;0",
                b"1;inf;0;0;2;0;0;0;0",
                b"1;1e3;0;0;2;0;0;0;0",
                b"1;0x1;0;0;2;0;0;0;0",
                b"1;;0;0;2;0;0;0;0",
                b"1;--1;0;0;2;0;0;0;0",
                b"1;1_0;0;0;2;0;0;0;0",
                b"1;0;0;0;2;0;0;0;361",
                b"1;0;0;0;1;0;0;0;0",
                b"0;0;0;0;2;0;0;0;0",
                b"1;0;0;0;2;0;0;0;0;0",
                b"1;101;0;0;2;0;0;0;0",
                "1;0;0;0;2;0;0;0;\u0661".encode(),
            )
        ),
        closed(b"1;0;0;0;2;0;0;0;0;256;20;0;0;20;0;5;0"),
        closed(b"1;0;0;0;2;0;0;0;0;0;20;0;0;20;0;5;4"),
    ],
)
def test_reply_that_is_not_one_is_refused(text):
    assert_refused(lambda: decode_reply(text), FrameError)
