"""`aerodima log metrics` and `aerodima log recover`."""

from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.logs.journal import journal_path
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import load_scenario
from tests.commands import done

SETTINGS = [
    "manoeuvre.turn_start=0.9",
    "manoeuvre.speed_ramp=0.7",
    "manoeuvre.duration=1.7",
    "manoeuvre.speed=1.5",
]
"""At 2 m/s2: harder, up to the tyres' friction, the short car rears up on its board."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "run.parquet"
    simulate(load_scenario("turn_none", SETTINGS), path)
    return path


def test_metrics_prints_and_writes_the_figures_of_the_log(log, tmp_path):
    table = tmp_path / "metrics.csv"
    done("log", "metrics", log, "--out", table)
    written = pd.read_csv(table, index_col="run").loc[str(log)]
    expected = metrics_of(read_run_log(log)).as_row()
    assert written["outcome"] == "survived"
    for name in (
        "speed_m_per_s",
        "average_yaw_rate_rad_per_s",
        "filtered_max_linear_acceleration_m_per_s2",
    ):
        assert written[name] == pytest.approx(expected[name], rel=1e-12)


def test_metrics_prints_the_eight_raw_and_filtered(log):
    shown = dict(line.split() for line in done("log", "metrics", log).splitlines()[1:])
    expected = metrics_of(read_run_log(log))
    for prefix, metrics in (("", expected.raw), ("filtered_", expected.filtered)):
        for name, value in asdict(metrics).items():
            assert float(shown[prefix + name]) == pytest.approx(value, rel=1e-3)
    assert shown["touched"] == "none"


def test_metrics_names_the_file_that_is_no_log(refused, untouched):
    assert "precious.parquet" in refused("log", "metrics", untouched)
    assert "missing.parquet" in refused("log", "metrics", "missing.parquet")


def test_metrics_table_is_not_overwritten(refused, log, untouched):
    table = untouched.rename(untouched.with_suffix(".csv"))
    assert "--force" in refused("log", "metrics", log, "--out", table)
    assert table.read_text() == "precious"


def test_recover_says_what_it_saved(refused, log, tmp_path):
    """A journal as a killed run leaves it: the run is interrupted by an exception, its journal
    stays.
    """
    path = tmp_path / "run.parquet"

    def interrupt(time, _length):
        if time > 0.8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(load_scenario("turn_none", SETTINGS), path, progress=interrupt)
    assert not path.exists()
    assert str(path) in done("log", "recover", journal_path(path))
    rescued = read_run_log(path)
    assert rescued.time[-1] > 0.7
    for name in ("time_s", "position_x_truth_m", "imu_gyro_z_rad_per_s"):
        whole = read_run_log(log).signal(name)
        np.testing.assert_array_equal(rescued.signal(name), whole[: len(rescued.table)])
    assert "no.journal" in refused("log", "recover", tmp_path / "no.journal")
