"""Rolling resistance slows a car as a closed form says; without a stop the motor holds the tail.

Full car and batch.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench import load_scenario, simulate
from aerodima.workbench.car.laws import shaft_torque, steady_speed
from aerodima.workbench.car.reduced.dynamics import equations, step
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.states import STATES, Commands
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import drive_turns
from tests.certain_cars import HIGH_BODY

RESISTANCE = 0.04
FORWARD = STATES.index("v_x")
STOP = f"tail.roll_stop={math.pi / 2}"
NO_STOP = "tail.roll_stop=3.1416"


def deceleration(scenario):
    """Of the car without tail, m/s2: wheels and drive turn with it."""
    car = scenario.car
    turning = (
        4 * 0.5 * car.wheel_mass * car.tyre_radius**2 + scenario.drive.rotor_inertia
    ) / car.tyre_radius**2
    return RESISTANCE * scenario.environment.gravity * car.mass / (car.mass + turning)


@pytest.mark.slow
def test_car_coasts_as_its_resistance_says_and_stops():
    settings = (*HIGH_BODY, "tail.mode=none", "manoeuvre.straight_time=2", "manoeuvre.speed=1.0",
    "manoeuvre.steer_angle=0",
                "manoeuvre.wait_after_turn=0", "manoeuvre.log_end=5.7",
                "drive.governor=true")  # fmt: skip
    scenario = load_scenario("auto_turn", (*settings, f"car.rolling_resistance={RESISTANCE}"))
    log = simulate(scenario)
    speed = log.signal("velocity_x_truth_m_per_s")
    off = int(np.searchsorted(log.time, 2.65))
    later = off + 450
    assert speed[off - 100] == pytest.approx(1.0, rel=0.01)
    slope = (speed[off] - speed[later]) / (log.time[later] - log.time[off])
    assert slope == pytest.approx(deceleration(scenario), rel=0.02)
    assert np.abs(speed[-100:]).max() < 0.01


def test_throttle_line_is_that_of_the_rolling_car():
    drive = load_scenario("auto_turn").drive
    gain = 0.1
    radius = 0.067
    loss = 0.2
    target = steady_speed(0.3, drive) / radius
    assert shaft_torque(0.3, target, drive, gain, radius, loss) == pytest.approx(loss)
    assert shaft_torque(0.0, target, drive, gain, radius, loss) == 0.0


def test_reduced_car_coasts_alike():
    settings = (f"car.rolling_resistance={RESISTANCE}", "car.tyre_slip_angle=0")
    scenario = load_scenario("turn_none", (*settings, "manoeuvre.steer_angle=0"))
    cars = VehicleParams.from_scenarios([scenario])
    driven = drive_turns(cars, TurnPlans.from_scenarios([scenario]), duration=0.1).last
    speed = float(driven[FORWARD, 0])
    assert speed == pytest.approx(scenario.manoeuvre.speed, rel=1e-3)
    state = driven
    off = replace(cars, shaft_limit=np.zeros(1))
    for _ in range(250):
        commands = Commands(np.zeros((2, 1)), np.zeros(1), np.zeros((2, 4, 1)))
        state = step(state, equations(state, commands, off), 0.002)
    assert speed - state[FORWARD, 0] == pytest.approx(0.5 * deceleration(scenario), rel=0.02)


@pytest.mark.slow
def test_without_a_stop_the_motor_carries_the_tail_that_is_held():
    """At rest kp (q - 90 degrees) = m g l sin q, to the motor's and the joint's friction."""
    settings = ("manoeuvre.speed=0", "manoeuvre.steer_angle=0", "manoeuvre.duration=2.6")
    resting, free = (
        load_scenario("turn_held", (*settings, *more)) for more in ((STOP,), (NO_STOP,))
    )
    cars = VehicleParams.from_scenarios([resting, free])
    weight = float(cars.tail_mass[1] * cars.tail_centre[1]) * free.environment.gravity
    logs = [simulate(scenario) for scenario in (resting, free)]
    angle, torque = (
        log_at(logs[1], name) for name in ("tail_roll_angle_rad", "tail_roll_torque_n_m")
    )
    assert torque == pytest.approx(weight * abs(math.sin(angle)), abs=free.friction.coulomb)
    assert torque == pytest.approx(-free.controller.hold_kp * (angle + math.pi / 2), rel=1e-2)
    assert log_at(logs[0], "tail_roll_angle_rad") == pytest.approx(-math.pi / 2, abs=1e-3)
    assert log_at(logs[0], "tail_roll_torque_n_m") == pytest.approx(0.0, abs=1e-2)
    reduced = drive_turns(cars, TurnPlans.from_scenarios([resting, free]), duration=1.0).last[
        STATES.index("tail_roll")
    ]
    assert reduced == pytest.approx([-math.pi / 2, angle], abs=5e-3)


def log_at(log, name):
    return float(log.signal(name)[-1])
