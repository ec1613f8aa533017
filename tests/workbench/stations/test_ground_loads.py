"""Forces of the ground that follow from the motion are those that Drake's solver found."""

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.signal_table import GROUND_CONTACTS, WHEELS
from aerodima.workbench.metrics.turn_metrics import LOADED_FORCE
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.simulate.simulation import simulate
from aerodima.workbench.stations.car_station import simulated_car
from aerodima.workbench.stations.ground_loads import GroundLoads


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
