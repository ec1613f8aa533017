"""The recorder writes one row per period, names what does not fit, and takes whole turns out of
headings.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from aerodima.workbench.logs.journal import JournalWriter, read_journal
from aerodima.workbench.logs.recorder import RunRecorder, recorded_columns
from aerodima.workbench.logs.schema import run_metadata
from tests.refusals import assert_refused


class Spinner(LeafSystem):
    """A heading that turns at 20 rad/s, wrapped to (-pi, pi], and its sine."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("heading", 1, self._calc_heading)
        self.DeclareVectorOutputPort("both", 2, self._calc_both)

    def _calc_heading(self, context, output):
        output[0] = np.angle(np.exp(20j * context.get_time()))

    def _calc_both(self, context, output):
        heading = np.angle(np.exp(-20j * context.get_time()))
        output.SetFromVector([heading, np.sin(heading)])


def record(tmp_path, rate, until, names, **options):
    builder = DiagramBuilder()
    spinner = builder.AddSystem(Spinner())
    signals = [
        (spinner.GetOutputPort("heading"), names[:1]),
        (spinner.GetOutputPort("both"), names[1:]),
    ]
    columns = recorded_columns(signals)
    assert columns == ["time_s", *names]
    journal = JournalWriter(
        tmp_path / "spin.parquet", columns, run_metadata({}, seed=0, kind="spin")
    )
    RunRecorder.add_to_builder(builder, journal, signals, rate, **options)
    Simulator(builder.Build()).AdvanceTo(until)
    return read_journal(journal.abandon())[0].to_pandas()


def test_headings_are_unwrapped_and_other_angles_are_not(tmp_path):
    table = record(tmp_path, 100.0, 1.0, ["yaw_truth_rad", "imu_yaw_rad", "sail_angle_rad"])
    time = table["time_s"].to_numpy()
    assert_allclose(time, np.arange(101) * 0.01, atol=1e-12)
    assert_allclose(table["yaw_truth_rad"], 20 * time, atol=1e-9)
    assert_allclose(table["imu_yaw_rad"], -20 * time, atol=1e-9)
    assert_allclose(table["sail_angle_rad"], np.sin(-20 * time), atol=1e-9)


@pytest.mark.parametrize("options", [{}, {"step": 0.001}, {"with_samples": True}])
def test_times_of_the_rows_are_the_instants_bit_for_bit(tmp_path, options):
    """Not sums of steps, nor the moment beside the instant at which a row is taken."""
    table = record(tmp_path, 30.0, 1.02, ["a", "b", "c"], **options)
    assert table["time_s"].tolist() == [number / 30.0 for number in range(31)]


def test_port_and_names_of_different_length_are_refused():
    port = Spinner().GetOutputPort("both")
    assert_refused(lambda: recorded_columns([(port, ["one"])]), ValueError, "both", "2", "1")
