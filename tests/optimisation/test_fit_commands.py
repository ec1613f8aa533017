"""`aerodima fit ...` as a user calls it."""

from dataclasses import replace

import pandas as pd
import pytest

from aerodima.workbench.logs.schema import write_run_log
from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.commands import done, refused
from tests.refusals import assert_named


@pytest.fixture(scope="module")
def hold():
    """Two seconds of tail 1 in 20 m/s, without rest."""
    return simulate_static_log(
        load_rig_scenario("static", ["experiment.duration=2", "experiment.wind_speed=20"])
    )


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("friction", "--bound", "coulomb=1,0.5"), ("--bound", "coulomb=1,0.5")),
        (("friction", "--bound", "mass=0,1"), ("mass", "coulomb", "viscous")),
        (("static", "--constants", "known"), ("--constants known", "uncertain", "exact")),
        (("static", "--loss", "bisquare"), ("--loss bisquare", "squares", "huber")),
        (("robot-tail", "--shape", "curve"), ("--shape curve", "constant", "line", "bins")),
        (("static", "--free", "encoder_zer"), ("--free encoder_zer", "'encoder_zero'")),
        (("friction", "--set", "maxon.torque=1"), ("maxon.torque", "torque_constant")),
        (("added-mass", "--set", "experiment.tail=2"), ("--set experiment.tail=2",)),
        (("robot-tail", "--rig", "none.yaml"), ("none.yaml",)),
    ],
)
def test_wrong_options_are_told_once_and_leave_nothing(tmp_path, words, named):
    kind, *options = words
    (tmp_path / "log.csv").touch()
    command = ("fit", kind, tmp_path / "log.csv", *options, "--out", tmp_path / "none")
    assert_named(refused(*command), named)
    assert not (tmp_path / "none").exists()


def test_a_fit_with_what_a_rig_file_said_before_is_not_taken_up(hold, tmp_path):
    path = write_run_log(hold, tmp_path / "hold.parquet")
    rig = tmp_path / "rig.yaml"
    command = ("fit", "static", path, "--rig", rig, "--out", tmp_path / "fits", "--workers", 1)
    rig.write_text("maxon: {torque_constant: 0.40}\n")
    done(*command)
    assert "1 of 1 were fitted before" in done(*command)
    rig.write_text("maxon: {torque_constant: 0.41}\n")
    assert_named(refused(*command), ("settings",))


def test_what_a_fit_warns_about_is_shown(hold, tmp_path):
    """A force axis that is missing, a logged current in mA, and a rest phase with the wind on."""
    table = hold.table.drop(columns="force_y_n").assign(current_a=1000.0 * hold.table.current_a)
    log = replace(hold, table=table, extra={**hold.extra, "rest_s": [0.0, 0.9]})
    path = write_run_log(log, tmp_path / "hold.parquet")
    told = done("fit", "static", path, "--out", tmp_path / "fits", "--workers", 1)
    lines = [line for line in told.splitlines() if line.startswith("  warning: ")]
    assert_named(" ".join(lines), ("force_y_n", "60 A", "20 m/s"))
    assert "logged_current_a" not in pd.read_csv(tmp_path / "fits" / "fits.csv").columns
