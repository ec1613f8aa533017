"""BNO055 bytes against the data sheet's tables, and a chip that answers as the real one does."""

import dataclasses
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerodima.hardware.devices.bno055 import (
    SAMPLE_BYTES,
    Answer,
    AnswerStream,
    Bno055Chip,
    Bno055Sample,
    Mode,
    Register,
    decode_sample,
    encode_sample,
    make_read,
    make_sample_request,
    make_write,
)
from aerodima.hardware.devices.sensor_threads import FrozenSensorMonitor
from aerodima.hardware.protocol.can_frame import FrameError
from tests.hardware.fuzzing import fuzz
from tests.refusals import assert_refused

HALF = math.sqrt(0.5)
LEVEL = Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_requests_are_the_bytes_of_the_data_sheet():
    assert make_read(Register.CHIP_ID, 1) == bytes.fromhex("AA010001")
    assert make_write(Register.MODE, bytes([Mode.IMU])) == bytes.fromhex("AA003D0108")
    assert make_sample_request() == bytes.fromhex("AA011422")


def test_words_have_the_units_of_the_data_sheet():
    sample = Bno055Sample(
        (HALF, 0.0, 0.0, HALF), (1.0, -2.0, 0.5), (9.81, -0.01, 3.27), (3, 2, 1, 0)
    )
    data = encode_sample(sample)
    assert len(data) == SAMPLE_BYTES == 34
    words = np.frombuffer(data[:6] + data[12:32], "<i2").tolist()
    gyro, gravity = [900, -1800, 450], [0, 0, 981]
    assert words == [*gyro, 11585, 0, 0, 11585, 981, -1, 327, *gravity]
    assert data[33:] == bytes([0b11100100])
    back = decode_sample(data)
    assert back.gyro == pytest.approx(sample.gyro, abs=1 / 1800)
    assert back.acceleration == pytest.approx(sample.acceleration, abs=0.005)
    assert back.calibration == (3, 2, 1, 0)


def test_a_turn_to_the_left_carries_the_chips_x_axis_to_the_worlds_y_axis():
    turned = decode_sample(
        encode_sample(Bno055Sample((HALF, 0.0, 0.0, HALF), (0.0,) * 3, (0.0,) * 3))
    )
    np.testing.assert_allclose(turned.rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-4)


def test_a_chip_without_fusion_is_refused():
    lifted = bytearray(encode_sample(LEVEL))
    lifted[31] ^= 0x04  # gravity
    leaning = bytearray(encode_sample(LEVEL))
    leaning[26:32] = struct.pack("<3h", 0, 340, 920)  # 20 degrees
    fast = encode_sample(dataclasses.replace(LEVEL, gyro=(0.0, -35.0, 0.0)))
    short = encode_sample(LEVEL)[:-1]
    for data in (bytes(SAMPLE_BYTES), bytes(lifted), bytes(leaning), fast, short):
        assert_refused(lambda data=data: decode_sample(data), FrameError)


def test_the_chip_answers_reads_and_writes_and_has_no_sample_before_its_fusion_runs():
    chip = Bno055Chip()
    stream = AnswerStream()
    chip.set_sample(LEVEL)
    assert chip.feed(make_read(Register.CHIP_ID, 1)) == bytes.fromhex("BB01A0")
    asleep = stream.feed(chip.feed(make_sample_request()))[0].data
    assert_refused(lambda: decode_sample(asleep), FrameError)
    request = make_write(Register.MODE, bytes([Mode.IMU]))
    assert chip.feed(request[:3]) == b""
    assert chip.feed(request[3:]) == bytes.fromhex("EE01")
    awake = stream.feed(chip.feed(make_sample_request()))[0].data
    assert decode_sample(awake).quaternion == LEVEL.quaternion
    assert chip.feed(make_read(0x7F, 2)) == bytes.fromhex("EE04")
    assert chip.feed(b"\x55") == bytes.fromhex("EE06")


@given(
    st.binary(max_size=20).filter(lambda noise: 0xBB not in noise and 0xEE not in noise),
    st.integers(1, 40),
)
@settings(max_examples=200, deadline=None)
def test_noise_before_an_answer_costs_nothing_however_it_is_cut(noise, piece):
    stream = AnswerStream()
    data = noise + bytes.fromhex("BB02A0FBEE01")
    found = [
        answer for at in range(0, len(data), piece) for answer in stream.feed(data[at : at + piece])
    ]
    assert found == [Answer(data=b"\xa0\xfb"), Answer(status=1)]


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_whatever_bytes_arrive_a_sample_is_finite_and_turns_or_is_refused(count):
    good = encode_sample(LEVEL)

    def check(data, plausible):
        if plausible:  # or hardly any would pass the checks
            data = data[:12] + good[12:20] + data[20:26] + good[26:32] + data[32:]
        try:
            sample = decode_sample(data)
        except FrameError:
            return
        np.testing.assert_allclose(sample.rotation @ sample.rotation.T, np.eye(3), atol=1e-9)
        again = encode_sample(sample)
        assert again[:6] + again[20:26] + again[33:] == data[:6] + data[20:26] + data[33:]

    fuzz(check, count, st.binary(min_size=SAMPLE_BYTES, max_size=SAMPLE_BYTES), st.booleans())


def test_a_sensor_that_says_the_same_to_the_last_bit_has_frozen():
    repeats = FrozenSensorMonitor("IMU")
    for _ in range(10):
        repeats.update((1.0, 0.5))
    assert repeats.fault_text == ""
    repeats.update((1.0, 0.5))
    assert "IMU" in repeats.fault_text
    assert "11" in repeats.fault_text
    repeats.update((1.0, 0.5001))
    assert repeats.fault_text == ""
    for _ in range(20):
        repeats.update((1.0, 0.5001), moves=False)
    assert repeats.fault_text == ""
