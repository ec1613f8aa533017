"""Sail encoder: 12 bits as the thesis reads, 10 bits as the named part has (ERRATA E30)."""

import math

import pytest

from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.sail_encoder import (
    AEAT_6010,
    AEAT_6012,
    decode_word,
    encode_angle,
    encoder_profile,
    signed_angle,
)
from aerodima.workbench.errors import HardwareError

PARTS = [(AEAT_6012, 4096), (AEAT_6010, 1024)]


@pytest.mark.parametrize(("part", "words"), PARTS)
def test_a_quarter_of_the_words_is_a_quarter_turn(part, words):
    assert decode_word(words // 4, part) == pytest.approx(math.pi / 2)
    assert decode_word(0, part) == 0.0
    assert decode_word(words - 1, part) == pytest.approx(2 * math.pi * (words - 1) / words)


@pytest.mark.parametrize(("part", "words"), PARTS)
def test_word_survives_the_round_trip(part, words):
    assert all(encode_angle(decode_word(word, part), part) == word for word in range(words))
    assert encode_angle(-math.pi / 2, part) == 3 * words // 4
    assert encode_angle(2 * math.pi, part) == 0


@pytest.mark.parametrize(("part", "words"), PARTS)
def test_word_with_too_many_bits_is_refused(part, words):
    for word in (words, -1, 1.0, True):
        with pytest.raises(FrameError, match="bits"):
            decode_word(word, part)


def test_nan_angle_is_refused():
    with pytest.raises(FrameError, match="finite"):
        encode_angle(math.nan, AEAT_6012)


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [(0.0, 0.0), (90.0, math.pi / 2), (180.0, math.pi), (270.0, -math.pi / 2), (360.0, 0.0)],
)
def test_degrees_of_the_string_become_signed_radians(degrees, expected):
    assert signed_angle(degrees) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("degrees", [-0.1, 360.1, math.nan, math.inf])
def test_degrees_out_of_range_are_refused(degrees):
    with pytest.raises(FrameError, match="0 to 360"):
        signed_angle(degrees)


def test_unknown_part_lists_the_known_ones():
    assert encoder_profile("aeat_6010") is AEAT_6010
    with pytest.raises(HardwareError, match="aeat_6012, aeat_6010"):
        encoder_profile("as5600")
