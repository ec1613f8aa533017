"""The station exports the ports of the contract, simulated or not, and keeps the controller
outside.
"""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from aerodima.workbench.actuators.chassis_actuators import knuckle_angles
from aerodima.workbench.config.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.config.signal_table import (
    RIG_STATUS,
    SPEED,
    STATION_INPUTS,
    STATION_OUTPUTS,
    STATUS,
    TAIL_STATE,
)
from aerodima.workbench.controllers.controller_systems import TailController, TurnDriver
from aerodima.workbench.controllers.manoeuvre import make_schedule
from aerodima.workbench.errors import UserError
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.stations.car_station import make_car_station, simulated_car
from aerodima.workbench.stations.ground_truth import BODY_TRUTH, CONTACT_TRUTH, TAIL_TRUTH
from aerodima.workbench.systems.system_ports import add_status
from tests.workbench.stands import CarStand

INPUTS = {"steering_angle": 1, "throttle": 1, "tail_pitch_command": 5, "tail_roll_command": 5}
OUTPUTS = {"tail_state": 6, "tail_torque": 2, "imu": 9, "speed": 1, "status": 13}
MODES = ("none", "held", "swing")


def sizes(system):
    inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
    outputs = [system.get_output_port(index) for index in range(system.num_output_ports())]
    return tuple({port.get_name(): port.size() for port in ports} for ports in (inputs, outputs))


def stand(mode, **sections):
    return CarStand(scenario_from_dict({"tail": {"mode": mode}} | sections))


class DummyInterface(LeafSystem):
    """Has the ports of the station and does nothing; `changes` gives other sizes, None takes a port
    away.
    """

    def __init__(self, **changes):
        super().__init__()
        self.set_name("dummy_car")
        ports = {
            name: fields.size for name, fields in (STATION_INPUTS | STATION_OUTPUTS).items()
        } | changes
        for name, size in ports.items():
            if size is None:
                continue
            if name in STATION_INPUTS or name.endswith("_in"):
                self.DeclareVectorInputPort(name, size)
            else:
                self.DeclareVectorOutputPort(name, size, lambda context, output: None)


@pytest.mark.parametrize("mode", MODES)
def test_simulated_station_has_the_ports_of_the_contract_and_truth(mode):
    inputs, outputs = sizes(make_car_station(scenario_from_dict({"tail": {"mode": mode}})))
    assert inputs == INPUTS
    sensors = {name: size for name, size in outputs.items() if not name.endswith("_truth")}
    assert sensors == OUTPUTS
    truth = {"body_truth": BODY_TRUTH.size, "contact_truth": CONTACT_TRUTH.size}
    if mode != "none":
        truth["tail_truth"] = TAIL_TRUTH.size
    assert truth.items() <= outputs.items()
    assert "plant_state_truth" in outputs


def test_interface_takes_the_place_of_the_plant_with_the_same_ports():
    scenario = scenario_from_dict({})
    station = make_car_station(
        scenario, lambda given: DummyInterface() if given is scenario else None
    )
    assert sizes(station) == (INPUTS, OUTPUTS)
    simulated_inputs, simulated_outputs = sizes(make_car_station(scenario))
    assert simulated_inputs == INPUTS
    assert {name for name in simulated_outputs if not name.endswith("_truth")} == set(OUTPUTS)


def test_driver_and_controller_connect_to_an_interface_as_to_the_simulation():
    car = assemble(load_scenario("turn_swing"), lambda scenario: DummyInterface())
    assert not [
        name
        for _, names in car.signals
        for name in names
        if "truth" in name or name.startswith("plant_")
    ]
    assert car.builder.Build().num_input_ports() == 0


@pytest.mark.parametrize(
    ("changes", "wrong", "allowed"),
    [
        (
            {"imu": None},
            r"outputs speed \(1\), status \(13\), tail_state \(6\), tail_torque \(2\)",
            r"imu \(9\)",
        ),
        ({"imu": 6}, r"outputs imu \(6\)", r"imu \(9\)"),
        ({"throttle": None}, r"inputs steering_angle \(1\), tail_pitch", r"throttle \(1\)"),
        ({"brake_in": 1}, r"inputs brake_in \(1\)", r"steering_angle \(1\)"),
        ({"odometer": 1}, r"outputs imu \(9\), odometer \(1\)", r"imu \(9\), speed"),
        ({"tail_roll_command": 4}, r"tail_roll_command \(4\)", r"tail_roll_command \(5\)"),
    ],
)
def test_interface_with_other_ports_is_refused_by_name(changes, wrong, allowed):
    with pytest.raises(
        UserError, match=rf"interface of 'dummy_car': .*{wrong}.*allowed: .*{allowed}"
    ):
        make_car_station(scenario_from_dict({}), lambda scenario: DummyInterface(**changes))


def test_simulation_without_a_port_of_the_contract_is_refused(monkeypatch):
    monkeypatch.setitem(STATION_OUTPUTS, "wheel_speed", SPEED)
    with pytest.raises(UserError, match=r"outputs .* allowed: .*wheel_speed \(1\)"):
        make_car_station(load_scenario("turn_held"))


def test_status_needs_every_field_once():
    healthy = ("motor_age", "motor_fault", "force_age", "operator_age", "operator_fault")
    with pytest.raises(
        ValueError, match="status: force_fault; needed once each: motor_age, motor_fault, force_age"
    ):
        add_status(DiagramBuilder(), RIG_STATUS, {}, healthy)


def test_controller_and_driver_stand_outside_the_station():
    car = assemble(load_scenario("turn_swing"))
    inside = car.station.GetSystems()
    assert not [system for system in inside if isinstance(system, TailController | TurnDriver)]
    assert not [system for system in inside if "controller" in system.get_name()]
    beside = car.builder.GetSystems()
    assert len([system for system in beside if isinstance(system, TailController)]) == 1
    assert len([system for system in beside if isinstance(system, TurnDriver)]) == 1


def test_station_takes_commands_from_anybody():
    scenario = load_scenario("turn_swing")
    builder = DiagramBuilder()
    station = builder.AddSystem(make_car_station(scenario))
    driver = TurnDriver.add_to_builder(builder, make_schedule(scenario), station=station)
    TailController.add_to_builder(builder, scenario, station=station, driver=driver)
    assert builder.Build().num_input_ports() == 0


def test_tail_state_names_pitch_and_roll_with_their_signs():
    car = stand("held", tail_motor={"position_range": 12.5}, controller={"pitch_angle": 0.3})
    car.plant.GetJointByName("tail_roll").set_angle(car.plant_context, 0.8)
    car.plant.GetJointByName("tail_pitch").set_angular_rate(car.plant_context, 1.5)
    car.plant.GetJointByName("tail_roll").set_angular_rate(car.plant_context, -2.5)
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


@pytest.mark.parametrize(("direction", "angle"), [("left", -np.pi / 2), ("right", np.pi / 2)])
def test_tail_waits_on_the_inside_of_the_turn(direction, angle):
    car = stand("held", manoeuvre={"direction": direction})
    car.simulator.Initialize()
    assert TAIL_STATE.read(car.output("tail_state")).roll_angle == pytest.approx(angle, abs=4e-4)


def test_tail_torque_answers_each_command_on_its_own_joint():
    pitch = [0.0, 0.0, 0.0, 0.0, 0.7]
    roll = [0.0, 0.0, 0.0, 0.0, -0.4]
    car = CarStand(scenario_from_dict({}), tail_pitch_command=pitch, tail_roll_command=roll)
    car.simulator.Initialize()
    np.testing.assert_allclose(car.output("tail_torque"), [0.7, -0.4])


def test_steering_and_throttle_move_the_car_where_they_say():
    gentle = {
        "tail": {"mode": "none"},
        "drive": {"governor": False},
    }  # a governed step lifts the front wheels
    car = CarStand(scenario_from_dict(gentle), steering_angle=[0.3], throttle=[0.4])
    car.advance(1.0)
    body = BODY_TRUTH.read(car.output("body_truth"))
    assert body.velocity_x_truth_m_per_s > 0.5
    assert body.gyro_z_truth_rad_per_s > 0.5
    reverse = CarStand(scenario_from_dict(gentle), throttle=[-0.4])
    reverse.advance(1.0)
    assert BODY_TRUTH.read(reverse.output("body_truth")).velocity_x_truth_m_per_s < -0.5


def test_each_knuckle_gets_its_own_angle_of_the_linkage():
    sections = {"tail": {"mode": "none"}, "servo": {"linkage": "ackermann"}}
    car = CarStand(scenario_from_dict(sections), steering_angle=[0.3], throttle=[0.3])
    car.advance(1.0)
    angles = [
        car.plant.GetJointByName(f"front_{side}_steering").get_angle(car.plant_context)
        for side in ("left", "right")
    ]
    # The servo gives way by 200 N m/rad: a few milliradians, where the linkage parts the wheels
    # by 100.
    np.testing.assert_allclose(
        angles, knuckle_angles(0.3, car.scenario.servo, car.scenario.car), atol=0.01
    )


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
        np.testing.assert_array_equal(car.output("tail_state"), np.zeros(6))
        np.testing.assert_array_equal(car.output("tail_torque"), np.zeros(2))
        status = STATUS.read(car.output("status"))
        assert (status.tail_pitch_fault, status.tail_roll_fault, status.sail_fault) == (
            1.0,
            1.0,
            1.0,
        )
        assert (status.imu_fault, status.speed_fault, status.operator_fault) == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(with_commands.output("body_truth"), without.output("body_truth"))
    assert with_commands.tail is None
    assert not simulated_car(with_commands.station).plant.HasModelInstanceNamed("tail")
