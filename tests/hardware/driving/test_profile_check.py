"""A wrong firmware profile is noticed by turning the motor by hand."""

import math

import pytest

from aerodima.hardware.driving.drive_checks import check_profile
from aerodima.hardware.protocol.ak70 import (
    AK70_10_24_N_M,
    AK70_10_V1_0_8,
    MANUAL_SAMPLE_CODE,
    MitReply,
    make_reply,
)
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.errors import HardwareError

BY_HAND = [(0.01 * i, 0.4 * math.sin(0.03 * i), 1.2 * math.cos(0.03 * i)) for i in range(200)]
AT_REST = [(0.01 * i, 0.3, 0.0) for i in range(200)]


def replies(motion, firmware, **long_form):
    return [
        (time, make_reply(MitReply(1, place, speed, 0.0, **long_form), firmware))
        for time, place, speed in motion
    ]


@pytest.mark.parametrize("firmware", [AK70_10_V1_0_8, MANUAL_SAMPLE_CODE])
def test_right_profile_reports_the_speed_of_its_position(firmware):
    evidence = check_profile(firmware, replies(BY_HAND, firmware))
    assert evidence.speed_ratio == pytest.approx(1.0, abs=0.1)
    assert (evidence.replies, evidence.reply_length) == (200, 6)


def test_sample_code_ranges_on_a_motor_of_the_manual_are_refused_with_what_fits():
    with pytest.raises(
        HardwareError, match=r"manual_sample_code.*profiles that fit: ak70_10_v1_0_8"
    ) as caught:
        check_profile(MANUAL_SAMPLE_CODE, replies(BY_HAND, AK70_10_V1_0_8))
    assert "manual_sample_code" not in str(caught.value).split("fit:")[1]


def test_manual_ranges_on_a_motor_of_the_sample_code_are_refused():
    fast = [(time, 5 * place, 5 * speed) for time, place, speed in BY_HAND]
    with pytest.raises(HardwareError, match="profiles that fit: manual_sample_code"):
        check_profile(AK70_10_V1_0_8, replies(fast, MANUAL_SAMPLE_CODE))


def test_resting_motor_tells_nothing_about_the_ranges():
    assert check_profile(AK70_10_V1_0_8, replies(AT_REST, AK70_10_V1_0_8)).speed_ratio is None


def test_torque_range_cannot_be_told():
    assert check_profile(
        AK70_10_24_N_M, replies(BY_HAND, AK70_10_V1_0_8)
    ).speed_ratio == pytest.approx(1, abs=0.1)


def test_replies_of_another_length_are_refused():
    with pytest.raises(HardwareError, match="reply of 8 bytes; manual_sample_code sends 6"):
        check_profile(
            MANUAL_SAMPLE_CODE, replies(AT_REST, AK70_10_V1_0_8, temperature=30.0, fault=0)
        )
    mixed = replies(AT_REST, AK70_10_V1_0_8) + replies(
        AT_REST, AK70_10_V1_0_8, temperature=30.0, fault=0
    )
    with pytest.raises(HardwareError, match="two motors on one id"):
        check_profile(AK70_10_V1_0_8, mixed)


def test_temperature_that_cannot_be_is_refused():
    with pytest.raises(HardwareError, match="200 degC cannot be"):
        check_profile(AK70_10_V1_0_8, replies(AT_REST, AK70_10_V1_0_8, temperature=200.0, fault=0))


def test_v3_firmware_and_silence_are_refused():
    with pytest.raises(HardwareError, match="V3 firmware"):
        check_profile(AK70_10_V1_0_8, [(0.0, CanFrame(0x2901, bytes(8), extended=True))])
    with pytest.raises(HardwareError, match="no reply of the motor"):
        check_profile(AK70_10_V1_0_8, [])
