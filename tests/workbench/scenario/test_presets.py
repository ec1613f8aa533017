"""The cars that ship: each number has its source, and other programs get the numbers back that were
published.
"""

import re

import pytest
import yaml

from aerodima.workbench.car.single_track import gym_parameters
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario
from tests.commands import done, refused
from tests.refusals import assert_named, assert_refused

GYM = {
    "mu": 1.0489,
    "lf": 0.15875,
    "lr": 0.17145,
    "h": 0.074,
    "m": 3.74,
    "I": 0.04712,
    "s_min": -0.4189,
    "s_max": 0.4189,
    "sv_min": -3.2,
    "sv_max": 3.2,
    "a_max": 9.51,
    "v_max": 20.0,
    "width": 0.31,
}
"""Of `f1tenth_vehicle_params` in f1tenth_gym (f110_env.py); `C_Sf`, `C_Sr`, and `v_switch`, `v_min`
and `length`, of which our car has no number, stand elsewhere."""


@pytest.mark.parametrize("name", ["f1tenth", "stampede"])
def test_each_number_has_its_source_beside_it(name):
    lines = model_path(f"scenarios/{name}.yaml").read_text().splitlines()
    numbers = [line for line in lines if line.startswith("  ")]
    assert len(numbers) > 30
    sourced = re.compile(r"  \w+: \S.*# (published|datasheet|assumed|chosen): \S")
    assert [line for line in numbers if not sourced.match(line)] == []


@pytest.mark.parametrize("name", ["aerodima", "f1tenth", "stampede"])
def test_a_preset_is_listed_and_turns_left_on_its_wheels(name):
    assert name in done("scenarios", "list")
    assert "outcome: survived" in done("run", name)


def test_f1tenth_gym_gets_its_own_car_back():
    """Our axles share one slip angle: their stiffness is the mean of the published two by load."""
    exported = yaml.safe_load(done("models", "export", "f1tenth", "--form", "f1tenth_gym"))
    stiffness = [exported.pop("C_Sf"), exported.pop("C_Sr")]
    mean = (4.718 * GYM["lr"] + 5.4562 * GYM["lf"]) / 0.3302
    assert stiffness == pytest.approx([mean, mean], rel=1e-4)
    assert exported == pytest.approx(exported | GYM, rel=1e-5)
    assert set(exported) == {*GYM, "v_switch", "v_min", "length"}


def test_commonroad_reads_the_same_car_under_its_names():
    car = yaml.safe_load(done("models", "export", "f1tenth", "--form", "commonroad"))
    # What the first lines of its vehicle_dynamics_st read.
    read = [car["a"], car["b"], car["m"], car["I_z"], car["h_s"], car["steering"]["max"]]
    assert read == pytest.approx([GYM[x] for x in ("lf", "lr", "m", "I", "h", "s_max")], rel=1e-5)
    assert car["tire"] == pytest.approx({"p_dy1": 1.0489, "p_ky1": -1.0489 * 5.0729}, rel=1e-4)


def test_a_tail_is_part_of_the_exported_car():
    held = load_scenario("turn_held")
    # The link in which the tail's joints cross weighs a gram.
    tail = held.tail.mass + held.tail.hub_mass
    assert gym_parameters(held)["m"] == pytest.approx(held.car.mass + tail, abs=0.002)
    assert gym_parameters(held.varied(tail={"added_mass": 0.05})) == gym_parameters(held)


def test_rigid_tyres_and_unknown_forms_are_refused():
    rigid = load_scenario("f1tenth", ["car.tyre_slip_angle=0"])
    assert_refused(lambda: gym_parameters(rigid), ModelError, "car.tyre_slip_angle", "> 0")
    words = ("models", "export", "f1tenth", "--form", "carla")
    assert_named(refused(*words), ("--form carla", "commonroad", "f1tenth_gym"))
