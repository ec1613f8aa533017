"""A tail file on the car: the built tail as one is the same car, and another shape moves and is
drawn as it is.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_air import sail_layout, sail_strips
from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.car.ground_truth import TAIL_TRUTH
from aerodima.workbench.car.tail_file import read_tail, write_tail
from aerodima.workbench.car.tail_plant import (
    arm_inertia,
    inertia_about_joints,
    tail_geometry,
    tail_sdf,
)
from aerodima.workbench.core.errors import ModelError, ScenarioError
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused
from tests.workbench.stands import CarStand

LOCKED = ("manoeuvre.duration=3", "tail.sail=locked")

BENT = """
schema: aerodima/tail/1
name: bent
arm: {lengths: [0.4, 0.4], density: 0.06, axes: [[0, 0, 1], [0, 0.3, 1]]}
plates:
  - {name: sail, kind: half_shell, root: [0, 0.06, 0.6], lengths: [0.1, 0.1], chords: [0.1, 0.14,
  0.08],
     axes: [[0, 0.3, 1], [0, 0.3, 1]], normal: [0, -1, 0], density: 0.27, cap_density: 1.5,
     sections: 2}
  - {name: inner, root: [0, 0, 0.2], lengths: [0.1], chords: [0.05, 0.05], normal: [0, 1, 0],
  density: 0.5, sections: 1}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tails")
    built = tail_geometry(load_scenario("turn_swing").tail)
    bent = folder / "bent.yaml"
    bent.write_text(BENT, encoding="utf-8")
    return {
        "known": write_tail(built, folder / "known.yaml"),
        "densities": write_tail(built.from_densities(), folder / "densities.yaml"),
        "bent": bent,
    }


def tail_plant(car):
    """The plant of a car, and its context."""
    plant = add_car_plant(DiagramBuilder(), car).plant
    return plant, plant.CreateDefaultContext()


def scenario(files, name):
    return load_scenario(
        "turn_swing", [*LOCKED, *([f"tail.geometry={files[name]}"] if name else [])]
    )


@pytest.fixture(scope="module")
def runs(files):
    return {name: simulate(scenario(files, name)) for name in (None, "known", "densities")}


def test_built_tail_as_an_object_with_its_known_inertia_runs_as_before(
    files,
):
    parameters = scenario(files, None)
    own = scenario(files, "known")
    one, other = (tail_sdf(car.tail, car.tail_motor, car.car) for car in (parameters, own))
    for link in ("tail_hub", "tail_rod", "tail_sail"):
        assert one.inertial(link) == other.inertial(link)
    assert sail_strips(own.tail) == sail_strips(parameters.tail)
    assert arm_inertia(own.tail, own.tail_motor, own.car) == arm_inertia(
        parameters.tail, parameters.tail_motor, parameters.car
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["known", "densities"])
def test_run_of_the_built_tail_as_a_file_is_that_of_its_parameters_to_the_last_bit(runs, name):
    assert runs[name].table.equals(runs[None].table)
    assert runs[None].table["tail_roll_angle_rad"].max() > 1.0  # it swung


def test_bent_tail_drives_with_its_own_mass_sections_and_tip(
    files,
):
    geometry = read_tail(files["bent"])
    car = scenario(files, "bent")
    plant, context = tail_plant(car)
    bodies = [plant.GetBodyByName(name).index() for name in ("tail_rod", "tail_sail")]
    frame = plant.GetFrameByName("tail_rod")
    found = plant.CalcSpatialInertia(context, frame, bodies)
    assert found.get_mass() == pytest.approx(geometry.inertial.mass, rel=1e-8)
    assert_allclose(found.get_com(), geometry.inertial.com, rtol=1e-7, atol=1e-9)
    inertia = found.CalcRotationalInertia().CopyToFullMatrix3()
    assert_allclose(inertia, geometry.inertia_about_joints, rtol=1e-7, atol=1e-9)
    assert len(sail_strips(car.tail)) == 2
    stand = CarStand(car)
    tip = stand.output("tail_truth")[TAIL_TRUTH.index("tail_tip_x_truth_m") :][:3]
    roll = -np.pi / 2
    # At rest the tail lies to the left: its own y points down then.
    _, y, z = geometry.arm.points[-1]
    assert_allclose(
        tip[1:], [np.cos(roll) * y - np.sin(roll) * z, car.tail.mount_height - y], atol=0.01
    )


@pytest.mark.parametrize("roll", [0.0, 0.7])
def test_motors_count_with_the_inertia_of_a_tail_that_is_bent_sideways(files, roll):
    car = scenario(files, "bent")
    plant, context = tail_plant(car)
    plant.GetJointByName("tail_roll").set_angle(context, roll)
    joints = [plant.GetJointByName(f"tail_{name}").velocity_start() for name in ("pitch", "roll")]
    rotor = car.tail_motor.rotor_inertia * car.tail_motor.gear_ratio**2
    found = np.diag(plant.CalcMassMatrix(context))[joints] - rotor
    arm = arm_inertia(car.tail, car.tail_motor, car.car)
    assert_allclose(inertia_about_joints(arm, roll), found, rtol=1e-6)


def test_wrong_uses_of_a_tail_file_are_refused(files, tmp_path):
    missing = load_scenario(
        "turn_swing", ["tail.sail=locked", f"tail.geometry={tmp_path / 'none.yaml'}"]
    )
    robot = ["robot_tail.sail=locked", "robot_tail.geometry=a.yaml"]
    for work, error, named in (
        (
            lambda: load_scenario("turn_swing", ["tail.geometry=known.yaml"]),
            ScenarioError,
            ("sail", "'facing'", "known.yaml"),
        ),
        (
            lambda: load_scenario("turn_swing", ["tail.geometry=known", "tail.sail=locked"]),
            ScenarioError,
            ("geometry", "'known'"),
        ),
        (lambda: tail_geometry(missing.tail), ModelError, ("tail.geometry", "none.yaml")),
        (lambda: sail_layout(scenario(files, "bent").tail), ModelError, ("tail.geometry",)),
        (
            lambda: load_rig_scenario("robot", robot),
            ScenarioError,
            ("robot_tail.geometry",),
        ),
    ):
        assert_refused(work, error, *named)
