"""The reduced vehicle against closed forms: energy, loads at rest, circles, load transfer; the sign
of every moment.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench import load_scenario
from aerodima.workbench.car.car_model import axle_statics
from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.car.reduced.dynamics import configuration_rate, equations, solve
from aerodima.workbench.car.reduced.parameters import VehicleParams, take
from aerodima.workbench.car.reduced.states import RATES, STATES, Commands, V, W, cross, up
from aerodima.workbench.car.reduced.tail_terms import STOP_RATE
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import drive_turns

GRAVITY = 9.81
FREE = np.zeros((2, 4, 1))


def derivative(state, commands, cars):
    """dx/dt (24, n)."""
    found = equations(state, commands, cars)
    acceleration = solve(found.mass, found.force)
    rates = state[RATES]
    acceleration[V] -= cross(rates[W], rates[V])
    return np.concatenate([configuration_rate(state, rates, found.travel_rate), acceleration])


def cars_of(*settings, scenario="turn_designed"):
    return VehicleParams.from_scenarios([load_scenario(scenario, settings)])


def without_air_and_friction(cars):
    zero = np.zeros(cars.count)
    return replace(cars, air_density=zero, coulomb=zero, viscous=zero)


def state_of(**values):
    state = np.zeros((len(STATES), 1))
    for name, value in values.items():
        state[STATES.index(name)] = value
    return state


def drawn(rng, place, rate, spin, tail_roll=None):
    """A state within these sizes of places, rates and spins of the wheels."""
    spread = np.full((len(STATES), 1), place)
    spread[STATES.index("tail_roll")] = tail_roll or place
    spread[STATES.index("w_x") :] = rate
    spread[STATES.index("spin_front_left") : STATES.index("tail_pitch_rate")] = spin
    return spread * rng.uniform(-1.0, 1.0, size=spread.shape)


def coasting(cars):
    return Commands(np.zeros((2, 1)), np.zeros(1), FREE)


def acceleration(cars, **values):
    found = equations(state_of(**values), coasting(cars), cars)
    return solve(found.mass, found.force)[:, 0]


def energy(state, cars):
    """Of a car in the air, J; its weight acts at the centre of car and arm."""
    found = equations(state, coasting(cars), cars)
    rates = state[RATES]
    kinetic = 0.5 * np.einsum("in,ijn,jn->n", rates, found.mass, rates)
    total = cars.mass + cars.tail_mass
    moment = np.array([-found.mass[1, 5], found.mass[0, 5], -found.mass[0, 4]])
    height = state[2] + np.sum(up(state[4], state[5]) * moment, axis=0) / total
    return float((kinetic + total * GRAVITY * height)[0])


def test_a_thrown_car_with_a_swinging_tail_keeps_its_energy():
    """Energy a moment before and after differ by nothing, whatever turns."""
    cars = replace(without_air_and_friction(cars_of()), shaft_gain=np.zeros(1))
    rng = np.random.default_rng(2)
    for _ in range(5):
        state = drawn(rng, 0.4, 4.0, 70.0)
        state[2] = 5.0
        state[8:12] = -0.005
        step = 1e-5 * derivative(state, coasting(cars), cars)
        power = (energy(state + step, cars) - energy(state - step, cars)) / 2e-5
        assert power == pytest.approx(0.0, abs=1e-4)


def test_loads_at_rest_are_those_of_the_full_car():
    scenario = load_scenario("turn_none")
    state = rolling("turn_none", steer=0.0, speed=1.0)
    cars = VehicleParams.from_scenarios([scenario])
    loads = equations(
        state, Commands(np.zeros((2, 1)), cars.speed / cars.rolling_radius, FREE), cars
    ).loads[:, 0]
    for place, axle in enumerate(("front", "rear")):
        expected = axle_statics(scenario.car, GRAVITY, axle).wheel_load
        assert loads[2 * place : 2 * place + 2] == pytest.approx(expected, rel=5e-3)


def rolling(name, steer, speed, *settings, **changes):
    """The last state of a car that was steered for 2.5 s."""
    words = (
        f"manoeuvre.speed={speed}",
        f"manoeuvre.steer_angle={steer}",
        "manoeuvre.turn_hold=3.0",
        *settings,
    )
    scenario = load_scenario(name, words)
    cars = replace(VehicleParams.from_scenarios([scenario]), **changes)
    plans = TurnPlans.from_scenarios([scenario])
    return drive_turns(cars, plans, duration=2.5, history=True).history[-1]


def test_a_slow_circle_has_the_radius_of_the_steering():
    speed = 1.0
    steer = 0.2
    state = rolling("turn_none", steer, speed, "car.tyre_shape=ellipsoid")
    wheelbase = load_scenario("turn_none").car.wheelbase
    # Parallel wheels scrub a little; the rear axle's middle goes round at the speed of its wheels.
    assert state[STATES.index("w_z"), 0] == pytest.approx(
        speed * np.tan(steer) / wheelbase, rel=0.02
    )


def test_load_moves_outwards_by_height_over_track():
    stiff = {
        "spring": np.full((4, 1), 1e5),
        "tyre_stiffness": np.full((4, 1), 1e5),
        "damper": np.full((4, 1), 2e3),
    }
    state = rolling(
        "turn_none", 0.1, 2.0, "car.tyre_shape=ellipsoid", "car.tyre_friction=0.9", **stiff
    )
    scenario = load_scenario("turn_none")
    cars = replace(VehicleParams.from_scenarios([scenario]), friction=np.array([0.9]), **stiff)
    cars = replace(cars, tyre_half_width=np.array([scenario.car.tyre_width / 2]), edge=np.zeros(1))
    commands = Commands(np.full((2, 1), 0.1), np.array([2.0]) / cars.rolling_radius, FREE)
    left, right = (equations(state, commands, cars).loads[side::2].sum() for side in (0, 1))
    rates = dict(zip(STATES, state[:, 0], strict=True))
    sideways = rates["w_z"] * rates["v_x"]
    gyroscopic = 4 * cars.wheel_inertia[0] * rates["spin_rear_left"] * rates["w_z"]
    moment = scenario.car.mass * sideways * scenario.car.com_height + gyroscopic
    assert (right - left) * scenario.car.track / 2 == pytest.approx(moment, rel=0.03)


def test_a_car_tips_where_friction_passes_the_static_stability_factor():
    """In a turn that begins slowly, on stiff springs; the steered wheels push backwards in part,
    which costs grip.
    """
    words = ("tail.mode=none", "manoeuvre.turn_hold=3.0", "servo.rate=0.3", "manoeuvre.speed=5.0")
    scenario = load_scenario("turn_designed", ("car.tyre_slip_angle=0", *words))
    car = scenario.car
    friction = np.arange(0.3, 1.2, 0.02)
    stiff = np.full((4, len(friction)), 1e5)
    one = np.zeros(len(friction), int)
    cars = replace(
        take(VehicleParams.from_scenarios([scenario]), one),
        friction=friction,
        spring=stiff,
        tyre_stiffness=stiff,
        damper=0.02 * stiff,
    )
    turns = drive_turns(cars, take(TurnPlans.from_scenarios([scenario]), one), duration=3.0)
    critical = friction[np.argmin(turns.survived)]
    assert not turns.survived[-1]
    assert 0.97 < critical * car.com_height / car.outer_half_track < 1.25


def test_a_tail_on_the_inside_leans_the_car_and_its_air_turns_it_inwards():
    cars = cars_of()
    inside = {"v_x": 4.5, "tail_roll": -1.4}
    still = replace(cars, air_density=np.zeros(1))
    weight = acceleration(still, **inside)
    assert max(weight[0], weight[11]) < 0.0  # it falls, too
    sail = acceleration(cars, **inside) - weight
    assert max(sail[3], sail[10]) < 0.0 < sail[2]  # it drags, and the tail is pushed backwards
    braked, free = (acceleration(each, v_x=4.5, tail_roll_rate=8.0)[11] for each in (cars, still))
    assert braked < free


def mirrored(values, names):
    """What the car shows in a mirror: left and right wheels change places."""
    places = [
        names.index(
            name.replace("left", "RIGHT").replace("right", "left").replace("RIGHT", "right")
        )
        for name in names
    ]
    turned = ("y", "yaw", "roll", "tail_roll", "w_x", "w_z", "v_y", "tail_roll_rate")
    signs = np.array([-1.0 if name in turned else 1.0 for name in names])
    return signs[:, None] * values[places]


def test_a_mirrored_car_accelerates_as_its_picture():
    """On the ground, rolling, sliding and leaning, its tail beyond a stop and its motors at their
    limits.
    """
    cars = cars_of("tail.roll_stop=1.571")
    assert np.abs(cars.centre[1]).max() < 1e-9
    rng = np.random.default_rng(6)
    rates = STATES[RATES]
    for _ in range(12):
        state = drawn(rng, 0.15, 2.0, 60.0, tail_roll=2.0)
        state[8:12] *= 0.05
        state[2] = 0.0
        tail = np.abs(rng.normal(size=(2, 4, 1))) * np.array([[1.0], [8.0], [20.0], [3.0]])
        steering = rng.uniform(-0.4, 0.4, size=(2, 1))
        other = tail * np.array([[[1.0]] * 4, [[-1.0], [-1.0], [1.0], [1.0]]])
        here = equations(state, Commands(steering, np.full(1, 50.0), tail), cars)
        there = equations(
            mirrored(state, STATES), Commands(-steering[::-1], np.full(1, 50.0), other), cars
        )
        expected = mirrored(solve(here.mass, here.force), rates)
        assert solve(there.mass, there.force) == pytest.approx(expected, rel=1e-9, abs=1e-7)
        assert there.loads == pytest.approx(here.loads[[1, 0, 3, 2]])


JOINTS = {"pitch": 10, "roll": 11}


def motor_torque(joint, rate, *command, **changes):
    """Of the motor of a joint that is in the middle and turns, N m."""
    cars = replace(without_air_and_friction(cars_of()), **changes)
    state = state_of(z=5.0, **{f"tail_{joint}_rate": rate})
    commands = coasting(cars)._replace(tail=FREE.copy())
    commands.tail[JOINTS[joint] - 10] = np.array(command)[:, None]
    place = JOINTS[joint]
    forces = [equations(state, one, cars).force[place, 0] for one in (commands, coasting(cars))]
    return float(forces[0] - forces[1])


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("joint", JOINTS)
def test_a_motor_loses_its_torque_towards_its_speed_without_load(joint, side):
    """To either side, and only when it drives: a motor that brakes has its whole torque."""
    cars = cars_of()
    stall, fastest, limit = (
        float(value[0]) for value in (cars.stall_torque, cars.no_load_speed, cars.torque_limit)
    )
    asked = (side * 9.0, 0.0, 1e6, 0.0)
    assert stall > limit
    for share in (0.9, 0.97):
        expected = side * (1.0 - share) * stall
        assert motor_torque(joint, side * share * fastest, *asked) == pytest.approx(expected)
    assert motor_torque(joint, side * 1.1 * fastest, *asked) == 0.0
    for rate in (0.0, -0.9 * fastest):
        assert motor_torque(joint, side * rate, *asked) == pytest.approx(side * limit)


def test_a_motor_within_its_limits_follows_its_gains_and_its_true_torque():
    scaled = cars_of("tail_motor.torque_error=0.1").torque_scale
    assert scaled == pytest.approx([1.1])
    found = motor_torque("roll", 0.5, 0.2, 1.5, 10.0, 2.0, torque_scale=scaled)
    assert found == pytest.approx(1.1 * (10.0 * 0.2 + 2.0 * (1.5 - 0.5)))


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("joint", "limit"), [("pitch", "pitch_limit"), ("roll", "roll_stop")])
def test_a_stop_pushes_a_joint_back_to_either_side(joint, limit, side):
    cars = without_air_and_friction(cars_of())
    cars = replace(cars, gravity=np.zeros(1))
    end = float(getattr(cars, limit)[0])
    place = JOINTS[joint]
    for beyond in (0.0, 0.02):
        state = state_of(z=5.0, **{f"tail_{joint}": side * (end + beyond)})
        found = equations(state, coasting(cars), cars)
        expected = -side * beyond * STOP_RATE**2 * found.mass[place, place, 0]
        assert found.force[place, 0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("rate", [0.05, 2.0])
def test_damping_of_a_joint_is_the_slope_of_its_torque(joint, rate):
    """With Coulomb and viscous friction and the motor's own damping."""
    cars = replace(cars_of(), air_density=np.zeros(1))
    commands = coasting(cars)._replace(tail=FREE.copy())
    commands.tail[:, 3] = 1.5
    place = JOINTS[joint]
    ends = [
        equations(state_of(z=5.0, **{f"tail_{joint}_rate": rate + h}), commands, cars)
        for h in (-1e-5, 0.0, 1e-5)
    ]
    slope = (ends[2].force[place, 0] - ends[0].force[place, 0]) / 2e-5
    assert ends[1].damping[place, place, 0] == pytest.approx(-slope, rel=1e-6)
    assert slope < 0.0


def test_wheels_that_spin_resist_a_yaw_by_rolling_the_car_outwards():
    """The gyroscopic moment of four wheels in the air: -w x H, H along +y."""
    cars = cars_of()
    spins = {name: 80.0 for name in STATES if name.startswith("spin")}
    moments = [
        equations(state_of(z=5.0, w_z=2.0, **some), coasting(cars), cars).force[:3, 0]
        for some in (spins, {})
    ]
    expected = [4.0 * float(cars.wheel_inertia[0]) * 80.0 * 2.0, 0.0, 0.0]
    assert moments[0] - moments[1] == pytest.approx(expected, abs=1e-9)


def test_inertia_of_the_tail_is_that_of_the_full_car():
    """Its joints with hub and rotors, and how they couple to the body, at a bent tail."""
    scenario = load_scenario("turn_designed")
    plant = add_car_plant(DiagramBuilder(), scenario, drawn=False).plant
    context = plant.CreateDefaultContext()
    joints = [plant.GetJointByName(f"tail_{name}") for name in JOINTS]
    for joint, angle in zip(joints, (0.3, -0.8), strict=True):
        joint.set_angle(context, angle)
    plant.SetFreeBodyPose(context, plant.GetBodyByName("chassis"), RigidTransform())
    places = [*range(6), *(joint.velocity_start() for joint in joints)]
    full = plant.CalcMassMatrix(context)[np.ix_(places[6:], places)]
    cars = cars_of()
    mass = equations(state_of(tail_pitch=0.3, tail_roll=-0.8), coasting(cars), cars).mass[..., 0]
    assert mass[10:][:, [*range(6), 10, 11]] == pytest.approx(full, rel=1e-6, abs=1e-9)
