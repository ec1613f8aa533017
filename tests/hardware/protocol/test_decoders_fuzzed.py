"""Whatever bytes arrive: a decoder returns a value that stands for exactly these bytes, or says
`FrameError`.

Replies of motors are compared with the firmware's core and with cantools.
"""

import math
from dataclasses import astuple

import pytest
from hypothesis import strategies as st

from aerodima.hardware.devices.teensy_link import ReplyStream
from aerodima.hardware.protocol import radio, teensy
from aerodima.hardware.protocol.can_frame import FrameError
from tests.hardware.fuzzing import fed_in_pieces, fuzz

FAST = 200


def fuzzed(slow, *strategies):
    """Makes a property test of two sizes: a few hundred inputs in the fast set, `slow` in the slow
    one.
    """

    def decorate(test):
        def run(count):
            fuzz(test, count, *strategies)

        counts = [
            pytest.param(FAST, id="fast"),
            pytest.param(slow, id="slow", marks=pytest.mark.slow),
        ]
        return pytest.mark.parametrize("count", counts)(run)

    return decorate


def finite(values):
    return all(math.isfinite(value) for value in values if isinstance(value, float))


@fuzzed(
    25_000,
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


@fuzzed(10_000, strings, st.booleans())
def test_teensy_string(text, close):
    try:
        result = teensy.decode_reply(checked(text) if close else text)
    except FrameError:
        return
    assert finite(value for report in result.motors for value in report.state)


@fuzzed(5_000, st.lists(strings, max_size=4), st.lists(st.integers(1, 60), min_size=1, max_size=6))
def test_streams_resynchronise_after_any_noise(noise, sizes):
    good = checked(b"1;0.5;0;0;2;0;0;0;90;1;20;0;1;20;0;5;0")
    found = fed_in_pieces(ReplyStream(), b"".join(noise) + b"|" + 2 * good, sizes)
    assert found
    assert found[-1].motors[0].state.position == 0.5
