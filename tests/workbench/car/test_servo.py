"""The steering servo: 30 degrees in 0.14 s, its limit, and the linkage that turns both wheels about
one centre.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.car.laws import ackermann, knuckle_motion, servo_frame, steering_motion
from aerodima.workbench.scenario.scenario import scenario_from_dict

SCENARIO = scenario_from_dict({})
CAR, STEP = SCENARIO.car, 0.002
SERVO = SCENARIO.servo.model_copy(update={"linkage": "ackermann"})
LIMIT = math.radians(30.0)


def bicycle_angle(knuckles):
    """Bicycle angle of two knuckle angles: the cotangents of both wheels have that of the bicycle
    as their mean.
    """
    left, right = knuckles[:2]
    return math.atan(2.0 / (1.0 / math.tan(left) + 1.0 / math.tan(right))) if left else 0.0


class ServoRun:
    """Steps of a plant, with the servo's frame handed from one to the next."""

    def __init__(self, servo=SERVO):
        self.settings = servo
        self.frame = None
        self.steps = 0
        self.time = 0.0

    def command(self, angle, until):
        while self.steps * STEP <= until + 1e-9:
            self.frame = servo_frame(self.frame, self.steps * STEP, angle, self.settings)
            self.steps += 1
        self.time = until
        return self.knuckles()

    def knuckles(self):
        """Angles (2), rad, then rates (2), rad/s, that the linkage demands now."""
        return np.array(
            knuckle_motion(
                *steering_motion(self.frame, self.time, self.settings.rate), self.settings, CAR
            )
        )


def test_thirty_degrees_take_0_14_seconds():
    run = ServoRun()
    half_way = run.command(LIMIT, 0.07)
    assert bicycle_angle(half_way) == pytest.approx(LIMIT / 2, rel=1e-9)
    before = run.command(LIMIT, 0.14 - STEP)
    assert bicycle_angle(before) == pytest.approx(LIMIT - SERVO.rate * STEP, rel=1e-9)
    there = run.command(LIMIT, 0.14)
    assert bicycle_angle(there) == pytest.approx(LIMIT, rel=1e-9)
    back = run.command(0.0, 0.29)  # read by the frame at 0.15 s: that of this instant has passed
    assert_allclose(back[:2], 0.0, atol=1e-12)


def test_servo_stops_at_its_limit_on_both_sides():
    for command, end in ((2.0, LIMIT), (-2.0, -LIMIT)):
        knuckles = ServoRun().command(command, 0.5)
        assert bicycle_angle(knuckles) == pytest.approx(end, rel=1e-9)
        assert_allclose(knuckles[2:], 0.0, atol=1e-12)


def test_command_is_read_once_per_frame():
    """A command between two frames of 10 ms moves nothing before the next one."""
    run = ServoRun()
    run.command(0.0, 0.003)
    assert bicycle_angle(run.command(LIMIT, 0.0099)) == 0.0
    assert bicycle_angle(run.command(LIMIT, 0.01 + 5 * STEP)) == pytest.approx(
        5 * STEP * SERVO.rate
    )


def test_nan_holds_the_last_angle():
    run = ServoRun()
    before = run.command(0.2, 0.2).copy()
    assert_array_equal(run.command(math.nan, 0.4), before)
    assert bicycle_angle(before) == pytest.approx(0.2)


def test_parallel_linkage_turns_both_wheels_alike():
    run = ServoRun(SCENARIO.servo)
    assert SCENARIO.servo.linkage == "parallel"
    assert_allclose(
        run.command(LIMIT, 0.07), [LIMIT / 2, LIMIT / 2, SERVO.rate, SERVO.rate], rtol=1e-9
    )
    assert_allclose(run.command(LIMIT, 0.2), [LIMIT, LIMIT, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("delta", [0.4, -0.3])
def test_both_wheels_roll_about_one_centre_on_the_rear_axle(delta):
    assert ackermann(0.0, CAR.wheelbase, CAR.track) == (0.0, 0.0)
    radius = CAR.wheelbase / math.tan(delta)
    for angle, y in zip(
        ackermann(delta, CAR.wheelbase, CAR.track), (CAR.track / 2, -CAR.track / 2), strict=True
    ):
        # The wheel at (wheelbase, y) is perpendicular to the line from the centre of turn at (0,
        # radius).
        assert math.tan(angle) == pytest.approx(CAR.wheelbase / (radius - y))


def test_knuckle_rates_are_the_derivatives_of_the_knuckle_angles():
    run = ServoRun()
    earlier = run.command(LIMIT, 0.1 - STEP).copy()
    middle = run.command(LIMIT, 0.1).copy()
    later = run.command(LIMIT, 0.1 + STEP)
    # Central difference: the error is the third derivative times STEP^2 / 6, below 1e-4 of the rate
    # here.
    assert_allclose((later[:2] - earlier[:2]) / (2 * STEP), middle[2:], rtol=1e-4)
    assert middle[2] > middle[3] > 0.0
