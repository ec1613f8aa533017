"""A rear wing on the car: its drag and its lift by closed form, its columns, arrow and refusals."""

import math

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_station import make_car_station
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.logged_run import add_logged_run
from tests.refusals import assert_refused
from tests.workbench.stands import CarStand

DENSITY = 1.225
SPAN, CHORD = 0.5, 0.2
C_N = 1.98
"""Of flat_plate."""
PUSH = 0.5 * DENSITY * SPAN * CHORD * C_N
"""Force of the air broadside, N per m2/s2."""
MASS = 0.1


def winged(folder, *settings, angle=0.0, **changes):
    """A car without tail and with a wing of a file, whose leading edge is the lower one by `angle`,
    rad.
    """
    wing = {
        "name": "rear_wing",
        "root": [0.0, -SPAN / 2, 0.25],
        "axes": [[0, 1, 0]],
        "lengths": [SPAN],
        "chords": [CHORD, CHORD],
        "normal": [math.sin(angle), 0.0, math.cos(angle)],
        "density": MASS / (SPAN * CHORD),
    }
    path = folder / "wing.yaml"
    path.write_text(yaml.safe_dump({"schema": "aerodima/bodies/1", "bodies": [wing | changes]}))
    return load_scenario("turn_swing", ["tail.mode=none", f"car.bodies={path}", *settings])


@pytest.mark.parametrize("angle", [0.3, -0.3])
def test_air_on_a_wing_gives_a_free_car_its_impulse_and_the_moment_of_that(tmp_path, angle):
    speed, time = 20.0, 0.004
    stand = CarStand(winged(tmp_path, "environment.gravity=0", angle=angle))
    stand.place(RigidTransform([0.0, 0.0, 50.0]), (speed, 0.0, 0.0))
    stand.advance(time)
    push = -PUSH * speed**2 * time * math.sin(angle)
    impulse = push * np.array([math.sin(angle), 0.0, math.cos(angle)])
    com = stand.com()
    momentum = stand.plant.CalcSpatialMomentumInWorldAboutPoint(stand.plant_context, com)
    mass = stand.plant.CalcTotalMass(stand.plant_context)
    # The wing gives way: by 0.2 % after two steps.
    exact = {"rtol": 0.005, "atol": 1e-9}
    assert_allclose(momentum.translational() - [mass * speed, 0.0, 0.0], impulse, **exact)
    arm = [speed * time, 0.0, 50.25] - com
    assert_allclose(momentum.rotational(), np.cross(arm, impulse), **exact)


def rear_wing(builder, plant, wind):
    inertia = SpatialInertia.SolidBoxWithMass(MASS, CHORD, SPAN, 0.01)
    wing = plant.AddRigidBody("wing", plant.GetModelInstanceByName("car"), inertia)
    X_BW = RigidTransform([0.0, 0.0, 0.3])
    plant.WeldFrames(plant.GetFrameByName("chassis"), wing.body_frame(), X_BW)
    material = CoulombFriction(0.5, 0.5)
    plant.RegisterCollisionGeometry(wing, RigidTransform(), Sphere(0.01), "bumper", material)
    plant.Finalize()
    layout = SectionLayout.strip(start=-SPAN / 2, length=SPAN, width=CHORD, axis_B=(0, 1, 0))
    add_tail_force(builder, plant, "wing", layout, C_N, wind=wind)


def test_wing_added_in_python_and_one_of_a_file_are_in_log_and_replay(tmp_path):
    rolling = ["manoeuvre.rolling_start=true", "manoeuvre.speed=8", "wind.mean_x=-3"]
    scenario = winged(tmp_path, *rolling, "manoeuvre.turn_start=0.04", "manoeuvre.duration=0.05")
    log = simulate(scenario, bodies=rear_wing)
    outcome = simulate(scenario, record="outcome", bodies=rear_wing)
    assert outcome.extra["total_mass_kg"] == log.extra["total_mass_kg"]
    assert log.extra["total_mass_kg"] == pytest.approx(scenario.car.mass + 2 * MASS)
    force = log.vector("tail_force_wing", "truth_n")
    assert_allclose(force[0], [-PUSH * 11.0**2, 0.0, 0.0], atol=1e-6)
    assert_allclose(log.vector("rear_wing", "truth_n")[0], 0.0, atol=1e-6)  # edge-on
    replay = add_logged_run(DiagramBuilder(), log)
    arrows = {arrow.name for arrow in replay.arrows}
    assert {"air_on_rear_wing", "air_on_tail_force_wing"} < arrows
    assert replay.plant.HasBodyNamed("rear_wing")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"name": "chassis"}, "'chassis'"),
        ({"coefficients": "flat_plat"}, "flat_plate"),
        ({"axes": [[0, 1]]}, "bodies.0.axes.0.2: missing"),
    ],
)
def test_wrong_bodies_are_refused(tmp_path, changes, named):
    car = winged(tmp_path, **changes)
    assert_refused(lambda: make_car_station(car), UserError, named)
    assert_refused(
        lambda: VehicleParams.from_scenarios([car]), UserError, "car.bodies", "wing.yaml"
    )


def test_a_missing_file_of_bodies_is_refused():
    car = load_scenario("turn_swing", ["car.bodies=none.yaml"])
    assert_refused(lambda: make_car_station(car), UserError, "none.yaml")
