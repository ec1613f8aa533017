"""The rig behind its ports."""

import math

import pytest

from aerodima.workbench.rig.rig_log import static_coefficients
from aerodima.workbench.rig.rig_station import make_rig_station
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.workbench.stands import port_sizes

INPUTS = {"tail_command": 5}
OUTPUTS = {"rig_state": 2, "motor_current": 1, "force_torque": 6, "status": 7}


@pytest.mark.parametrize(
    ("name", "expected"),
    [("robot", INPUTS), ("flick", {"current_command": 1}), ("bar", {"current_command": 1})],
)
def test_simulated_rig_takes_a_command_of_its_motor(name, expected):
    inputs, outputs = port_sizes(make_rig_station(load_rig_scenario(name)))
    assert inputs == expected
    assert {port: outputs[port] for port in outputs if not port.endswith("_truth")} == OUTPUTS


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
