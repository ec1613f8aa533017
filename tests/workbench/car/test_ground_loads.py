"""Forces of the ground that follow from the motion are those that Drake's solver found; lifts are
those of a pose.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_diagram import assemble
from aerodima.workbench.car.car_station import simulated_car
from aerodima.workbench.car.ground_loads import GroundLoads
from aerodima.workbench.car.ground_truth import CONTACT_TRUTH
from aerodima.workbench.car.termination import STOPPED, FlipWatch, quaternion_flipped
from aerodima.workbench.car.tip_up import LIFT_COLUMNS
from aerodima.workbench.car.verdict import FLIP_TILT, LOADED_FORCE, TWO_WHEELS, side_lift
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import GROUND_CONTACTS, WHEELS
from tests.certain_cars import HIGH_CAR
from tests.workbench.stands import CarStand


@pytest.mark.parametrize("sail", ["facing", "locked", "free"])
def test_heights_are_those_of_the_plant_wherever_it_stands(sail):
    car = simulated_car(assemble(load_scenario("turn_swing", [f"tail.sail={sail}"])).station)
    plant = car.plant
    loads = GroundLoads(car)
    context = plant.CreateDefaultContext()
    rng = np.random.default_rng(1)
    positions = rng.uniform(-1.0, 1.0, (plant.num_positions(), 5))
    positions[:4] /= np.linalg.norm(positions[:4], axis=0)
    known = {}
    bodies = {shape.body for shape in loads._shapes}
    assert {"chassis", "tail_sail"} <= {plant.get_body(body).name() for body in bodies}
    for body in bodies:
        up, height = loads._height(body, positions, known)
        for column in range(positions.shape[1]):
            plant.SetPositions(context, positions[:, column])
            X_WB = plant.EvalBodyPoseInWorld(context, plant.get_body(body))
            assert_allclose(height[column], X_WB.translation()[2], rtol=0.0, atol=1e-12)
            assert_allclose(up[:, column], X_WB.rotation().matrix()[2], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("shape", ["cylinder", "ellipsoid"])
@pytest.mark.parametrize(("angle", "inner"), [(0.1, "left"), (-0.4, "right")])
def test_a_car_that_leans_on_its_outer_wheels_lifts_the_inner_ones(shape, angle, inner):
    scenario = load_scenario("turn_none", [f"car.tyre_shape={shape}"])
    car = simulated_car(assemble(scenario).station)
    plant = car.plant
    loads = GroundLoads(car)
    width = scenario.car.tyre_width
    level = plant.GetPositions(plant.CreateDefaultContext())[:, None]
    # It rolls about a line on the ground below the outer edges of its tyres; an ellipsoid has no
    # edge.
    outwards = -np.sign(angle) * (
        0.5 * scenario.car.track + (0.5 * width if shape == "cylinder" else 0.0)
    )
    start = plant.GetBodyByName("chassis").floating_positions_start()
    rolled = level.copy()
    rolled[start : start + 4, 0] = np.cos(0.5 * angle), np.sin(0.5 * angle), 0.0, 0.0
    rolled[start + 5 : start + 7, 0] += outwards * (1.0 - np.cos(angle)), -outwards * np.sin(angle)
    risen = dict(zip(WHEELS, (loads.lifts(rolled) - loads.lifts(level))[:, 0], strict=True))
    for axle in ("front", "rear"):
        outer = "right" if inner == "left" else "left"
        difference = risen[f"{axle}_{inner}"] - risen[f"{axle}_{outer}"]
        assert difference == pytest.approx(scenario.car.track * abs(np.sin(angle)), abs=1e-3)
        if shape == "cylinder":
            assert risen[f"{axle}_{outer}"] == pytest.approx(0.0, abs=2e-3), (
                "half the rounding of an edge"
            )


def test_wheels_without_load_are_those_in_the_air():
    """A load is that of the step before its row: of a wheel that was pressed when the step
    began.
    """
    short = ["manoeuvre.rolling_start=true", "manoeuvre.turn_start=0.1", "manoeuvre.duration=1.0"]
    scenario = load_scenario("turn_none", [*HIGH_CAR, *short, "manoeuvre.speed=3.4"])
    log = simulate(scenario, record="outcome")
    lifts = np.column_stack([log.signal(name) for name in LIFT_COLUMNS])
    loads = np.column_stack([log.signal(f"wheel_force_{wheel}_z_truth_n") for wheel in WHEELS])
    in_air = lifts > 0.0
    without_load = loads == 0.0
    assert in_air.any(axis=0).sum() >= 2
    assert np.max(side_lift(lifts.T)) > TWO_WHEELS
    assert without_load[1:][in_air[:-1]].all()
    leaving = without_load[1:] & ~in_air[:-1]
    assert leaving.any()
    assert (lifts[1:][leaving] > -1e-5).all(), "they leave the ground within the step"


@pytest.mark.parametrize(
    ("roll", "car", "tail", "part"),
    [
        (0.3, {}, {"mode": "none"}, "rear_right"),
        (0.3, {"tyre_shape": "ellipsoid"}, {"mode": "none"}, "rear_right"),
        (2.8, {}, {"mode": "none"}, "cage"),
        (-0.9, {}, {"mode": "held", "sail": "free"}, "tail"),
    ],
    ids=["cylinders", "ellipsoids", "cage", "tail"],
)
def test_loads_of_a_car_that_is_dropped_are_those_of_the_contact_solver(roll, car, tail, part):
    """Onto wheels, cage or tail, turning and sliding: the whole impact, step by step."""
    stand = CarStand(scenario_from_dict({"car": car, "tail": tail}))
    stand.place(RigidTransform(RollPitchYaw(roll, 0.1, 0.4), [0.0, 0.0, 0.35]), (1.0, 0.5, -1.5))
    step = stand.scenario.simulation.step
    positions = [stand.plant.GetPositions(stand.plant_context).copy()]
    expected = []
    for number in range(1, 120):
        stand.advance((number + 0.5) * step)
        positions.append(stand.plant.GetPositions(stand.plant_context).copy())
        contact = CONTACT_TRUTH.read(stand.output("contact_truth"))._asdict()
        wheels = [contact[f"wheel_force_{wheel}_z_truth_n"] for wheel in WHEELS]
        vertical = dict.fromkeys(GROUND_CONTACTS, 0.0)
        for point in stand.contacts():
            touching = stand.shape_of(point).split("_")[0]
            if touching in vertical:
                vertical[touching] += abs(point.contact_force()[2])
        expected.append([*wheels, *vertical.values()])
    motion = np.array(positions[1:]).T
    found = GroundLoads(simulated_car(stand.station)).forces(motion[:, :-1], motion[:, 1:])
    loads = np.array(expected[1:]).T
    assert loads[(*WHEELS, *GROUND_CONTACTS).index(part)].max() > 20.0
    assert_allclose(found, loads, rtol=1e-5, atol=1e-3)


def test_outcome_of_a_run_has_the_columns_of_its_log():
    """Motion, motor torques and power to rounding, at rows on steps of 2 ms and between them; loads
    as above, and none before the first step.
    """
    short = ["manoeuvre.rolling_start=true", "manoeuvre.turn_start=0.05", "manoeuvre.duration=0.4"]
    scenario = load_scenario("turn_swing", [*short, "simulation.log_rate=300"])
    outcome = simulate(scenario, record="outcome")
    log = simulate(scenario)
    assert len(outcome.table) == len(log.table)
    shared = set(outcome.table) & set(log.table)
    assert {"tail_power_truth_w", "acceleration_y_truth_m_per_s2", "yaw_truth_rad"} <= shared
    for name in sorted(shared):
        loads = name.startswith(("wheel_force", "ground_contact"))
        assert_allclose(
            outcome.signal(name),
            log.signal(name),
            rtol=0.0,
            atol=0.2 * LOADED_FORCE if loads else 1e-9 * np.abs(log.signal(name)).max() + 1e-12,
            err_msg=name,
        )
    assert outcome.signal("wheel_force_rear_left_z_truth_n")[0] == 0.0
    assert outcome.signal("wheel_force_rear_left_z_truth_n")[1] > 1.0
    assert np.abs(outcome.signal("tail_power_truth_w")).max() > 1.0


def test_a_watch_ends_the_run_of_a_flipped_car_from_its_time_on():
    """Upside down from the start, and it has flipped even if it stands up again."""
    scenario = scenario_from_dict({"tail": {"mode": "none"}})
    stand = CarStand(scenario)
    watch = FlipWatch(stand.station, 100.0, stop_after=0.05)
    simulator = Simulator(watch)
    context = simulator.get_mutable_context()
    upright = stand.plant.GetPositionsAndVelocities(stand.plant_context).copy()
    start = stand.chassis.floating_positions_start()
    over = upright.copy()
    over[start : start + 4] = [0.0, 3.0, 0.0, 0.0]  # half a turn, of any length
    port = watch.GetInputPort("plant_state")
    for state, until in ((upright, 0.015), (over, 0.025), (upright, 0.2)):
        port.FixValue(context, state)
        simulator.AdvanceTo(until)
    assert watch.facts() == {STOPPED: pytest.approx(0.05)}
    assert context.get_time() == pytest.approx(0.05)


@pytest.mark.parametrize("tilt", [0.0, 1.0, 1.4, 1.7, 3.0])
def test_a_car_has_flipped_beyond_the_angle_of_a_flip_about_any_axis(tilt):
    for heading in (0.0, 2.0, -1.0):
        rotation = (
            RollPitchYaw(0.0, 0.0, heading).ToRotationMatrix()
            @ RollPitchYaw(tilt, 0.0, 0.7).ToRotationMatrix()
        )
        assert quaternion_flipped(3.0 * rotation.ToQuaternion().wxyz()) == (tilt > FLIP_TILT)
