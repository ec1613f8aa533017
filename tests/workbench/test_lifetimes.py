"""A simulated car or rig is freed when its run has ended, so that memory does not grow with the
runs.
"""

import gc
import weakref

import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_diagram import assemble, default_build
from aerodima.workbench.core.system_lifetime import break_reference_cycles
from aerodima.workbench.rig.rig_run import assemble_rig
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from aerodima.workbench.scenario.scenario import load_scenario


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("turn_none", []),
        ("turn_swing", []),
        ("turn_swing", ["tail.sail=locked", "tail.added_mass=0.01"]),
        ("turn_swing_wind", ["tail.added_mass=-0.005"]),
        ("turn_swing_free_sail", []),
    ],
)
def test_diagram_and_station_of_a_car_die(name, settings):
    car = assemble(load_scenario(name, settings))
    with break_reference_cycles(car.builder):
        station = weakref.ref(car.station)
        diagram = weakref.ref(car.builder.Build())
    del car
    gc.collect()
    assert (station(), diagram()) == (None, None)


@pytest.mark.parametrize("name", ["flick", "bar", "robot"])
@pytest.mark.parametrize("settings", [[], ["aero.added_mass=0.01"]])
def test_diagram_and_station_of_a_rig_die(name, settings):
    builder, station = assemble_rig(load_rig_scenario(name, settings))
    with break_reference_cycles(builder):
        station_ref = weakref.ref(station)
        diagram = weakref.ref(builder.Build())
    del builder, station
    gc.collect()
    assert (station_ref(), diagram()) == (None, None)


@pytest.mark.parametrize("record", ["all", "outcome"])
def test_systems_of_a_user_outlive_the_run(record):
    """Who built the diagram may still ask its systems."""
    scenario = load_scenario("turn_none", ["manoeuvre.duration=2.7"])
    held = []

    def build(builder, station):
        default_build(scenario)(builder, station)
        held.append(station)

    simulate(scenario, record=record, build=build)
    gc.collect()
    assert held[0].GetOutputPort("imu").size() == 9
    assert held[0].GetSubsystemByName("plant").num_bodies() > 10
