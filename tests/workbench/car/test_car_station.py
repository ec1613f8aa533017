"""The station exports the ports of the contract, simulated or not, and keeps the controller
outside.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Integrator

from aerodima.workbench.car.car_diagram import assemble
from aerodima.workbench.car.car_station import make_car_station, simulated_car
from aerodima.workbench.car.ground_truth import BODY_TRUTH, TAIL_TRUTH
from aerodima.workbench.car.laws import knuckle_motion
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_contract import add_status
from aerodima.workbench.core.port_wiring import constant
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import (
    IMU,
    RIG_STATUS,
    SPEED,
    STATION_OUTPUTS,
    STATUS,
    TAIL_STATE,
)
from tests.refusals import assert_refused
from tests.workbench.stands import CarStand, Interface, port_sizes

INPUTS = {"steering_angle": 1, "throttle": 1, "tail_pitch_command": 5, "tail_roll_command": 5}
OUTPUTS = {"tail_state": 6, "tail_torque": 2, "imu": 9, "speed": 1, "status": 13}
MODES = ("none", "swing")


def stand(mode, **sections):
    return CarStand(scenario_from_dict({"tail": {"mode": mode}} | sections))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("truth", [True, False])
def test_simulated_station_has_the_ports_of_the_contract_with_and_without_its_truth(mode, truth):
    scenario = scenario_from_dict({"tail": {"mode": mode}})
    inputs, outputs = port_sizes(make_car_station(scenario, with_truth=truth))
    assert inputs == INPUTS
    assert {n: size for n, size in outputs.items() if not n.endswith("_truth")} == OUTPUTS
    assert "plant_state_truth" in outputs


def test_interface_takes_the_place_of_the_plant_with_the_same_ports():
    scenario = scenario_from_dict({})
    station = make_car_station(
        scenario, lambda given: Interface(INPUTS, OUTPUTS) if given is scenario else None
    )
    assert port_sizes(station) == (INPUTS, OUTPUTS)


def test_driver_and_controller_connect_to_an_interface_as_to_the_simulation():
    car = assemble(load_scenario("turn_swing"), lambda _: Interface(INPUTS, OUTPUTS))
    assert not [
        name
        for _, names in car.signals
        for name in names
        if "truth" in name or name.startswith("plant_")
    ]
    assert car.builder.Build().num_input_ports() == 0


@pytest.mark.parametrize(
    ("inputs", "outputs", "named"),
    [
        ({}, {"imu": 0}, ("imu (9)", "speed (1)")),
        ({}, {"imu": 6}, ("imu (6)", "imu (9)")),
        ({"throttle": 0}, {}, ("throttle (1)",)),
        ({"brake": 1}, {}, ("brake (1)",)),
        ({}, {"odometer": 1}, ("odometer (1)",)),
        ({"tail_roll_command": 4}, {}, ("tail_roll_command (4)", "tail_roll_command (5)")),
    ],
    ids=str,
)
def test_interface_with_other_ports_is_refused_by_name(inputs, outputs, named):
    def make():
        other = Interface(INPUTS | inputs, OUTPUTS | outputs)
        make_car_station(scenario_from_dict({}), lambda _: other)

    assert_refused(make, UserError, "'interface'", *named)


def test_simulation_without_a_port_of_the_contract_is_refused(monkeypatch):
    monkeypatch.setitem(STATION_OUTPUTS, "wheel_speed", SPEED)
    held = load_scenario("turn_held")
    assert_refused(lambda: make_car_station(held), UserError, "wheel_speed (1)")


def test_status_tells_ages_beside_a_continuous_state():
    builder = DiagramBuilder()
    sampled = {"motor_age": constant(builder, "motor", [0.25])}
    port = builder.ExportOutput(add_status(builder, RIG_STATUS, sampled), "status")
    way = builder.AddSystem(Integrator(1))
    builder.Connect(constant(builder, "speed", [1.0]), way.get_input_port())
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.5)
    status = simulator.get_system().get_output_port(port).Eval(simulator.get_context())
    ages = {"armed": 1.0, "motor_age": 1.25}
    assert list(status) == [ages.get(name, 0.0) for name in RIG_STATUS.fields]


def test_tail_state_names_pitch_and_roll_with_their_signs():
    car = stand("held", tail_motor={"position_range": 12.5}, controller={"pitch_angle": 0.3})
    car.turn("tail_roll", 0.8)
    car.spin("tail_pitch", 1.5)
    car.spin("tail_roll", -2.5)
    car.simulator.Initialize()
    state = TAIL_STATE.read(car.output("tail_state"))
    # One word of the motors' reply: 25 rad in 16 bit, 100 rad/s in 12 bit.
    assert state.pitch_angle == pytest.approx(0.3, abs=4e-4)
    assert state.roll_angle == pytest.approx(0.8, abs=4e-4)
    assert state.pitch_rate == pytest.approx(1.5, abs=0.025)
    assert state.roll_rate == pytest.approx(-2.5, abs=0.025)
    # The sail faces the wind that the sideways tip makes, 0.9 m below: within a word of 12 bit and
    # its noise.
    assert state.sail_rate == 0.0
    locked = CarStand(scenario_from_dict({"tail": {"mode": "held", "sail": "locked"}}))
    locked.simulator.Initialize()
    still = TAIL_STATE.read(locked.output("tail_state"))
    assert (still.sail_angle, still.sail_rate) == (0.0, 0.0)


def test_steering_and_throttle_move_the_car_where_they_say():
    gentle = {
        "tail": {"mode": "none"},
        "drive": {"governor": False},
    }  # a governed step lifts the front wheels
    car = CarStand(scenario_from_dict(gentle), steering_angle=[0.3], throttle=[0.4])
    car.advance(0.8)
    body = BODY_TRUTH.read(car.output("body_truth"))
    assert body.velocity_x_truth_m_per_s > 0.5
    assert body.gyro_z_truth_rad_per_s > 0.5
    reverse = CarStand(scenario_from_dict(gentle), throttle=[-0.4])
    reverse.advance(0.6)
    assert BODY_TRUTH.read(reverse.output("body_truth")).velocity_x_truth_m_per_s < -0.2


def test_each_knuckle_gets_its_own_angle_of_the_linkage():
    sections = {"tail": {"mode": "none"}, "servo": {"linkage": "ackermann"}}
    car = CarStand(scenario_from_dict(sections), steering_angle=[0.3], throttle=[0.3])
    car.advance(1.0)
    angles = [car.angle(f"front_{side}_steering") for side in ("left", "right")]
    # The servo gives way by 200 N m/rad: a few milliradians, where the linkage parts the wheels
    # by 100.
    expected = knuckle_motion(0.3, 0.0, car.scenario.servo, car.scenario.car)[:2]
    assert_allclose(angles, expected, atol=0.01)


def test_status_of_a_simulated_car_is_fresh_armed_and_without_fault():
    car = stand("held")
    imu, gps, controller = (getattr(car.scenario, name) for name in ("imu", "gps", "controller"))
    seen = []
    for time in np.arange(0.5, 0.75, 0.004):
        car.advance(time)
        seen.append(car.output("status").copy())
    status = dict(zip(STATUS.fields, np.array(seen).T, strict=True))
    for name in STATUS.fields:
        if name.endswith("_fault"):
            assert np.all(status[name] == 0.0), name
    assert np.all(status["armed"] == 1.0)
    assert np.all(status["operator_age"] == 0.0)
    for name, rate, delay in (
        ("imu_age", imu.rate, imu.delay),
        ("speed_age", gps.rate, gps.delay),
        ("tail_roll_age", controller.rate, 0.0),
        ("tail_pitch_age", controller.rate, 0.0),
    ):
        # Ages grow from the delay to one period more, and fall back.
        assert status[name].min() >= delay - 1e-9, name
        assert status[name].max() <= delay + 1 / rate + 1e-9, name
        assert np.ptp(status[name]) > 0.3 / rate, name


def test_station_without_tail_ignores_the_commands_and_says_so():
    loud = {
        "tail_pitch_command": [1.0, 2.0, 300.0, 4.0, 5.0],
        "tail_roll_command": [1.0, 2.0, 300.0, 4.0, 5.0],
    }
    scenario = scenario_from_dict({"tail": {"mode": "none"}})
    with_commands = CarStand(scenario, **loud)
    without = CarStand(scenario)
    for car in (with_commands, without):
        car.advance(0.1)
        assert_array_equal(car.output("tail_state"), np.zeros(6))
        assert_array_equal(car.output("tail_torque"), np.zeros(2))
        status = STATUS.read(car.output("status"))
        assert (status.tail_pitch_fault, status.tail_roll_fault, status.sail_fault) == (
            1.0,
            1.0,
            1.0,
        )
        assert (status.imu_fault, status.speed_fault, status.operator_fault) == (0.0, 0.0, 0.0)
    assert_array_equal(with_commands.output("body_truth"), without.output("body_truth"))
    assert with_commands.tail is None
    assert not simulated_car(with_commands.station).plant.HasModelInstanceNamed("tail")


def test_each_command_moves_its_own_joint_with_the_torque_that_is_shown():
    """From rest without gravity and friction: the first step turns each joint the way of its
    torque.
    """
    pitch = [0.0, 0.0, 0.0, 0.0, 0.7]
    roll = [0.0, 0.0, 0.0, 0.0, -0.4]
    still = {"environment": {"gravity": 0.0}, "friction": {"coulomb": 0.0, "viscous": 0.0}}
    car = CarStand(
        scenario_from_dict(still | {"tail": {"mode": "held"}}),
        tail_pitch_command=pitch,
        tail_roll_command=roll,
    )
    joints = [car.plant.GetJointByName(f"tail_{name}") for name in ("pitch", "roll")]
    joints[1].set_angle(car.plant_context, 0.0)
    car.simulator.Initialize()
    assert_allclose(car.output("tail_torque"), [0.7, -0.4])
    assert_allclose(car.output("tail_actuation_truth"), [0.7, -0.4])
    car.advance(0.004)
    rates = [joint.get_angular_rate(car.plant_context) for joint in joints]
    assert rates[0] > 0.01
    assert rates[1] < -0.01
    truth = TAIL_TRUTH.read(car.output("tail_truth"))
    assert truth.tail_power_truth_w == pytest.approx(0.7 * rates[0] - 0.4 * rates[1])


def test_friction_of_the_joints_is_told_apart_from_the_torque_of_the_motors():
    car = stand("held", friction={"coulomb": 0.0, "viscous": 0.1})
    for name, rate in (("pitch", 3.0), ("roll", -2.0)):
        car.spin(f"tail_{name}", rate)
    car.simulator.Initialize()
    assert_array_equal(car.output("tail_torque"), [0.0, 0.0])
    assert_allclose(car.output("tail_actuation_truth"), [-0.3, 0.2])


def test_rolling_wheels_are_braked_by_their_axle_s_resistance():
    """Far above the ground a spinning wheel feels nothing but c_r times the load of its axle at
    its radius.
    """
    resistance = 0.05
    car = stand("none", car={"rolling_resistance": resistance}, environment={"gravity": 9.81})
    numbers = car.scenario.car
    car.place(RigidTransform([0.0, 0.0, 50.0]))
    for sign, wheel in ((1.0, "front_left"), (-1.0, "front_right")):
        car.spin(f"{wheel}_spin", sign * 50.0)
    car.advance(0.1)
    load = 0.5 * numbers.mass * 9.81 * numbers.com_x / numbers.wheelbase
    inertia = 0.5 * numbers.wheel_mass * numbers.tyre_radius**2
    lost = resistance * load * numbers.tyre_radius / inertia * 0.1
    for sign, wheel in ((1.0, "front_left"), (-1.0, "front_right")):
        rate = car.rate(f"{wheel}_spin")
        assert sign * rate == pytest.approx(50.0 - lost, abs=0.05 * lost)


def test_imu_is_where_the_scenario_puts_it():
    """A car that tumbles in space: the IMU feels what the truth says of its place, to a count of
    0.01 m/s2; one in the origin of the chassis would feel several m/s2 less.
    """
    silent = dict.fromkeys(("gyro_noise", "gyro_bias", "accelerometer_noise", "delay"), 0.0)
    car = stand("none", imu=silent | {"x": 0.2, "z": 0.1})
    car.place(RigidTransform([0.0, 0.0, 50.0]))
    velocities = car.plant.GetVelocities(car.plant_context).copy()
    start = car.chassis.floating_velocities_start_in_v()
    spin = np.array([3.0, -2.0, 5.0])
    velocities[start : start + 3] = spin
    car.plant.SetVelocities(car.plant_context, velocities)
    car.advance(0.0099)  # the plant is at the instant of the sample that is taken at 0.01 s
    truth = car.output("body_truth")[BODY_TRUTH.index("acceleration_x_truth_m_per_s2") :][:3]
    car.advance(0.0101)
    imu = IMU.read(car.output("imu"))
    assert_allclose(imu[6:], truth, atol=0.006)
    lever = np.array([0.2, 0.0, 0.1])
    assert np.abs(np.cross(spin, np.cross(spin, lever))).min() > 1.0
