"""`aerodima log metrics` and `aerodima log recover`."""

import math
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.logs.journal import journal_path
from aerodima.workbench.logs.schema import read_run_log, write_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import scenario_from_dict
from aerodima.workbench.view.captions import run_caption
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


@pytest.mark.parametrize("measured", [True, False])
def test_metrics_and_comparison_name_the_stop_of_a_drive(tailless, tmp_path, measured):
    """Where the drive ended before its turn did, that is said in place of its metrics."""
    start = tailless.scenario["manoeuvre"]["turn_start"]
    kept = tailless.time < (math.inf if measured else start + 0.1)
    facts = {"stop_time_s": 2.05, "stop_reason": "the operator asked for an emergency stop"}
    table = tailless.table[kept].reset_index(drop=True)
    path = tmp_path / "stopped.parquet"
    write_run_log(replace(tailless, table=table, extra=facts), path)
    for command in (["metrics", path], ["compare", path, tailless.source]):
        told = done("log", *command)
        lines = {line.split()[0]: line for line in told.splitlines() if line}
        assert "2.05" in lines["stop_time_s"]
        assert facts["stop_reason"] in lines["stop_reason"]
        assert ("not_measured" in lines) is not measured
        assert measured == ("survived" in lines.get("outcome", "").split()[1:2])
    assert f"stopped at 2.05 s ({facts['stop_reason']})" in run_caption(read_run_log(path)).facts


def test_metrics_of_two_logs_name_the_one_without_steering(refused, tailless, tmp_path):
    path = tmp_path / "unsteered.parquet"
    table = tailless.table.drop(columns="steering_command_rad")
    extra = {"driven_by": "hand (MANUAL)"}
    write_run_log(replace(tailless, table=table, kind="car_log", extra=extra), path)
    assert "steering_command_rad" in refused("log", "metrics", path)
    told = done("log", "metrics", tailless.source, path)
    lines = {line.split()[0]: line for line in told.splitlines() if line}
    assert "steering_command_rad" in lines["not_measured"]
    assert lines["outcome"].split()[1] == "survived"


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
