"""Laws of motors, servo, joints and wheels: floats and arrays agree."""

import math

import numpy as np
import pytest

from aerodima.workbench.car import laws

ROWS = np.linspace(-2.0, 2.0, 9)


@pytest.mark.parametrize(
    "law, others",
    [
        (laws.pd_torque, (0.1, 1.0, 0.3, 20.0, 0.5, 0.2)),
        (laws.joint_friction, (0.1, 0.02, 10.0)),
        (laws.governor_torque, (0.5, 3.0, 0.1, 0.4)),
        (laws.rolling_resistance, (0.05,)),
        (laws.servo_step, (0.4, 0.3)),
        (lambda *x: laws.torque_bounds(*x)[0], (5.0, 10.0, 1.5)),
        (lambda *x: laws.torque_bounds(*x)[1], (5.0, 10.0, 1.5)),
    ],
)
def test_a_float_gives_what_an_array_gives(law, others):
    alone = [law(float(row), *others) for row in ROWS]
    assert law(ROWS, *others) == pytest.approx(alone, rel=1e-15, abs=0.0)


def test_a_motor_at_its_no_load_speed_only_brakes():
    assert laws.torque_bounds(20.0, 5.0, 10.0, 20.0) == (-5.0, 0.0)
    assert laws.torque_bounds(-20.0, 5.0, 10.0, 20.0) == (-0.0, 5.0)
    assert laws.torque_bounds(15.0, 5.0, 10.0, 20.0) == (-5.0, 2.5)


def test_losses_oppose_the_motion():
    assert laws.rolling_resistance(50.0, 0.05) == -0.05
    assert laws.joint_friction(3.0, 0.1, 0.02, 10.0) == pytest.approx(-0.16)


def test_the_governor_carries_the_rolling_resistance_up_to_its_limit():
    assert laws.governor_torque(10.0, 10.0, 3.0, 0.2, 1.0) == 0.2
    assert laws.governor_torque(10.0, 5.0, 3.0, 0.2, 1.0) == 1.0


def test_the_servo_stops_at_its_command():
    assert laws.servo_step(0.3, -0.3, 0.1) == 0.3 - 0.1
    assert laws.servo_step(0.3, 0.35, 0.1) == 0.35


def test_no_number_stays_no_number():
    assert math.isnan(laws.governor_torque(math.nan, 0.0, 3.0, 0.0, 1.0))
