"""The rig behind its ports: simulated and real have the same ones."""

import math
from functools import partial

import pytest
from pydrake.systems.framework import LeafSystem

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.rig.rig_log import static_coefficients
from aerodima.workbench.rig.rig_station import make_rig_station
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from aerodima.workbench.scenario.signal_table import MOTOR_CURRENT, RIG_OUTPUTS, ROBOT_RIG_INPUTS
from tests.refusals import assert_refused


class FakeInterface(LeafSystem):
    """Has the ports of the contract and shows zeros."""

    def __init__(self, inputs=ROBOT_RIG_INPUTS, outputs=RIG_OUTPUTS):
        super().__init__()
        self.set_name("fake_interface")
        for name, fields in inputs.items():
            self.DeclareVectorInputPort(name, fields.size)
        for name, fields in outputs.items():
            self.DeclareVectorOutputPort(name, fields.size, lambda context, output: None)


def ports(station):
    inputs = {
        station.get_input_port(i).get_name(): station.get_input_port(i).size()
        for i in range(station.num_input_ports())
    }
    outputs = {
        station.get_output_port(i).get_name(): station.get_output_port(i).size()
        for i in range(station.num_output_ports())
    }
    return inputs, {name: size for name, size in outputs.items() if not name.endswith("_truth")}


def test_simulated_and_real_robot_rig_have_the_same_ports():
    scenario = load_rig_scenario("robot")
    simulated = make_rig_station(scenario)
    real = make_rig_station(scenario, interface=lambda scenario: FakeInterface())
    assert ports(simulated) == ports(real)
    assert ports(real) == (
        {"tail_command": 5},
        {"rig_state": 2, "motor_current": 1, "force_torque": 6, "status": 7},
    )
    assert not any(
        real.get_output_port(i).get_name().endswith("_truth")
        for i in range(real.num_output_ports())
    )


@pytest.mark.parametrize("name", ["flick", "bar"])
def test_cheetah_rig_takes_a_current(name):
    inputs, outputs = ports(make_rig_station(load_rig_scenario(name)))
    assert inputs == {"current_command": 1}
    assert outputs == {port: fields.size for port, fields in RIG_OUTPUTS.items()}


SHORT = {name: fields for name, fields in RIG_OUTPUTS.items() if name != "force_torque"}


@pytest.mark.parametrize(
    ("name", "interface", "named"),
    [
        ("flick", FakeInterface, ("'swing'", "'robot_swing'")),
        ("robot", partial(FakeInterface, outputs=SHORT), ("'fake_interface'", "force_torque")),
        (
            "robot",
            partial(FakeInterface, inputs={"current_command": MOTOR_CURRENT}),
            ("'fake_interface'", "current_command", "tail_command"),
        ),
    ],
)
def test_rig_without_hardware_and_interface_with_other_ports_are_refused(name, interface, named):
    scenario = load_rig_scenario(name)
    assert_refused(
        lambda: make_rig_station(scenario, interface=lambda _: interface()), UserError, *named
    )


def test_offsets_of_the_sensor_are_the_published_ones_of_a_cheetah_tail():
    static = load_rig_scenario("static")
    assert static.sensor_offsets == static.tail_1.offsets
    assert static.varied(experiment={"tail": 3}).sensor_offsets == static.tail_3.offsets
    assert any(static.tail_1.offsets)
    assert not any(load_rig_scenario("robot").sensor_offsets)


def test_coefficients_of_a_hold_are_those_at_its_angle_against_the_wind():
    """sin(attack) = |sin(angle + misalignment)| cos(psi): the wind across the tail's plane shares
    its speed.
    """
    static = load_rig_scenario("static")

    def of(angle, **tunnel):
        return static_coefficients(static.varied(experiment={"angle": angle}, tunnel=tunnel))

    straight = of(0.3, psi3=0.0)
    assert of(-0.3, psi3=0.0) == straight
    assert of(0.25, psi3=0.0, misalignment=0.05) == pytest.approx(straight)
    attack = math.asin(math.sin(0.3) * math.cos(0.5))
    assert of(0.3, psi3=0.5) == pytest.approx(of(attack, psi3=0.0))
    assert of(0.3, psi3=0.5) != pytest.approx(straight, rel=1e-3)
