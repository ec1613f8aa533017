"""A car that is moved, tilted, not calibrated, whose IMU has frozen or whose tail is off its marks
is not armed.
"""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.bno055 import Bno055Sample, decode_sample, encode_sample
from aerodima.hardware.driving.drive_checks import (
    device_checks,
    sleep_check,
    standstill_checks,
    zero_checks,
)
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import STATUS, TAIL_STATE

SAFETY = load_drive_safety()
LEVEL = np.zeros(9)


def samples(count=50, gyro=0.005, acceleration=0.05, calibration=(0, 3, 1, 0), seed=3):
    """As a chip at rest sends them, through its own registers."""
    random = np.random.default_rng(seed)
    return [
        decode_sample(
            encode_sample(
                Bno055Sample(
                    (1.0, 0.0, 0.0, 0.0),
                    tuple(random.normal(0.01, gyro, 3)),
                    tuple(random.normal(0.0, acceleration, 3)),
                    calibration=calibration,
                )
            )
        )
        for _ in range(count)
    ]


def failed(*arguments):
    return [check.name for check in standstill_checks(*arguments, SAFETY) if check.passed is False]


@pytest.mark.parametrize(("latest", "passed"), [(0.0001, True), (0.01251, None)])
def test_a_check_of_the_clock_does_not_pass_what_is_above_its_limit(latest, passed):
    check = sleep_check([0.0001] * 19 + [latest])
    assert (check.passed, "12.51" in check.text) == (passed, passed is None)
    assert sleep_check([0.003] * 20).passed is False


def test_a_check_blames_the_source_that_it_checks():
    texts = {"operator": "an emergency stop", "imu": "no sample", "sail": "reported"}
    faults = {"operator_fault": 7.0, "imu_fault": 2.0, "sail_fault": 5.0, "speed_fault": 6.0}
    status = STATUS.write(**dict.fromkeys(STATUS.fields, 0.0) | faults)
    reading = CarReading(status=status, fault_text="worst", fault_texts=texts)
    car = SimpleNamespace(name="watched_can", unwatched="", gps_time=None)
    checks = device_checks(car, reading, SAFETY)
    shown = {check.name: check.text for check in checks if check.passed is False}
    assert "ports file" in shown.pop("speed"), "how to drive without a fix"
    assert shown == texts


def test_a_car_at_rest_may_be_armed():
    assert failed(samples(), LEVEL) == []


def test_samples_that_do_not_change_by_a_bit_are_frozen():
    assert failed([samples()[0]] * 50, LEVEL) == ["IMU"]
    assert failed(samples(count=3), LEVEL) == ["IMU"]
    assert failed([], LEVEL) == ["IMU"]


def test_the_quietest_chip_is_not_frozen():
    """A tenth of the noise of the data sheet still moves the last digits."""
    assert failed(samples(gyro=0.0005, acceleration=0.005), LEVEL) == []


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_gyro_that_is_not_calibrated_is_named(level):
    assert failed(samples(calibration=(3, level, 3, 3)), LEVEL) == ["IMU calibration"]


def test_a_car_in_a_hand_is_moved():
    moved = [dataclasses.replace(sample, gyro=(0.0, 0.3, 0.0)) for sample in samples()]
    pushed = [dataclasses.replace(sample, acceleration=(0.8, 0.0, 0.0)) for sample in samples()]
    assert failed(moved, LEVEL) == failed(pushed, LEVEL) == ["car stands still"]


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize("angle", [20.0, -90.0, 180.0])
def test_a_car_that_lies_somehow_is_tilted(place, angle):
    reading = LEVEL.copy()
    reading[place] = math.radians(angle)
    assert failed(samples(), reading) == ["car stands upright"]


@pytest.mark.parametrize(
    ("law", "pitch", "roll", "off"),
    [
        ("swing", 0, -90, []),
        ("swing", 0, 45, ["tail roll zero"]),
        ("swing", -90, 0, ["tail pitch zero"]),
        ("feedback", -66, 0, []),
        ("feedback", -90, 0, []),
        ("feedback", 90, 0, ["tail pitch zero"]),
        ("feedback", 0, 0, ["tail pitch zero"]),
    ],
)
def test_the_tail_is_held_where_its_law_waits_or_on_its_stop(law, pitch, roll, off):
    tail = np.zeros(TAIL_STATE.size)
    tail[TAIL_STATE.index("pitch_angle")], tail[TAIL_STATE.index("roll_angle")] = np.radians(
        [pitch, roll]
    )
    scenario = load_scenario("turn_designed", ["tail.mode=swing", f"controller.law={law}"])
    checks = zero_checks(CarReading(tail_state=tail), scenario, SAFETY)
    assert [check.name for check in checks if not check.passed] == off
