"""The C++ core and the Python protocol read and write the same bytes."""

import math
import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from aerodima.hardware.devices.teensy_link import command_stream
from aerodima.hardware.firmware import firmware_core as core
from aerodima.hardware.protocol import ak70, teensy
from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8, MANUAL_SAMPLE_CODE, PROFILES, MitCommand
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.protocol.teensy import (
    MotorOrder,
    MotorReport,
    MotorRequest,
    StringForm,
    TeensyCommand,
    TeensyReply,
)

FORMS = st.sampled_from(StringForm)
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
    MitCommand, within(100.0), within(200.0), st.floats(0.0, 500.0), st.floats(0.0, 5.0), within(200.0)
)
ORDERS = st.tuples(st.integers(0, 70), st.sampled_from(MotorRequest), COMMANDS)


@st.composite
def command_strings(draw, form=None):
    """A valid command string, or one of ids and pulses that the protocol refuses."""
    form = form or draw(FORMS)
    orders = tuple(MotorOrder(motor_id, *rest) for motor_id, *rest in (draw(ORDERS), draw(ORDERS)))
    command = TeensyCommand(orders, draw(st.integers(950, 2050)), draw(st.integers(1100, 1900)))
    text = refused(teensy.make_command, command, form)
    return text if text is not None else b"1;0;0;0;0;0;0|;2;0;0;0;0;0;0|;1500;1500|"


@st.composite
def damaged_strings(draw):
    """A command string with some of its bytes replaced, removed or put in, of the kinds that the grammar looks at."""
    text = bytearray(draw(command_strings()))
    for _ in range(draw(st.integers(0, 3))):
        place = draw(st.integers(0, len(text)))
        text[place : place + draw(st.integers(0, 2))] = draw(
            st.sampled_from(
                [b"", b" ", b";", b"|", b"-", b"+", b".", b"0", b"9", b"\r\n", b"*", b"\0", b"\xff", b"e", b"nan"]
            )
        )
    return bytes(text)


@EXAMPLES
@given(damaged_strings(), FORMS)
@example(b"1;0;0;0;0;0;0|;2;0;0;0;0;0;0|;1500;1500|", StringForm.PUBLISHED)
@example(b" 1 ; 0 ; 0. ; -0 ; 007 ; +1 ; 0|; 2;0;0;0;0;0;0 |;1500 ;1500 \r\n|", StringForm.PUBLISHED)
@example(b"1;-0;0;0;0;0;0|;2;0;0;0;0;0;0|;1500;1500|", StringForm.PUBLISHED)
@example(b"1;0;0.0000000000;0;0;0;0|;2;0;0;0;0;0;0|;1500;1500|", StringForm.PUBLISHED)
@example(b"1;0;.5;0;0;0;0|;2;0;0;0;0;0;0|;1500;1500|", StringForm.PUBLISHED)
@example(b"|", StringForm.CHECKED)
@example(b";*00|", StringForm.CHECKED)
@example(b"", StringForm.CHECKED)
def test_command_strings_are_read_alike(text, form):
    assert refused(core.decode_command, text, form) == refused(teensy.decode_command, text, form)


@EXAMPLES
@given(st.binary(max_size=80), FORMS)
def test_arbitrary_bytes_are_refused_alike(text, form):
    assert refused(core.decode_command, text + b"|", form) == refused(teensy.decode_command, text + b"|", form)


@FEW
@given(st.data(), FORMS)
def test_streams_with_noise_and_partial_strings_give_the_same_commands(data, form):
    noise = st.one_of(
        st.binary(max_size=30),
        command_strings(form).flatmap(lambda text: st.integers(0, len(text)).map(lambda cut: text[cut:])),
        st.just(b"x" * 450),
    )
    stream = b"".join(
        data.draw(st.lists(st.one_of(command_strings(form), noise), min_size=1, max_size=6), label="pieces")
    )
    python, cpp, found = command_stream(form), core.CommandReader(form), []
    place = 0
    while place < len(stream):
        size = data.draw(st.integers(1, 90), label="chunk")
        expected = python.feed(stream[place : place + size])
        count, newest = cpp.feed(stream[place : place + size])
        place += size
        assert (count, newest) == (len(expected), expected[-1] if expected else None)
        assert cpp.rejected == python.rejected
        found += expected


def test_a_stream_that_begins_in_the_middle_of_a_string_is_read_from_the_next_one_on():
    order = MotorOrder(1, MotorRequest.COMMAND, MitCommand(1.5, 0.0, 10.0, 1.0, 0.0))
    command = TeensyCommand((order, MotorOrder(2, MotorRequest.EXIT, ak70.NEUTRAL)), 1600, 1500)
    text = teensy.make_command(command, StringForm.CHECKED)
    reader = core.CommandReader(StringForm.CHECKED)
    assert reader.feed(text[11:]) == (0, None)
    assert reader.feed(text) == (1, command)


@FEW
@given(
    st.lists(
        st.tuples(*[within(1e4)] * 3, st.integers(0, 255), st.integers(-40, 255), st.integers(0, 255)),
        min_size=2,
        max_size=2,
    ),
    st.lists(st.integers(0, 70), min_size=2, max_size=2),
    st.floats(0.0, 360.0),
    st.integers(0, 2**32 - 1),
    st.sampled_from(teensy.TeensyStatus),
    FORMS,
)
def test_reply_strings_are_written_alike(states, ids, sail, clock, status, form):
    reports = tuple(MotorReport(motor_id, *state) for motor_id, state in zip(ids, states, strict=True))
    reply = TeensyReply(reports, sail, clock, status)
    assert refused(core.make_reply, reply, form) == refused(teensy.make_reply, reply, form)


def test_a_reply_that_is_not_finite_is_refused():
    reports = (MotorReport(1, math.nan, 0.0, 0.0, 0, 0, 0), MotorReport(2, 0.0, 0.0, 0.0, 0, 0, 0))
    assert (
        refused(core.make_reply, TeensyReply(reports, 0.0, 0, teensy.TeensyStatus.RUNNING), StringForm.CHECKED) is None
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
@given(st.integers(0, 0x7F), st.integers(0, 70), st.binary(max_size=7), st.booleans(), st.booleans())
def test_replies_of_motors_are_read_alike(arbitration_id, first, rest, extended, own):
    data = bytes([first]) + rest
    frame = CanFrame(first if own else arbitration_id, data, extended)
    for profile in (AK70_10_V1_0_8, MANUAL_SAMPLE_CODE):
        assert refused(core.decode_reply, frame, profile) == refused(ak70.decode_reply, frame, profile)


@pytest.mark.parametrize("profile", PROFILES.values(), ids=lambda profile: profile.name)
def test_frames_agree_over_many_random_commands(profile):
    generator = random.Random(1)
    for _ in range(5000):
        command = MitCommand(
            generator.uniform(-profile.position, profile.position),
            generator.uniform(-profile.speed, profile.speed),
            generator.uniform(0, profile.kp),
            generator.uniform(0, profile.kd),
            generator.uniform(-profile.torque, profile.torque),
        )
        assert core.make_command(7, command, profile) == ak70.make_command(7, command, profile)


@FEW
@given(st.binary(max_size=100))
def test_checksums_agree(data):
    assert core.crc8(data) == teensy.crc8(data)
