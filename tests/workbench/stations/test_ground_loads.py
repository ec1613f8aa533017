"""Forces of the ground that follow from the motion are those that Drake's solver found."""

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.signal_table import GROUND_CONTACTS, WHEELS
from aerodima.workbench.metrics.turn_metrics import LOADED_FORCE
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.simulate.simulation import simulate
from aerodima.workbench.stations.car_station import simulated_car
from aerodima.workbench.stations.outcome_record import GroundLoads


@pytest.mark.parametrize(
    ("name", "settings", "parts"),
    [
        ("turn_swing", [], ()),
        ("turn_swing", ["manoeuvre.speed=4.5", "car.tyre_friction=0.9", "tail.sail=free"], ("cage", "tail")),
        ("turn_none", ["manoeuvre.speed=3.61", "car.tyre_shape=ellipsoid"], ("cage",)),
    ],
)
def test_loads_are_those_of_the_contact_solver(name, settings, parts):
    scenario = load_scenario(name, settings)
    log = simulate(scenario)
    positions = log.table.filter(like="plant_position_").to_numpy().T
    loads = GroundLoads(simulated_car(assemble(scenario).station))
    found = dict(zip((*WHEELS, *GROUND_CONTACTS), loads.forces(positions[:, :-1], positions[:, 1:]), strict=True))
    for wheel in WHEELS:
        expected = log.signal(f"wheel_force_{wheel}_z_truth_n")[1:]
        assert expected.max() > 10.0
        np.testing.assert_allclose(found[wheel], expected, rtol=0.0, atol=0.2 * LOADED_FORCE, err_msg=wheel)
    for part in GROUND_CONTACTS:
        expected = log.signal(f"ground_contact_{part}_truth_n")[1:]
        assert expected.max() > 1.0 or part not in parts, part
        # The log has the whole force, here is its vertical part: who touches is the same.
        assert (found[part] > LOADED_FORCE).any() == (expected > LOADED_FORCE).any(), part


@pytest.mark.parametrize("sail", ["facing", "locked", "free"])
def test_heights_are_those_of_the_plant_wherever_it_stands(sail):
    car = simulated_car(assemble(load_scenario("turn_swing", [f"tail.sail={sail}"])).station)
    plant, loads = car.plant, GroundLoads(car)
    context, rng = plant.CreateDefaultContext(), np.random.default_rng(1)
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
            np.testing.assert_allclose(height[column], X_WB.translation()[2], rtol=0.0, atol=1e-12)
            np.testing.assert_allclose(up[:, column], X_WB.rotation().matrix()[2], rtol=0.0, atol=1e-12)
