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


@pytest.mark.parametrize("attitude", [(1.1, 0.0), (-3.1, 0.0), (0.0, 1.2), (0.2, -1.2)])
def test_a_car_that_has_tipped_over_is_stopped_at_once_and_the_reason_is_an_error(car, attitude):
    car.wiring.attitude = attitude
    begin = car.now
    while car.guard.stage is Stage.DRIVING and car.now < begin + 1.0:
        car.turn()
    assert car.guard.stage is Stage.EXITING
    assert SAFETY.attitude_time <= car.now - begin <= SAFETY.attitude_time + 0.021
    assert car.last.throttle == 0.0
    assert "disarm" in car.wiring.calls
    assert "hold" not in car.wiring.calls, "the tail is switched off, not held"
    assert f"{math.degrees(max(attitude, key=abs)):.0f}" in car.guard.reason
    assert car.guard.hard


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
    begin = car.now
    while car.guard.stage is Stage.DRIVING and car.now < begin + 1.0:
        car.turn()
    assert car.guard.stage is Stage.HOLDING
    assert SAFETY.speed_time <= car.now - begin <= SAFETY.speed_time + 0.021
    assert car.last.throttle == 0.0
    assert f"{SAFETY.speed_limit + 0.1:.1f}" in car.guard.reason


def test_a_speed_that_is_not_known_is_no_speed(car):
    car.wiring.speed = 20.0
    car.wiring.faults["speed"] = SourceFault.NO_FIX
    car.turn(count=50)
    assert car.guard.stage is Stage.DRIVING
