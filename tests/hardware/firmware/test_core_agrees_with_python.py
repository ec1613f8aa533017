"""The C++ core and the Python protocol read and write the same bytes."""

import math
from dataclasses import astuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from aerodima.hardware.protocol import ak70, teensy
from aerodima.hardware.protocol.ak70 import (
    AK70_10_V1_0_8,
    MANUAL_SAMPLE_CODE,
    PROFILES,
    MitCommand,
    MitReply,
)
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.protocol.teensy import (
    Attitude,
    MotorOrder,
    MotorReport,
    MotorRequest,
    TeensyCommand,
    TeensyReply,
    crc8,
)
from tests.hardware.firmware import core_functions as core

EXAMPLES = settings(max_examples=400, deadline=None)
FEW = settings(max_examples=150, deadline=None)


def refused(function, *arguments):
    """What a function makes of its arguments, or None when it refuses them."""
    try:
        return function(*arguments)
    except FrameError:
        return None


def within(limit):
    return st.floats(-limit, limit)


COMMANDS = st.builds(
    MitCommand,
    within(100.0),
    within(200.0),
    st.floats(0.0, 500.0),
    st.floats(0.0, 5.0),
    within(200.0),
)
ORDERS = st.tuples(st.integers(0, 70), st.sampled_from(MotorRequest), COMMANDS)


@st.composite
def commands(draw):
    """A command, also one of ids that the protocol refuses."""
    orders = tuple(MotorOrder(motor_id, *rest) for motor_id, *rest in (draw(ORDERS), draw(ORDERS)))
    attitude = draw(
        st.none()
        | st.builds(
            Attitude,
            within(3.2),
            within(3.2),
            st.integers(0, 65534),
            st.floats(0.0, 3.2),
            within(40.0),
        )
    )
    return TeensyCommand(
        orders, draw(st.integers(950, 2050)), draw(st.integers(1100, 1900)), attitude
    )


def closed(body):
    return body + f";*{crc8(body):02X}|".encode()


PLAIN = b"1;0;0;0;0;0;0|;2;0;0;0;0;0;0|;1500;1500;0;0;65535;0;0"


def numbers(command):
    """All of a command, flat."""
    attitude = command.attitude or Attitude(0.0, 0.0, 65535)
    orders = [
        value
        for order in command.motors
        for value in (order.motor_id, order.request, *astuple(order.command))
    ]
    return [*orders, command.servo, command.throttle, *astuple(attitude)]


@EXAMPLES
@given(commands())
def test_a_command_arrives_as_it_was_written(command):
    text = refused(teensy.make_command, command)
    if text is not None:
        assert numbers(core.decode_command(text)) == pytest.approx(numbers(command), abs=6e-5)


@pytest.mark.parametrize(
    "body",
    [
        PLAIN,
        b"1 ; 0 ; 0. ; -0 ; 007 ; +1 ; 0|; 2;0;0;0;0;0;0 |;1500 ;1500; 0;-0.0 ;65535 ;0. ; -0",
        PLAIN.replace(b"0", b"-0", 1),
    ],
)
def test_numbers_may_be_written_in_several_ways(body):
    assert core.decode_command(b"\r\n" + closed(body)).servo == 1500


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"|",
        b";*00|",
        PLAIN + b"|",
        closed(PLAIN)[:-1],
        closed(PLAIN).replace(b"15", b"16", 1),
        *(
            closed(PLAIN.replace(old, new, 1))
            for old, new in (
                (b"0;0;0;0", b".5;0;0;0"),
                (b"0;0;0;0", b"0.00000000000;0;0;0"),
                (b"0;0;0;0", b"nan;0;0;0"),
                (b"0;0;0;0", b"101;0;0;0"),
                (b"0;0;0;0", b"0;0;0"),
                (b"2;", b"1;"),
                (b"2;", b"0;"),
                (b"1500", b"949"),
                (b"1500", b"1500.0"),
                (b";0;0;65535;0;0", b""),
                (b"65535", b"65536"),
                (b"65535;0;0", b"65535"),
                (b"65535;0", b"65535;-1"),
                (b"65535;0;0", b"65535;0;41"),
                (b"0;0;65535", b"3.3;0;8"),
                (b"1;0", b"1;3"),
            )
        ),
    ],
)
def test_a_command_that_is_none_is_refused(text):
    assert refused(core.decode_command, text) is None


@pytest.mark.parametrize(
    "noise", [b"\xff\0|", closed(PLAIN)[7:], closed(PLAIN)[:-9] + b"|", b"x" * 450 + b"|", b"||"]
)
@pytest.mark.parametrize("size", [1, 2, 7, 90, 1000])
def test_a_stream_with_noise_and_partial_strings_gives_whole_commands(noise, size):
    stream = noise + closed(PLAIN) + noise + 2 * closed(PLAIN.replace(b"1500", b"1600", 1))
    reader = core.CommandReader()
    found = [reader.feed(stream[place : place + size]) for place in range(0, len(stream), size)]
    assert [command for count, command in found if count][-1].servo == 1600
    assert reader.rejected <= 6


def test_a_stream_that_begins_in_the_middle_of_a_string_is_read_from_the_next_one_on():
    order = MotorOrder(1, MotorRequest.COMMAND, MitCommand(1.5, 0.0, 10.0, 1.0, 0.0))
    command = TeensyCommand((order, MotorOrder(2, MotorRequest.EXIT, ak70.NEUTRAL)), 1600, 1500)
    text = teensy.make_command(command)
    reader = core.CommandReader()
    assert reader.feed(text[11:]) == (0, None)
    assert reader.feed(text) == (1, command)


HEALTH = st.tuples(st.integers(-40, 255), st.integers(0, 255)) | st.just((None, None))
REPORTS = st.builds(
    lambda motor_id, measured, replies, health: MotorReport(
        MitReply(motor_id, *measured, *health), replies
    ),
    st.integers(0, 70),
    st.tuples(*[within(100.0)] * 3),
    st.integers(0, 255),
    HEALTH,
)
REPLIES = st.builds(
    TeensyReply,
    st.tuples(REPORTS, REPORTS),
    st.floats(0.0, 360.0),
    st.integers(0, 2**32 - 1),
    st.sampled_from(teensy.TeensyStatus),
)


def flat(reply):
    reports = [(*report.state, report.replies) for report in reply.motors]
    known = [-1000 if value is None else value for values in reports for value in values]
    return [*known, reply.clock, reply.status]


@FEW
@given(REPLIES)
def test_a_reply_arrives_as_it_was_written(reply):
    text = refused(core.make_reply, reply)
    first, second = (report.state.motor_id for report in reply.motors)
    if text is None:
        assert min(first, second) < 1 or max(first, second) > ak70.MAX_ID or first == second
        return
    found = teensy.decode_reply(text)
    assert flat(found) == pytest.approx(flat(reply), abs=6e-5)
    assert found.sail == pytest.approx(reply.sail, abs=6e-4)


def test_a_reply_that_is_not_finite_is_refused():
    reports = (
        MotorReport(MitReply(1, math.nan, 0.0, 0.0, 0, 0), 0),
        MotorReport(MitReply(2, 0.0, 0.0, 0.0, 0, 0), 0),
    )
    assert (
        refused(core.make_reply, TeensyReply(reports, 0.0, 0, teensy.TeensyStatus.RUNNING)) is None
    )


@EXAMPLES
@given(
    st.integers(-1, 70),
    st.lists(st.floats(-1.2, 1.2), min_size=5, max_size=5),
    st.sampled_from(list(PROFILES.values())),
)
@example(1, [1.0, 1.0, 1.0, 1.0, 1.0], AK70_10_V1_0_8)  # the bytes of a special frame
@example(1, [-1.0, -1.0, 0.0, 0.0, -1.0], AK70_10_V1_0_8)
@example(1, [math.nan, 0.0, 0.0, 0.0, 0.0], AK70_10_V1_0_8)
@example(1, [0.0, 0.0, math.inf, 0.0, 0.0], AK70_10_V1_0_8)
def test_command_frames_are_made_alike(motor_id, shares, profile):
    ranges = (profile.position, profile.speed, profile.kp, profile.kd, profile.torque)
    command = MitCommand(*(share * limit for share, limit in zip(shares, ranges, strict=True)))
    assert refused(core.make_command, motor_id, command, profile) == refused(
        ak70.make_command, motor_id, command, profile
    )


@EXAMPLES
@given(
    st.integers(0, 0x7F), st.integers(0, 70), st.binary(max_size=7), st.booleans(), st.booleans()
)
def test_replies_of_motors_are_read_alike(arbitration_id, first, rest, extended, own):
    data = bytes([first]) + rest
    frame = CanFrame(first if own else arbitration_id, data, extended)
    for profile in (AK70_10_V1_0_8, MANUAL_SAMPLE_CODE):
        assert refused(core.decode_reply, frame, profile) == refused(
            ak70.decode_reply, frame, profile
        )
