"""Whatever bytes arrive: a decoder returns a value that stands for exactly these bytes, or says `FrameError`.

The slow set gives each decoder its share of 100,000 inputs, the fast one a few hundred.
"""

import math
from dataclasses import astuple

import pytest
from hypothesis import strategies as st

from aerodima.hardware.devices.teensy_link import command_stream, reply_stream
from aerodima.hardware.protocol import ak70, radio, sail_encoder, teensy
from aerodima.hardware.protocol.ak70 import PROFILES
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.protocol.teensy import StringForm
from tests.hardware.fuzzing import fuzz

FAST = 200
SHARES = {"reply": 25_000, "command": 15_000, "radio": 25_000, "string": 10_000, "stream": 5_000, "sail": 20_000}


def fuzzed(decoder: str, *strategies):
    """Makes a property test of two sizes: a few hundred inputs in the fast set, its share of all in the slow one."""

    def decorate(test):
        def run(count):
            fuzz(test, count, *strategies)

        counts = [pytest.param(FAST, id="fast"), pytest.param(SHARES[decoder], id="slow", marks=pytest.mark.slow)]
        return pytest.mark.parametrize("count", counts)(run)

    return decorate


def finite(values):
    return all(math.isfinite(value) for value in values if isinstance(value, float))


profiles = st.sampled_from(sorted(PROFILES))
can_bytes = st.one_of(
    st.binary(max_size=8),
    st.binary(min_size=6, max_size=6).map(lambda data: bytes([1 + data[0] % 63]) + data[1:]),
    st.binary(min_size=8, max_size=8).map(lambda data: bytes([1 + data[0] % 63]) + data[1:]),
    st.just(b"\xff" * 7).map(lambda data: data + b"\xfd"),
)


@fuzzed("reply", can_bytes, st.one_of(st.just(0), st.integers(0, 0x7FF)), st.booleans(), profiles)
def test_motor_reply(data, arbitration_id, extended, name):
    profile = PROFILES[name]
    frame = CanFrame(arbitration_id, data, extended)
    try:
        reply = ak70.decode_reply(frame, profile)
    except FrameError:
        return
    assert not extended
    assert finite(astuple(reply))
    assert abs(reply.position) <= profile.position
    assert abs(reply.velocity) <= profile.speed
    assert abs(reply.torque) <= profile.torque
    assert ak70.make_reply(reply, profile, arbitration_id) == frame


@fuzzed("command", st.binary(min_size=6, max_size=9), profiles)
def test_motor_command(data, name):
    profile = PROFILES[name]
    try:
        command = ak70.decode_command(data, profile)
    except FrameError:
        assert len(data) != 8 or data.startswith(b"\xff" * 7)
        return
    assert finite(astuple(command))
    assert ak70.make_command(1, command, profile).data == data


@fuzzed(
    "radio",
    st.one_of(
        st.binary(max_size=24),
        st.builds(radio.PACKED.pack, st.integers(0, 4), st.integers(0, 4), *4 * [st.floats(width=32)]),
    ),
)
def test_radio_frame(data):
    try:
        message = radio.decode(data)
    except FrameError:
        return
    assert len(data) == 18
    if isinstance(message, radio.OperatorCommand):
        assert finite(astuple(message))
        assert radio.make_command(message) == data
    elif isinstance(message, radio.Heartbeat):
        assert radio.make_heartbeat(message.counter) == data
    else:
        assert data[0] == radio.RadioClass.EMERGENCY_STOP


numbers = st.one_of(
    st.integers(-300, 300).map(str),
    st.floats(-300, 300, allow_nan=False).map(lambda value: f"{value:.4f}"),
    st.text("0123456789.-+e;*| \r\n", max_size=6),
    st.sampled_from(["1", "2", "0", "nan", "inf", "1e5", "", "-0.0"]),
)
strings = st.one_of(
    st.binary(max_size=120),
    st.lists(numbers, min_size=7, max_size=18).map(lambda fields: (";".join(fields) + "|").encode()),
    st.lists(numbers, min_size=5, max_size=18).map(lambda fields: ("1;0.5;0;0;2;" + ";".join(fields) + "|").encode()),
)


def checked(text: bytes) -> bytes:
    body = text.rstrip(b"|")
    return body + f";*{teensy.crc8(body):02X}|".encode()


@fuzzed("string", strings, st.sampled_from(StringForm), st.booleans())
def test_teensy_string(text, form, close):
    text = checked(text) if close and form is StringForm.CHECKED else text
    for decode, make in ((teensy.decode_reply, teensy.make_reply), (teensy.decode_command, teensy.make_command)):
        try:
            result = decode(text, form)
        except FrameError:
            continue
        assert finite(value for motor in result.motors for value in astuple(motor))
        again = decode(make(result, form), form)
        assert [motor.motor_id for motor in again.motors] == [motor.motor_id for motor in result.motors]
        for before, after in zip(result.motors, again.motors, strict=True):
            before, after = (getattr(motor, "command", motor) for motor in (before, after))
            assert (after.position, after.velocity, after.torque) == pytest.approx(
                (before.position, before.velocity, before.torque), abs=1e-4
            )


@fuzzed(
    "stream",
    st.lists(strings, max_size=4),
    st.lists(st.integers(1, 60), min_size=1, max_size=6),
    st.sampled_from(StringForm),
)
def test_streams_resynchronise_after_any_noise(noise, sizes, form):
    order = teensy.MotorOrder(1, teensy.MotorRequest.COMMAND, ak70.MitCommand(0.5, 0, 17, 5, 0))
    command = teensy.TeensyCommand((order, teensy.MotorOrder(2, teensy.MotorRequest.EXIT, ak70.NEUTRAL)))
    reports = (teensy.MotorReport(1, 0.5, 0, 0, 1, 20, 0), teensy.MotorReport(2, 0, 0, 0, 1, 20, 0))
    reply = teensy.TeensyReply(reports, 90.0, 5, teensy.TeensyStatus.RUNNING)
    for stream, good in (
        (command_stream(form), teensy.make_command(command, form)),
        (reply_stream(form), teensy.make_reply(reply, form)),
    ):
        data, found, i = b"".join(noise) + b"|" + 2 * good, [], 0
        while data:
            size = sizes[i % len(sizes)]
            found += stream.feed(data[:size])
            data, i = data[size:], i + 1
        assert found
        last = found[-1].motors[0]
        assert getattr(last, "command", last).position == 0.5


@fuzzed(
    "sail",
    st.one_of(st.integers(-10, 5000), st.integers()),
    st.sampled_from(sorted(sail_encoder.ENCODERS)),
    st.floats(),
)
def test_sail_readings(word, name, degrees):
    part = sail_encoder.ENCODERS[name]
    try:
        angle = sail_encoder.decode_word(word, part)
    except FrameError:
        assert not 0 <= word < 1 << part.bits
    else:
        assert sail_encoder.encode_angle(angle, part) == word
    try:
        signed = sail_encoder.signed_angle(degrees)
    except FrameError:
        assert not 0 <= degrees <= 360
    else:
        assert -math.pi < signed <= math.pi + 1e-12
