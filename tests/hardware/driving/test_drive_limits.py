"""Throttle, speed and attitude of a car that drives: what passes, and what stops it."""

import dataclasses
import math

import numpy as np
import pytest

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.driving.car_guard import Stage
from aerodima.workbench.scenario.scenario import load_scenario
from tests.hardware.driving.test_car_guard import FORWARD, Car

SAFETY = load_drive_safety()


@pytest.fixture
def car():
    return Car().driving()


def time_to_stop(car, command=FORWARD, longest=3.0):
    """How long a car goes on driving, s."""
    begin = car.now
    while car.guard.stage is Stage.DRIVING and car.now < begin + longest:
        car.turn(command)
    return car.now - begin


@pytest.mark.parametrize("attitude", [(1.1, 0.0), (-3.1, 0.0), (0.0, 1.2), (0.2, -1.2)])
def test_a_car_that_has_tipped_over_is_stopped_at_once_and_the_reason_is_an_error(car, attitude):
    car.wiring.attitude = attitude
    assert SAFETY.attitude_time <= time_to_stop(car) <= SAFETY.attitude_time + 0.021
    assert car.guard.stage is Stage.EXITING
    assert car.last.throttle == 0.0
    assert "disarm" in car.wiring.calls
    assert "hold" not in car.wiring.calls, "the tail is switched off, not held"
    assert f"{math.degrees(max(attitude, key=abs)):.0f}" in car.guard.reason
    assert car.guard.hard


@pytest.mark.parametrize("attitude", [(0.0, 0.0), (math.nan, math.nan)])
def test_a_car_that_lies_by_its_accelerometer_is_stopped_whatever_its_attitude(car, attitude):
    car.wiring.attitude = attitude
    car.wiring.lean = SAFETY.attitude_limit + 0.1
    assert SAFETY.attitude_time <= time_to_stop(car) <= SAFETY.attitude_time + 0.021
    assert (car.guard.stage, car.guard.hard) == (Stage.EXITING, True)
    assert "accelerometer" in car.guard.reason


@pytest.mark.parametrize(
    ("steering", "throttle", "yaw_rate", "stops"),
    [
        (0.5, 0.5, 0.0, True),
        (-0.5, -0.5, -0.05, True),
        (0.5, 0.5, 0.2, False),
        (0.3, 0.5, 0.0, False),
        (0.5, 0.25, 0.0, False),
    ],
)
def test_a_car_that_does_not_turn_at_full_steering_is_stopped(
    car, steering, throttle, yaw_rate, stops
):
    command = dataclasses.replace(FORWARD, steering_angle=steering, throttle=throttle)
    car.wiring.yaw_rate = lambda tick: 1.0
    car.turn(command, count=300)
    car.wiring.yaw_rate = lambda tick: yaw_rate
    expected = SAFETY.straight_time if stops else 3.0
    assert expected <= time_to_stop(car, command) + 1e-9 <= expected + 0.021
    assert car.guard.hard is stops


def test_two_wheels_in_the_air_and_a_sample_that_is_wrong_stop_nothing(car):
    for _ in range(5):
        car.wiring.attitude = (math.radians(55.0), 0.0)
        car.turn(count=30)
        car.wiring.attitude = (1.5, 0.0)
        car.turn(count=3)
    assert car.guard.stage is Stage.DRIVING


def test_a_car_that_tips_over_while_the_tail_is_held_loses_its_tail_at_once(car):
    car.guard.stop("the run is over", car.now)
    car.turn(count=5)
    assert car.guard.stage is Stage.HOLDING
    car.wiring.attitude = (1.5, 0.0)
    car.turn(count=8)
    assert car.guard.stage is Stage.EXITING


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_throttle_comes_on_at_its_rate_and_goes_back_at_once(car, side):
    full = dataclasses.replace(FORWARD, throttle=side)
    passed = []
    for _ in range(400):
        car.turn(full)
        passed.append(side * car.last.throttle)
    assert max(np.diff(passed)) <= SAFETY.throttle_rate * 0.01 + 1e-9
    assert passed[-1] == SAFETY.throttle_limit
    time_to_limit = 0.01 * int(np.argmax(np.array(passed) >= SAFETY.throttle_limit))
    assert time_to_limit == pytest.approx(
        (SAFETY.throttle_limit - SAFETY.throttle_start) / SAFETY.throttle_rate, abs=0.06
    )
    car.turn(dataclasses.replace(FORWARD, throttle=-side))
    assert car.last.throttle == -side * SAFETY.throttle_start, "the other way begins anew"
    car.turn(full, count=300)
    car.turn(dataclasses.replace(FORWARD, throttle=0.1 * side))
    assert car.last.throttle == 0.1 * side


def test_after_a_pause_of_the_loop_the_throttle_does_not_jump(car):
    full = dataclasses.replace(FORWARD, throttle=1.0)
    car.turn(full, count=100)
    before = car.last.throttle
    car.now += 0.5
    car.turn(full)
    assert car.last.throttle - before <= SAFETY.throttle_rate * 0.02 + 1e-9


def test_the_rate_keeps_a_car_without_its_board_on_its_wheels():
    """Below the 3.0 m/s2 that it bears in simulation (at 3.5 it tips backwards), with and without
    governor.
    """
    drive = load_scenario("auto_turn").drive
    assert drive.throttle_gain * SAFETY.throttle_rate <= 0.85 * 3.0
    fastest = drive.throttle_gain * SAFETY.throttle_limit + drive.throttle_offset
    assert fastest / 3.0 <= 0.85 * 3.0, "open loop, with the least time constant of its prior"
    assert SAFETY.throttle_start == pytest.approx(
        -drive.throttle_offset / drive.throttle_gain, abs=2e-3
    )


def test_a_car_that_is_too_fast_is_stopped_softly(car):
    car.wiring.speed = SAFETY.speed_limit + 0.1
    assert SAFETY.speed_time <= time_to_stop(car) <= SAFETY.speed_time + 0.021
    assert car.guard.stage is Stage.HOLDING
    assert car.last.throttle == 0.0
    assert f"{SAFETY.speed_limit + 0.1:.1f}" in car.guard.reason


def test_a_fix_that_is_lost_while_driving_stops_the_car_softly(car):
    """A speed that is not known, here the last one, is no speed."""
    for code in (SourceFault.NO_FIX, SourceFault.NONE):
        car.wiring.faults["speed"] = code
        car.turn(count=95)
        assert car.guard.stage is Stage.DRIVING, "it comes back within a second"
    car.wiring.faults["speed"] = SourceFault.NO_FIX
    car.wiring.speed = 20.0
    assert SAFETY.gps_silence <= time_to_stop(car) + 1e-9 <= SAFETY.gps_silence + 0.021
    assert car.guard.stage is Stage.HOLDING
