"""The drive: throttle line, governor against frozen throttle, and what it does with nonsense."""

import math

import numpy as np
import pytest

from aerodima.workbench.car.laws import shaft_gain, shaft_torque, steady_speed
from aerodima.workbench.scenario.scenario import scenario_from_dict

SCENARIO = scenario_from_dict({})
DRIVE, CAR = SCENARIO.drive, SCENARIO.car
RADIUS = 0.067


def torque(throttle, shaft_speed, gain=1.0):
    return shaft_torque(throttle, shaft_speed, DRIVE, gain, RADIUS)


def test_throttle_line_meets_the_two_published_points():
    # Section 7.2.2: 3.61 m/s, its first run at 35 %, and 6.10 m/s at 50 %.
    assert steady_speed(0.35, DRIVE) == pytest.approx(3.61, abs=0.005)
    assert steady_speed(0.50, DRIVE) == pytest.approx(6.10, abs=0.005)


def test_reverse_mirrors_forward_and_the_dead_band_stands_still():
    assert steady_speed(-0.5, DRIVE) == -steady_speed(0.5, DRIVE)
    assert (
        steady_speed(0.04, DRIVE) == steady_speed(-0.04, DRIVE) == steady_speed(0.0, DRIVE) == 0.0
    )


TARGET, FULL = (steady_speed(throttle, DRIVE) / RADIUS for throttle in (0.3, 1.0))


@pytest.mark.parametrize(
    ("throttle", "speed", "expected"),
    [
        (0.3, TARGET, 0.0),
        (0.3, TARGET - 0.5, 0.5),
        (0.3, TARGET + 0.5, -0.5),
        (1.0, 0.0, DRIVE.torque_limit),
        (-1.0, 0.0, -DRIVE.torque_limit),
        (0.0, 50.0, 0.0),
        (math.nan, 50.0, 0.0),
        (7.0, FULL, 0.0),
        (-7.0, -FULL, 0.0),
    ],
)
def test_torque_pulls_the_shaft_to_the_speed_of_the_line_within_its_limits(
    throttle, speed, expected
):
    """A throttle of zero or none rolls freely; one beyond one is full throttle."""
    assert torque(throttle, speed) == pytest.approx(expected, abs=1e-9)


def test_without_governor_the_car_answers_with_its_time_constant():
    # m v' = tau / R with tau = k (v_d - v) / R, rotor included: time constant (m R^2 + J) / k.
    frozen = DRIVE.model_copy(update={"governor": False})
    gain = shaft_gain(frozen, CAR)
    assert (CAR.mass * CAR.tyre_radius**2 + DRIVE.rotor_inertia) / gain == pytest.approx(
        DRIVE.time_constant
    )
    assert shaft_gain(DRIVE, CAR) == DRIVE.governor_gain > 10 * gain
    assert np.isclose(torque(0.3, 0.0, gain), gain * steady_speed(0.3, DRIVE) / RADIUS)


def test_open_loop_motor_does_not_overcome_its_load_at_little_throttle():
    open_loop = DRIVE.model_copy(update={"governor": False})
    least = DRIVE.breakaway_throttle
    assert steady_speed(0.99 * least, open_loop) == steady_speed(-0.99 * least, open_loop) == 0.0
    assert steady_speed(1.01 * least, open_loop) == steady_speed(1.01 * least, DRIVE) > 1.0
    assert steady_speed(0.99 * least, DRIVE) > 1.0
