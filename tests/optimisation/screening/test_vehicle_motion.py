"""The reduced vehicle against closed forms: energy, loads at rest, circles, load transfer; the sign
of every moment.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicle_motion import (
    RATES,
    STATES,
    Commands,
    V,
    W,
    configuration_rate,
    cross,
    equations,
    solve,
    up,
)
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench import load_scenario
from aerodima.workbench.plants.car_model import axle_statics

GRAVITY = 9.81
FREE = np.zeros((2, 4, 1))


def derivative(state: np.ndarray, commands: Commands, cars: Vehicles) -> np.ndarray:
    """dx/dt (24, n)."""
    found = equations(state, commands, cars)
    acceleration = solve(found.mass, found.force)
    rates = state[RATES]
    acceleration[V] -= cross(rates[W], rates[V])
    return np.concatenate([configuration_rate(state, rates, found.travel_rate), acceleration])


def cars_of(*settings: str, scenario: str = "turn_designed") -> Vehicles:
    return Vehicles.of([load_scenario(scenario, settings)])


def without_air_and_friction(cars: Vehicles) -> Vehicles:
    zero = np.zeros(cars.count)
    return replace(cars, air_density=zero, coulomb=zero, viscous=zero)


def state_of(**values: float) -> np.ndarray:
    state = np.zeros((len(STATES), 1))
    for name, value in values.items():
        state[STATES.index(name)] = value
    return state


def coasting(cars: Vehicles) -> Commands:
    return Commands(np.zeros((2, 1)), np.zeros(1), FREE)


def acceleration(cars: Vehicles, commands: Commands | None = None, **values: float) -> np.ndarray:
    found = equations(state_of(**values), commands or coasting(cars), cars)
    return solve(found.mass, found.force)[:, 0]


def energy(state: np.ndarray, cars: Vehicles) -> float:
    """Of a car in the air, J; its weight acts at the centre of car and arm."""
    found = equations(state, coasting(cars), cars)
    rates = state[RATES]
    kinetic = 0.5 * np.einsum("in,ijn,jn->n", rates, found.mass, rates)
    total = cars.mass + cars.tail_mass
    moment = np.array([-found.mass[1, 5], found.mass[0, 5], -found.mass[0, 4]])
    height = state[2] + np.sum(up(state[4], state[5]) * moment, axis=0) / total
    return float((kinetic + total * GRAVITY * height)[0])


@pytest.mark.slow
def test_a_thrown_car_with_a_swinging_tail_keeps_its_energy() -> None:
    cars = replace(without_air_and_friction(cars_of()), shaft_gain=np.zeros(1))
    state = state_of(
        z=5.0, roll=0.2, pitch=-0.1, tail_pitch=0.3, tail_roll=-0.8, w_x=1.0, w_y=-0.7, w_z=2.0,
        v_x=4.0, v_y=0.5,
        spin_front_left=60.0, spin_front_right=50.0, spin_rear_left=70.0, spin_rear_right=65.0,
        tail_pitch_rate=2.0, tail_roll_rate=5.0,
    )  # fmt: skip
    state[STATES.index("travel_front_left") : STATES.index("w_x")] = -0.005
    commands = coasting(cars)
    length = 1e-3
    before = energy(state, cars)
    for _ in range(200):
        k1 = derivative(state, commands, cars)
        k2 = derivative(state + 0.5 * length * k1, commands, cars)
        k3 = derivative(state + 0.5 * length * k2, commands, cars)
        k4 = derivative(state + length * k3, commands, cars)
        state = state + length / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert energy(state, cars) == pytest.approx(before, rel=1e-8)  # Runge-Kutta leaves 1e-10


def test_loads_at_rest_are_those_of_the_full_car() -> None:
    scenario = load_scenario("turn_none")
    turns = rolling("turn_none", steer=0.0, speed=1.0)
    state = turns.history[-1]
    cars = Vehicles.of([scenario])
    loads = equations(
        state, Commands(np.zeros((2, 1)), cars.speed / cars.rolling_radius, FREE), cars
    ).loads[:, 0]
    for place, axle in enumerate(("front", "rear")):
        expected = axle_statics(scenario.car, GRAVITY, axle).wheel_load
        assert loads[2 * place : 2 * place + 2] == pytest.approx(expected, rel=5e-3)


def rolling(name: str, steer: float, speed: float, *settings: str, **changes: Any) -> Any:
    words = (
        f"manoeuvre.speed={speed}",
        f"manoeuvre.steer_angle={steer}",
        "manoeuvre.turn_hold=3.0",
        *settings,
    )
    scenario = load_scenario(name, words)
    cars = replace(Vehicles.of([scenario]), **changes)
    return drive_turns(cars, TurnPlans.of([scenario]), duration=2.5, history=True)


def test_a_slow_circle_has_the_radius_of_the_steering() -> None:
    speed = 1.0
    steer = 0.2
    turns = rolling("turn_none", steer, speed, "car.tyre_shape=ellipsoid")
    wheelbase = load_scenario("turn_none").car.wheelbase
    state = turns.history[-1]
    # Parallel wheels scrub a little; the rear axle's middle goes round at the speed of its wheels.
    assert state[STATES.index("w_z"), 0] == pytest.approx(
        speed * np.tan(steer) / wheelbase, rel=0.02
    )


def test_load_moves_outwards_by_height_over_track() -> None:
    stiff = {
        "spring": np.full((4, 1), 1e5),
        "tyre_stiffness": np.full((4, 1), 1e5),
        "damper": np.full((4, 1), 2e3),
    }
    turns = rolling(
        "turn_none", 0.1, 2.0, "car.tyre_shape=ellipsoid", "car.tyre_friction=0.9", **stiff
    )
    scenario = load_scenario("turn_none")
    state = turns.history[-1]
    cars = replace(Vehicles.of([scenario]), friction=np.array([0.9]), **stiff)
    cars = replace(cars, tyre_half_width=np.array([scenario.car.tyre_width / 2]), edge=np.zeros(1))
    commands = Commands(np.full((2, 1), 0.1), np.array([2.0]) / cars.rolling_radius, FREE)
    left, right = (equations(state, commands, cars).loads[side::2].sum() for side in (0, 1))
    rates = dict(zip(STATES, state[:, 0], strict=True))
    sideways = rates["w_z"] * rates["v_x"]
    gyroscopic = 4 * cars.wheel_inertia[0] * rates["spin_rear_left"] * rates["w_z"]
    moment = scenario.car.mass * sideways * scenario.car.com_height + gyroscopic
    assert (right - left) * scenario.car.track / 2 == pytest.approx(moment, rel=0.03)


def test_a_car_tips_where_friction_passes_the_static_stability_factor() -> None:
    """In a turn that begins slowly, on stiff springs; the steered wheels push backwards in part,
    which costs grip.
    """
    words = ("tail.mode=none", "manoeuvre.turn_hold=3.0", "servo.rate=0.3", "manoeuvre.speed=5.0")
    scenario = load_scenario("turn_designed", words)
    car = scenario.car
    friction = np.arange(0.3, 1.2, 0.02)
    cars = replace(
        Vehicles.of([scenario]).take(np.zeros(len(friction), int)), friction=np.array(friction)
    )
    stiff = np.full((4, len(friction)), 1e5)
    cars = replace(cars, spring=stiff, tyre_stiffness=stiff, damper=0.02 * stiff)
    turns = drive_turns(
        cars, TurnPlans.of([scenario]).take(np.zeros(len(friction), int)), duration=3.0
    )
    critical = friction[np.argmin(turns.survived)]
    assert not turns.survived[-1]
    assert (
        0.97 * car.outer_half_track / car.com_height
        < critical
        < 1.25 * car.outer_half_track / car.com_height
    )


def test_every_moment_has_its_sign() -> None:
    cars = cars_of()
    ahead = {"v_x": 4.5, **{f"spin_{w}": 4.5 / cars.rolling_radius[0] for w in
             ("front_left", "front_right", "rear_left", "rear_right")}}  # fmt: skip
    steered = coasting(cars)._replace(
        steering=np.full((2, 1), 0.3), shaft_speed=cars.speed / cars.rolling_radius
    )
    straight = steered._replace(steering=np.zeros((2, 1)))
    turning = acceleration(cars, steered, **ahead) - acceleration(cars, straight, **ahead)
    assert min(turning[2], turning[4], turning[0]) > 0.0  # yaw and force to the left, roll outwards
    pushed = straight._replace(tail=FREE.copy())
    pushed.tail[1] = np.array([[0.0], [8.0], [0.0], [3.0]])
    swung = acceleration(cars, pushed, tail_roll=-1.2, **ahead) - acceleration(
        cars, straight, tail_roll=-1.2, **ahead
    )
    assert swung[0] < 0.0 < swung[11]  # the tail is pushed outwards, the car inwards
    still = replace(cars, air_density=np.zeros(1))
    weight = acceleration(still, straight, tail_roll=-1.4, **ahead)
    assert max(weight[0], weight[11]) < 0.0  # a tail on the inside leans the car inwards, and falls
    sail = acceleration(cars, straight, tail_roll=-1.4, **ahead) - acceleration(
        still, straight, tail_roll=-1.4, **ahead
    )
    assert max(sail[3], sail[10]) < 0.0 < sail[2]  # drags, turns the car inwards, tail backwards
    rates = (
        acceleration(each, straight, tail_roll_rate=8.0, **ahead)[11] for each in (cars, still)
    )
    assert next(rates) < next(rates)  # the air brakes a swing
