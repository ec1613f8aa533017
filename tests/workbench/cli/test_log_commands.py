"""`aerodima log metrics` and `aerodima log recover`."""

from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.logs.journal import journal_path
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import scenario_from_dict
from tests.commands import done


def test_metrics_prints_and_writes_the_eight_raw_and_filtered(tailless, tmp_path):
    path = tailless.source
    table = tmp_path / "metrics.csv"
    told = done("log", "metrics", path, "--out", table)
    shown = dict(line.split() for line in told.splitlines()[1:])
    written = pd.read_csv(table, index_col="run").loc[path]
    expected = metrics_of(tailless)
    for prefix, metrics in (("", expected.raw), ("filtered_", expected.filtered)):
        for name, value in asdict(metrics).items():
            assert float(shown[prefix + name]) == pytest.approx(value, rel=1e-3)
            assert written[prefix + name] == pytest.approx(value, rel=1e-12)
    assert written["outcome"] == "survived"
    assert shown["touched"] == "none"


def test_metrics_names_the_file_that_is_no_log(refused, untouched):
    assert "precious.parquet" in refused("log", "metrics", untouched)
    assert "missing.parquet" in refused("log", "metrics", "missing.parquet")


def test_recover_says_what_it_saved(refused, tailless, tmp_path):
    """A journal as a killed run leaves it: the run is interrupted by an exception, its journal
    stays.
    """
    path = tmp_path / "run.parquet"

    def interrupt(time, _length):
        if time > 0.6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(scenario_from_dict(tailless.scenario), path, progress=interrupt)
    assert not path.exists()
    assert str(path) in done("log", "recover", journal_path(path))
    rescued = read_run_log(path)
    assert rescued.time[-1] > 0.5
    for name in ("time_s", "position_x_truth_m", "imu_gyro_z_rad_per_s"):
        whole = tailless.signal(name)
        np.testing.assert_array_equal(rescued.signal(name), whole[: len(rescued.table)])
    assert "no.journal" in refused("log", "recover", tmp_path / "no.journal")
