"""A rear wing on the car: its drag and its lift by closed form, its columns, arrow and refusals."""

import math

import pytest
from numpy.testing import assert_allclose
from pydrake.math import RigidTransform
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_station import make_car_station
from aerodima.workbench.car.ground_truth import BODY_TRUTH
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.core.errors import ModelError, UserError
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.logged_run import add_logged_run
from tests.refusals import assert_refused
from tests.workbench.stands import CarStand

DENSITY = 1.225
SPAN, CHORD = 0.5, 0.2
SPEED = 8.0
MASS = 0.1


def wing_file(folder, height, angle=0.0, coefficients="flat_plate", **other):
    """A wing whose leading edge is the lower one by `angle`, rad."""
    values = {"name": "rear_wing", "x": 0.0, "axis": "[0, 1, 0]"} | other
    path = folder / "wing.yaml"
    path.write_text(
        f"""schema: aerodima/bodies/1
bodies:
  - name: {values["name"]}
    root: [{values["x"]}, {-SPAN / 2}, {height}]
    axes: [{values["axis"]}]
    lengths: [{SPAN}]
    chords: [{CHORD}, {CHORD}]
    normal: [{math.sin(angle)}, 0.0, {math.cos(angle)}]
    density: {MASS / (SPAN * CHORD)} kg/m2
    coefficients: {coefficients}
""",
        encoding="utf-8",
    )
    return f"car.bodies={path}"


def drag_file(folder, drag):
    """Coefficients of a body with the same drag whatever its angle to the flow."""
    path = folder / "drag.yaml"
    path.write_text(
        f"""schema: aerodima/coefficients/1
name: drag
source: of this test
law: polar
kind: constant
quasi_steady_limit_m_per_s: 30.0
range: {{speed_m_per_s: [0.0, 30.0], angle_rad: [0.0, 1.5]}}
cd: {drag}
cl: 0.0
""",
        encoding="utf-8",
    )
    return path


def test_drag_of_a_wing_at_zero_angle_slows_a_free_car_as_the_closed_form_says(tmp_path):
    car = load_scenario("turn_swing").car
    wing = wing_file(tmp_path, car.com_height, coefficients=drag_file(tmp_path, 1.5), x=car.com_x)
    stand = CarStand(load_scenario("turn_swing", ["tail.mode=none", "environment.gravity=0", wing]))
    stand.place(RigidTransform([0.0, 0.0, 50.0]), (20.0, 0.0, 0.0))
    stand.advance(0.3)
    k = DENSITY * SPAN * CHORD * 1.5 / (2.0 * (car.mass + MASS))
    # Springs without load and a governor that turns the wheels move the middle of the car a little.
    assert stand.com_velocity()[0] == pytest.approx(20.0 / (1.0 + k * 20.0 * 0.3), rel=2e-3)


@pytest.mark.parametrize("angle", [0.3, -0.3], ids=["pressed down", "lifted"])
def test_lift_at_the_rear_axle_moves_the_rear_wheel_loads_as_the_closed_form_says(tmp_path, angle):
    wind, height = 12.0, 0.25
    loads, expected = [], []
    for turned in (angle, 0.0):
        settings = ["tail.mode=none", f"wind.mean_x={-wind}", wing_file(tmp_path, height, turned)]
        stand = CarStand(load_scenario("turn_swing", settings))
        stand.advance(0.9)
        before = stand.com_velocity()[0]
        stand.advance(1.0)
        speed = stand.com_velocity()[0]  # the drag moves the car, at 0.2 m/s2
        mass = stand.plant.CalcTotalMass(stand.plant_context)
        x, _, z = stand.com()
        wheels = stand.wheel_loads()
        loads.append(wheels["rear_left"] + wheels["rear_right"])
        leant = turned + BODY_TRUTH.read(stand.output("body_truth")).pitch_truth_rad
        force = 0.5 * DENSITY * 1.98 * SPAN * CHORD * (wind + speed) ** 2 * math.sin(leant)
        # About the contact of the front wheels; the wing is over the rear axle.
        ahead = stand.wheel_contacts()["front_left"][0]
        wheelbase = stand.scenario.car.wheelbase
        weight = mass * 9.81 * (ahead - x) + mass * (speed - before) / 0.1 * z
        air = force * (math.cos(leant) * wheelbase + math.sin(leant) * height)
        expected.append((weight + air) / wheelbase)
    change = loads[0] - loads[1]
    assert change == pytest.approx(expected[0] - expected[1], rel=0.02)  # the wing sinks by 4 mm
    assert change * math.copysign(1.0, angle) > 2.0


def rear_wing(builder, plant, wind):
    wing = plant.AddRigidBody(
        "wing",
        plant.GetModelInstanceByName("car"),
        SpatialInertia.SolidBoxWithMass(MASS, CHORD, SPAN, 0.01),
    )
    X_BW = RigidTransform([0.0, 0.0, 0.3])
    plant.WeldFrames(plant.GetFrameByName("chassis"), wing.body_frame(), X_BW)
    plant.Finalize()
    layout = SectionLayout.strip(
        start=-SPAN / 2, length=SPAN, width=CHORD, axis_B=(0, 1, 0), normal_B=(0, 0, 1)
    )
    add_tail_force(builder, plant, "wing", layout, PolarLaw(0.5, 0.0), wind=wind)


def test_wing_added_in_python_and_one_of_a_file_are_in_log_and_replay(tmp_path):
    rolling = ["manoeuvre.rolling_start=true", f"manoeuvre.speed={SPEED}", "wind.mean_x=-3"]
    settings = [*rolling, "manoeuvre.turn_start=0.04", "manoeuvre.duration=0.05"]
    scenario = load_scenario("turn_swing", ["tail.mode=none", *settings, wing_file(tmp_path, 0.25)])
    log = simulate(scenario, bodies=rear_wing)
    assert log.extra["total_mass_kg"] == pytest.approx(scenario.car.mass + 2 * MASS)
    push = -0.5 * DENSITY * 0.5 * SPAN * CHORD * (SPEED + 3.0) ** 2
    force = log.vector("tail_force_wing", "truth_n")
    assert_allclose(force[0], [push, 0.0, 0.0], atol=1e-6)
    assert_allclose(log.vector("rear_wing", "truth_n")[0], 0.0, atol=1e-6)  # edge-on
    replay = add_logged_run(DiagramBuilder(), log)
    arrows = {arrow.name: arrow for arrow in replay.arrows}
    assert {"air_on_rear_wing", "air_on_tail_force_wing"} < set(arrows)
    assert replay.plant.HasBodyNamed("rear_wing")


def test_wrong_bodies_are_refused(tmp_path):
    def car(**options):
        return load_scenario("turn_swing", [wing_file(tmp_path, 0.25, **options)])

    missing = load_scenario("turn_swing", ["car.bodies=none.yaml"])
    for work, error, named in (
        (lambda: make_car_station(missing), ModelError, ("none.yaml",)),
        (lambda: make_car_station(car(name="chassis")), ModelError, ("car.bodies", "'chassis'")),
        (
            lambda: make_car_station(car(coefficients="flat_plat")),
            ModelError,
            ("flat_plate",),
        ),
        (
            lambda: make_car_station(car(axis="[0, 1]")),
            ModelError,
            ("wing.yaml", "bodies.0.axes.0.2", "[0, 1]"),
        ),
        (lambda: VehicleParams.from_scenarios([car()]), UserError, ("car.bodies", "wing.yaml")),
    ):
        assert_refused(work, error, *named)
