"""A simulated car or rig is freed when nobody holds it any more, so that memory does not grow with the runs."""

import gc
import weakref

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from aerodima.workbench.config.rig_scenario import load_rig_scenario
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.simulate.rig_run import assemble_rig


class _One(LeafSystem):
    """The least Python system that computes something."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("one", 1, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.ones(1))


def python_systems_die() -> bool:
    """False on a Drake that keeps every Python system, and with it its diagram, for ever."""
    builder = DiagramBuilder()
    builder.AddSystem(_One())
    diagram = weakref.ref(builder.Build())
    del builder
    gc.collect()
    return diagram() is None


pytestmark = pytest.mark.skipif(
    not python_systems_die(), reason="this Drake keeps every Python LeafSystem for ever (drake issues 22515 and 23161)"
)


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
def test_diagram_and_station_of_a_car_die(name: str, settings: list[str]) -> None:
    car = assemble(load_scenario(name, settings))
    station, diagram = weakref.ref(car.station), weakref.ref(car.builder.Build())
    del car
    gc.collect()
    assert (station(), diagram()) == (None, None)


@pytest.mark.parametrize("name", ["flick", "bar", "robot"])
@pytest.mark.parametrize("settings", [[], ["aero.added_mass=0.01"]])
def test_diagram_and_station_of_a_rig_die(name: str, settings: list[str]) -> None:
    builder, station = assemble_rig(load_rig_scenario(name, settings))
    station_ref, diagram = weakref.ref(station), weakref.ref(builder.Build())
    del builder, station
    gc.collect()
    assert (station_ref(), diagram()) == (None, None)
