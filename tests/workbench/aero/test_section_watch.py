import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from aerodima.workbench.aero.section_watch import EXTRAPOLATED, SECTION_COLUMNS, SectionWatch


def watched(watch, validity, reynolds, until):
    simulator = Simulator(watch)
    context = simulator.get_mutable_context()
    sections = np.zeros(len(SECTION_COLUMNS))
    sections[SECTION_COLUMNS.index("reynolds_number")] = reynolds
    watch.GetInputPort("sections").FixValue(context, sections)
    watch.GetInputPort("validity").FixValue(context, [validity])
    simulator.Initialize()
    simulator.AdvanceTo(until)
    return watch.facts()


def test_another_run_starts_from_nothing():
    watch = SectionWatch(1, 100.0)
    first = watched(watch, EXTRAPOLATED, 5000.0, 0.1)
    assert first["sections_outside_measured_range"] == 1.0
    assert first["largest_reynolds_number"] == 5000.0
    second = watched(watch, 0.0, 100.0, 0.1)
    assert second["sections_outside_measured_range"] == 0.0
    assert second["largest_reynolds_number"] == 100.0


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_it_looks_at_its_rate_and_first_at_the_start(rate):
    """Outside at the start only: one look of all."""
    watch = SectionWatch(1, rate)
    simulator = Simulator(watch)
    context = simulator.get_mutable_context()
    watch.GetInputPort("sections").FixValue(context, np.zeros(len(SECTION_COLUMNS)))
    watch.GetInputPort("validity").FixValue(context, [EXTRAPOLATED])
    simulator.Initialize()
    watch.GetInputPort("validity").FixValue(context, [0.0])
    simulator.AdvanceTo(0.999 / rate * 10)
    assert watch.facts()["sections_outside_measured_range"] == pytest.approx(0.1)
