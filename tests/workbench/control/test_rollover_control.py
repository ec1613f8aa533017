"""Rollover control: its law by hand, what the driver's wheels get of it, and on cars."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from aerodima.workbench.control.driver_law import (
    DriverView,
    LimitedDriver,
    ScheduledDriver,
    make_driver,
)
from aerodima.workbench.control.manoeuvre import DriverInput
from aerodima.workbench.control.rollover_control import (
    STRAIGHT,
    RolloverMemory,
    limit_by_roll,
    max_angle,
)
from aerodima.workbench.scenario.scenario import load_scenario

CONTROL = SimpleNamespace(gain=10.0, start=0.05, lead=0.2, acceleration=12.0, zero_time=1.0)
ON = ["rollover_control.gain=10.0", "rollover_control.start=0.05", "rollover_control.lead=0.2"]
RATE = 100.0


class Asks:
    """A driver who asks for one angle, with a memory that counts the ticks."""

    sources = ("pose",)

    def __init__(self, angle):
        self.angle = angle

    def start(self):
        return np.array([0.0])

    def step(self, memory, view):
        return memory + 1.0, DriverInput(self.angle, 0.5, 1.0)


def share(roll, roll_rate, *, asked=0.2, zero=0.0):
    return limit_by_roll(CONTROL, RATE, RolloverMemory(1.0, zero), asked, roll, roll_rate).share


@pytest.mark.parametrize(
    ("roll", "roll_rate", "left"),
    [
        (0.0, 0.0, 1.0),
        (0.05, 0.0, 1.0),
        (0.08, 0.0, 0.7),
        (-0.08, 0.0, 0.7),
        (0.04, 0.2, 0.7),
        (0.04, -0.2, 1.0),
        (0.3, 0.0, 0.0),
    ],
)
def test_wheels_lose_a_share_by_the_roll_to_either_side(roll, roll_rate, left):
    assert share(roll, roll_rate) == pytest.approx(left)


def test_zero_of_the_roll_follows_on_the_straight_alone():
    memory = RolloverMemory(1.0, 0.0)
    for _ in range(500):
        memory = limit_by_roll(CONTROL, RATE, memory, 0.9 * STRAIGHT, 0.06, 0.0)
    assert memory.zero == pytest.approx(0.06, abs=0.001)
    assert memory.share == pytest.approx(1.0)
    steered = limit_by_roll(CONTROL, RATE, memory, 0.2, 0.14, 0.0)
    assert steered.zero == memory.zero
    assert steered.share == pytest.approx(0.7, abs=0.01)


def test_largest_angle_has_the_lateral_acceleration_of_the_kinematic_car():
    angle = max_angle(0.27, 12.0, 6.0)
    assert 36.0 * math.tan(angle) / 0.27 == pytest.approx(12.0)
    assert max_angle(0.27, 12.0, 0.0) == pytest.approx(math.pi / 2)


def test_a_limited_driver_turns_the_wheels_less_and_keeps_throttle_and_turn():
    driver = LimitedDriver(Asks(-0.5), CONTROL, 0.1, RATE)
    assert driver.sources == ("pose", "imu")
    memory, given = driver.step(driver.start(), DriverView(0.0, roll=0.0, roll_rate=0.0))
    assert given == DriverInput(pytest.approx(-0.1), 0.5, 1.0)
    memory, given = driver.step(memory, DriverView(0.01, roll=0.08, roll_rate=0.0))
    assert given.steering_angle == pytest.approx(-0.07)
    unknown = DriverView(0.02)
    memory, given = driver.step(memory, unknown)
    assert given.steering_angle == pytest.approx(-0.07), "an unknown roll changes nothing"
    assert memory[2:] == pytest.approx([3.0]), "the driver has a memory of its own"


def test_first_roll_that_is_known_is_the_zero():
    driver = LimitedDriver(Asks(0.3), CONTROL, 1.0, RATE)
    memory, given = driver.step(driver.start(), DriverView(0.0))
    assert given.steering_angle == pytest.approx(0.3)
    memory, given = driver.step(memory, DriverView(0.01, roll=0.3, roll_rate=0.0))
    assert given.steering_angle == pytest.approx(0.3)
    _, given = driver.step(memory, DriverView(0.02, roll=0.38, roll_rate=0.0))
    assert given.steering_angle == pytest.approx(0.3 * 0.7)


def test_control_is_off_unless_a_scenario_has_a_gain():
    assert isinstance(make_driver(load_scenario("swerve")), ScheduledDriver)
    scenario = load_scenario(
        "swerve", [*ON, "rollover_control.acceleration=12", "manoeuvre.speed=6"]
    )
    limited = make_driver(scenario)
    assert isinstance(limited, LimitedDriver)
    assert limited.max_angle == pytest.approx(max_angle(scenario.car.wheelbase, 12.0, 6.0))
