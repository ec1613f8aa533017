"""Whatever bytes arrive: a decoder returns a value that stands for exactly these bytes, or says
`FrameError`.

The slow set gives each decoder its share of 100,000 inputs, the fast one a few hundred.
"""

import math
from dataclasses import astuple

import pytest
from hypothesis import strategies as st

from aerodima.hardware.devices.teensy_link import ReplyStream
from aerodima.hardware.protocol import ak70, radio, teensy
from aerodima.hardware.protocol.ak70 import PROFILES
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from tests.hardware.fuzzing import fuzz

FAST = 200
SHARES = {"reply": 25_000, "radio": 25_000, "string": 10_000, "stream": 5_000}


def fuzzed(decoder, *strategies):
    """Makes a property test of two sizes: a few hundred inputs in the fast set, its share of all in
    the slow one.
    """

    def decorate(test):
        def run(count):
            fuzz(test, count, *strategies)

        counts = [
            pytest.param(FAST, id="fast"),
            pytest.param(SHARES[decoder], id="slow", marks=pytest.mark.slow),
        ]
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


@fuzzed(
    "radio",
    st.one_of(
        st.binary(max_size=24),
        st.builds(
            radio.PACKED.pack, st.integers(0, 4), st.integers(0, 4), *4 * [st.floats(width=32)]
        ),
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
    st.lists(numbers, min_size=7, max_size=18).map(
        lambda fields: (";".join(fields) + "|").encode()
    ),
    st.lists(numbers, min_size=5, max_size=18).map(
        lambda fields: ("1;0.5;0;0;2;" + ";".join(fields) + "|").encode()
    ),
)


def checked(text):
    body = text.rstrip(b"|")
    return body + f";*{teensy.crc8(body):02X}|".encode()


@fuzzed("string", strings, st.booleans())
def test_teensy_string(text, close):
    try:
        result = teensy.decode_reply(checked(text) if close else text)
    except FrameError:
        return
    assert finite(value for motor in result.motors for value in astuple(motor))


@fuzzed(
    "stream", st.lists(strings, max_size=4), st.lists(st.integers(1, 60), min_size=1, max_size=6)
)
def test_streams_resynchronise_after_any_noise(noise, sizes):
    good = checked(b"1;0.5;0;0;2;0;0;0;90;1;20;0;1;20;0;5;0")
    stream = ReplyStream()
    data = b"".join(noise) + b"|" + 2 * good
    found = []
    i = 0
    while data:
        size = sizes[i % len(sizes)]
        found += stream.feed(data[:size])
        data = data[size:]
        i = i + 1
    assert found
    assert found[-1].motors[0].position == 0.5
