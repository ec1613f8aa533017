"""Frames of the GPS receiver: bytes by hand, checksums, noise, and what is said without a fix."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import calc_checksum

from aerodima.hardware.devices.ublox import (
    GpsSample,
    GpsStream,
    decode_nav_pvt,
    make_nav_pvt,
)
from aerodima.hardware.protocol.can_frame import FrameError
from tests.hardware.fuzzing import fuzz
from tests.refusals import assert_refused

RMC = b"$GNRMC,010203.00,A,0000.00000,N,00000.00000,E,6.479,,010126,,,A*72\r\n"
"""A receiver may send such sentences beside its frames; they are passed over."""
SAMPLE = GpsSample(3.333, True, 3723.5)


def nav_pvt(speed, flags=0x01, fix=3, accuracy=100):
    """A NAV-PVT by the offsets of UBX-13003221: fixType 20, flags 21, gSpeed 60, sAcc 68."""
    payload = bytearray(92)
    payload[8:12] = bytes([1, 2, 3, 0x07])  # 01:02:03, date and time valid
    payload[20] = fix
    payload[21] = flags
    struct.pack_into("<i", payload, 60, speed)
    struct.pack_into("<I", payload, 68, accuracy)
    body = b"\x01\x07" + struct.pack("<H", 92) + bytes(payload)
    return b"\xb5\x62" + body + calc_checksum(body)


def test_speed_is_read_from_where_the_specification_puts_it():
    sample = decode_nav_pvt(nav_pvt(3330))
    assert sample == GpsSample(3.33, True, 3723.0)


def test_encoder_and_decoder_agree():
    (sample,) = GpsStream().feed(make_nav_pvt(SAMPLE))
    assert sample.speed == pytest.approx(3.333, abs=5e-4)
    assert sample.fix
    assert sample.time_of_day == pytest.approx(3723.5, abs=1e-6)


@pytest.mark.parametrize(
    "frame",
    [
        nav_pvt(3330, flags=0),
        nav_pvt(3330, fix=5),
        nav_pvt(3330, accuracy=1001),
        make_nav_pvt(GpsSample(1.0, fix=False)),
    ],
)
def test_without_a_fix_the_speed_is_unknown(frame):
    (sample,) = GpsStream().feed(frame)
    assert not sample.fix
    assert math.isnan(sample.speed)


@pytest.mark.parametrize("frame", [nav_pvt(-1), nav_pvt(600_000)])
def test_impossible_fields_and_wrong_checksums_are_rejected(frame):
    assert GpsStream().feed(frame) == []
    assert_refused(lambda: decode_nav_pvt(frame), FrameError, "speed")


@given(st.binary(max_size=60).filter(lambda noise: b"\xb5" not in noise), st.integers(1, 120))
@settings(max_examples=100, deadline=None)
def test_noise_and_cuts_cost_no_frame(noise, piece):
    stream = GpsStream()
    data = noise + nav_pvt(1000) + noise + make_nav_pvt(SAMPLE) + RMC + noise + nav_pvt(2000)
    speeds = [
        s.speed for at in range(0, len(data), piece) for s in stream.feed(data[at : at + piece])
    ]
    assert speeds == pytest.approx([1.0, 3.333, 2.0], abs=1e-3)


@pytest.mark.parametrize(
    "start", [b"\xb5\x62\x01\x07\xff\x00", RMC, b"\xb5", b"\xb5\x62\x01\x07\x20\x03"]
)
def test_a_false_start_costs_at_most_the_frames_that_it_swallows(start):
    stream = GpsStream()
    speeds = [sample.speed for sample in stream.feed(start + nav_pvt(1000) * 4)]
    assert speeds == [1.0] * 4


@pytest.mark.parametrize("count", [200, pytest.param(10_000, marks=pytest.mark.slow)])
def test_a_damaged_frame_is_never_believed(count):
    good = nav_pvt(3330)

    def check(place, change):
        frame = bytearray(good)
        frame[place] ^= change
        assert GpsStream().feed(bytes(frame)) == []

    fuzz(check, count, st.integers(0, len(good) - 1), st.integers(1, 255))


@pytest.mark.parametrize("count", [200, pytest.param(5_000, marks=pytest.mark.slow)])
def test_whatever_bytes_arrive_a_speed_is_possible_or_nothing_is_said(count):
    def check(payload, noise):
        body = b"\x01\x07\x5c\x00" + payload
        for sample in GpsStream().feed(noise + b"\xb5\x62" + body + calc_checksum(body)):
            assert not sample.fix or 0.0 <= sample.speed <= 515.0

    fuzz(check, count, st.binary(min_size=92, max_size=92), st.binary(max_size=80))
