"""Tyres with a slip angle against the bicycle that has the same tyres: steady circle, step of the
steering, grip.
"""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from aerodima.workbench import load_scenario, simulate
from aerodima.workbench.car.car_model import stiction_tolerance
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import drive_turns
from aerodima.workbench.scenario.signal_table import WHEELS
from tests.certain_cars import HIGH_BODY

FRICTION, SLIP_ANGLE = 0.8, 0.15
STEERED = math.radians(2.0)


def circle(speed, *settings, angle=STEERED):
    """A turn to the left that lasts until the end of the run, on tyres with one smooth contact."""
    return load_scenario(
        "turn_none",
        (
            *HIGH_BODY,
            f"car.tyre_slip_angle={SLIP_ANGLE}",
            f"car.tyre_friction={FRICTION}",
            "car.tyre_shape=ellipsoid",
            "car.com_height=0.1",
            f"manoeuvre.speed={speed}",
            f"manoeuvre.steer_angle={angle}",
            "manoeuvre.turn_hold=3.0",
            "manoeuvre.duration=5.0",
            "simulation.log_rate=500",
            *settings,
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize("speed", [2.0, 3.0, 4.0])
def test_steady_circle_is_that_of_the_neutral_bicycle(speed):
    """Front and rear slip alike, so the understeer gradient is zero; the rear axle slips as its
    side force asks.
    """
    scenario = circle(speed)
    log = simulate(scenario)
    last = (log.time > 4.0) & (log.time < 4.9)
    rate, ahead, left = (
        float(np.mean(log.signal(name)[last]))
        for name in (
            "gyro_z_truth_rad_per_s",
            "velocity_x_truth_m_per_s",
            "velocity_y_truth_m_per_s",
        )
    )
    assert rate * scenario.car.wheelbase / ahead == pytest.approx(math.tan(STEERED), rel=0.04)
    used = ahead * rate / (FRICTION * scenario.environment.gravity)
    slip = stiction_tolerance(scenario.car, speed) * used / math.sqrt(1.0 - used**2)
    assert left == pytest.approx(-slip, rel=0.06)


@pytest.mark.slow
def test_yaw_rate_after_a_step_of_the_steering_is_that_of_the_linear_bicycle():
    scenario = circle(3.0, "manoeuvre.turn_hold=0.6", "manoeuvre.duration=3.0")
    log = simulate(scenario)
    rate = log.signal("gyro_z_truth_rad_per_s")
    start = scenario.manoeuvre.turn_start
    end = scenario.manoeuvre.turn_start + 0.5
    during = (log.time >= start) & (log.time <= end)
    late = 0.5 * STEERED / scenario.servo.rate  # a ramp in place of a step
    expected = np.array(
        [bicycle(scenario, max(0.0, time - start - late)) for time in log.time[during]]
    )
    assert expected[-1] == pytest.approx(3.0 * math.tan(STEERED) / scenario.car.wheelbase, rel=0.02)
    assert rate[during] == pytest.approx(expected, abs=0.06 * expected[-1])


def bicycle(scenario, time):
    """Yaw rate (rad/s) of the linear bicycle so long (s) after a step of the steering."""
    cars = VehicleParams.from_scenarios([scenario])
    speed = scenario.manoeuvre.speed
    mass = float(cars.mass[0])
    place = float(cars.centre[0, 0])
    inertia = float(cars.inertia[2, 2, 0]) - mass * place**2
    front = scenario.car.wheelbase - place
    rear = place
    stiffness = FRICTION * mass * scenario.environment.gravity / math.tan(SLIP_ANGLE)
    c_front = stiffness * rear / (front + rear)
    c_rear = stiffness * front / (front + rear)
    turning = c_front * front - c_rear * rear
    system = np.zeros((3, 3))
    system[0, :2] = -(c_front + c_rear) / (mass * speed), -turning / (mass * speed) - speed
    system[1, :2] = (
        -turning / (inertia * speed),
        -(c_front * front**2 + c_rear * rear**2) / (inertia * speed),
    )
    system[:2, 2] = c_front * STEERED / mass, c_front * front * STEERED / inertia
    state = expm(system * time)[:, 2]
    return float(state[1])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "slip_angle"), [("", 0.0), ("", SLIP_ANGLE), ("turn_swing", 0.0)])
def test_friction_stays_within_its_circle_on_every_row(name, slip_angle):
    """The lagged approximation bounds the friction of a step by the load at its start, one row
    before.
    """
    settings = (f"car.tyre_slip_angle={slip_angle}", "manoeuvre.duration=3.0")
    scenario = load_scenario(name, settings) if name else circle(4.0, *settings, angle=0.5)
    log = simulate(scenario)
    most = 0.0
    for wheel in WHEELS:
        x, y, load = (log.signal(f"wheel_force_{wheel}_{axis}_truth_n") for axis in "xyz")
        allowed = scenario.car.tyre_friction * np.maximum(load[1:], load[:-1])
        friction = np.hypot(x, y)[1:]
        assert np.all(friction <= allowed * 1.001 + 0.01), wheel
        most = max(most, float(np.max(friction[load[1:] > 5.0] / allowed[load[1:] > 5.0])))
    assert most > 0.9


@pytest.mark.slow
def test_reduced_car_has_the_same_tyre():
    """Yaw rate and sideslip of the full car while they build up; a row is 2 ms, as a step of the
    reduced car.
    """
    settings = ("manoeuvre.turn_hold=0.6", "manoeuvre.duration=3.0")
    both = [circle(3.0, *settings, f"car.tyre_slip_angle={angle}") for angle in (SLIP_ANGLE, 0.0)]
    cars = VehicleParams.from_scenarios(both)
    assert cars.slip_speed == pytest.approx([3.0 * math.tan(SLIP_ANGLE), 0.01])
    history = drive_turns(cars, TurnPlans.from_scenarios(both), duration=0.5, history=True).history
    assert history is not None
    for place, scenario in enumerate(both):
        log = simulate(scenario)
        for after in (0.05, 0.1, 0.2, 0.4):
            row = int(np.searchsorted(log.time, scenario.manoeuvre.turn_start + after))
            rate, left = (
                log.signal(name)[row]
                for name in ("gyro_z_truth_rad_per_s", "velocity_y_truth_m_per_s")
            )
            assert history[row - 1, 14, place] == pytest.approx(rate, rel=0.04)
            assert history[row - 1, 16, place] == pytest.approx(left, abs=0.003)
