"""Limits of a command, and where they come from."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from aerodima.hardware.devices.motor_limits import (
    check_command,
    commanded_torque,
    limit_command,
    to_motor,
)
from aerodima.hardware.protocol.ak70 import (
    AK70_10_24_N_M,
    MANUAL_SAMPLE_CODE,
    MitCommand,
    make_command,
)
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.fake_motors import PROFILE, Bench, hold, settings, tail_motor_parameters
from tests.refusals import assert_refused

ROLL = settings()


def test_physical_limits_are_those_of_the_scenario():
    parameters = tail_motor_parameters()
    assert ROLL.torque_limit == parameters.torque_limit == 24.8
    assert (ROLL.kp_max, ROLL.kd_max, ROLL.jump_speed) == (
        parameters.kp_max,
        parameters.kd_max,
        parameters.speed_range,
    )


def test_profile_that_can_say_less_limits_more():
    assert settings(profile=AK70_10_24_N_M).torque_limit == 24.0


def test_total_torque_is_limited_by_scaling_the_whole_loop():
    # kp (q_d - q) + kd (v_d - v) + tau = 100 * 1.5 + 5 * (8 - -2) + 3 = 203 N m
    command = MitCommand(1.5, 8.0, 100.0, 5.0, 3.0)
    limited = limit_command(command, 0.0, -2.0, ROLL)
    assert commanded_torque(limited, 0.0, -2.0) == pytest.approx(24.8)
    assert limited.kp / limited.kd == pytest.approx(100.0 / 5.0)
    assert limited.torque == pytest.approx(3.0 * 24.8 / 203)
    assert (limited.position, limited.velocity) == (1.5, 8.0)


def test_torque_within_the_limit_passes_unchanged():
    command = MitCommand(0.5, 1.0, 17.0, 5.0, 1.0)
    assert limit_command(command, 0.0, 0.0, ROLL) == command


@pytest.mark.parametrize("side", [1, -1])
def test_position_is_kept_in_the_range_and_speed_below_its_limit(side):
    limited = limit_command(MitCommand(side * 3.0, side * 40.0, 1.0, 0.0, 0.0), 0.5, 0.0, ROLL)
    assert (limited.position, limited.velocity) == (side * math.pi / 2, side * 25.0)


@pytest.mark.parametrize(("side", "place"), [(1, math.pi / 2), (-1, -math.pi / 2)])
def test_at_an_end_nothing_leads_further_out(side, place):
    out = limit_command(MitCommand(0.0, side * 8.0, 0.0, 3.0, side * 5.0), place, 0.0, ROLL)
    assert (out.velocity, out.torque) == (0.0, 0.0)
    back = limit_command(MitCommand(0.0, side * -8.0, 0.0, 3.0, side * -0.5), place, 0.0, ROLL)
    assert (back.velocity, back.torque) == (side * -8.0, side * -0.5)


@given(
    st.tuples(
        st.floats(-20, 20),
        st.floats(-60, 60),
        st.floats(0, 600),
        st.floats(0, 8),
        st.floats(-40, 40),
    ),
    st.floats(-1.7, 1.7),
    st.floats(-25, 25),
)
@hypothesis_settings(max_examples=300, deadline=None)
def test_whatever_is_commanded_can_be_encoded_and_keeps_the_torque(values, position, speed):
    limited = limit_command(MitCommand(*values), position, speed, ROLL)
    assert abs(commanded_torque(limited, position, speed)) <= 24.8 + 1e-9
    make_command(2, to_motor(limited, ROLL), PROFILE)


def test_torque_of_the_motor_stays_below_the_limit_in_a_wild_run():
    bench = Bench(settings()).to_running(hold(0.0))
    for target in (1.5, -1.5, 1.5, -1.5):
        bench.cycle(hold(target, kp=20.0, kd=1.0), count=30)
    assert max(map(abs, bench.fakes[0].torques)) <= 24.8


def changed(**values):
    return lambda: check_command(dataclasses.replace(hold(0.0), **values))


REFUSED = [
    *((changed(**{field.name: math.nan}), HardwareError, f"{field.name}=nan")
      for field in dataclasses.fields(MitCommand)),
    *((changed(**{gain: -0.1}), HardwareError, f"{gain}=-0.1") for gain in ("kp", "kd")),
    (lambda: settings(zero=12.0), HardwareError, "tail roll", PROFILE.name),
    (lambda: settings(zero=-8.0), HardwareError, "tail roll"),  # commands would look like replies
]  # fmt: skip


@pytest.mark.parametrize("row", REFUSED)
def test_what_no_motor_can_do_is_refused(row):
    assert_refused(*row)


def test_settings_of_another_profile_use_its_wrap():
    assert settings(profile=MANUAL_SAMPLE_CODE, zero=40.0).zero == 40.0
