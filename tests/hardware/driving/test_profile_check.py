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
from aerodima.workbench.core.errors import HardwareError
from tests.refusals import assert_refused

BY_HAND = [(0.01 * i, 0.4 * math.sin(0.03 * i), 1.2 * math.cos(0.03 * i)) for i in range(200)]
AT_REST = [(0.01 * i, 0.3, 0.0) for i in range(200)]


def replies(motion, firmware, **long_form):
    return [
        (time, make_reply(MitReply(1, place, speed, 0.0, **long_form), firmware))
        for time, place, speed in motion
    ]


@pytest.mark.parametrize("firmware", [AK70_10_V1_0_8, MANUAL_SAMPLE_CODE])
def test_right_profile_reports_the_speed_of_its_position(firmware):
    ratio = check_profile(firmware, replies(BY_HAND, firmware))
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_resting_motor_tells_nothing_about_the_ranges():
    assert check_profile(AK70_10_V1_0_8, replies(AT_REST, AK70_10_V1_0_8)) is None


def test_torque_range_cannot_be_told():
    ratio = check_profile(AK70_10_24_N_M, replies(BY_HAND, AK70_10_V1_0_8))
    assert ratio == pytest.approx(1, abs=0.1)


HEALTH = {"temperature": 30.0, "fault": 0}
SHORT = replies(AT_REST, AK70_10_V1_0_8)
LONG = replies(AT_REST, AK70_10_V1_0_8, **HEALTH)
FAST = [(time, 5 * place, 5 * speed) for time, place, speed in BY_HAND]
SAMPLE, MANUAL = MANUAL_SAMPLE_CODE, AK70_10_V1_0_8
REFUSED = {
    "ranges of the sample code": (SAMPLE, replies(BY_HAND, MANUAL), SAMPLE.name, MANUAL.name),
    "ranges of the manual": (MANUAL, replies(FAST, SAMPLE), MANUAL.name, SAMPLE.name),
    "another length": (SAMPLE, LONG, SAMPLE.name, "8"),
    "both lengths": (MANUAL, SHORT + LONG, "id"),
    "impossible temperature": (
        MANUAL, replies(AT_REST, MANUAL, temperature=200.0, fault=0), "200"
    ),
    "V3 firmware": (MANUAL, [(0.0, CanFrame(0x2901, bytes(8), extended=True))], "V3"),
    "silence": (MANUAL, []),
}  # fmt: skip


@pytest.mark.parametrize("row", REFUSED.values(), ids=REFUSED)
def test_replies_that_do_not_fit_the_profile_are_refused(row):
    profile, heard, *named = row
    assert_refused(lambda: check_profile(profile, heard), HardwareError, *named)


def test_of_the_profiles_only_those_that_fit_are_named():
    with pytest.raises(HardwareError) as caught:
        check_profile(SAMPLE, replies(BY_HAND, MANUAL))
    assert str(caught.value).count(SAMPLE.name) == 1
