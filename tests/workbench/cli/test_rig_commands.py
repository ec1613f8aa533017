"""`aerodima rig`: what it prints, writes and refuses."""

import math

import pytest

from aerodima.workbench.logs.schema import read_run_log
from tests.commands import done


def test_static_hold_writes_its_log(tmp_path):
    out = tmp_path / "new folder" / "hold.parquet"
    words = "rig static --tail 2 --axis minor --wind 20 --angle 15 --seed 7 --duration 0.5"
    told = done(*words.split(), "--out", out)
    shown = dict(line.split()[:2] for line in told.splitlines() if line)
    facts = ("tail", "axis", "wind_speed_m_per_s")
    assert [shown[name] for name in facts] == ["2", "minor", "20"]
    assert float(shown["angle_rad"]) == pytest.approx(math.radians(15.0), abs=1e-3)
    log = read_run_log(out)
    assert log.kind == "static"
    assert log.seed == 7
    assert [log.extra[name] for name in facts] == ["2", "minor", 20.0]
    assert log.scenario["experiment"]["angle"] == pytest.approx(math.radians(15.0))
    assert len(log.table) == 501


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--wind", -10), "experiment.wind_speed: -10.0"),
        (("--set", "maxon.torque_const=1"), "'torque_constant'"),
    ],
)
def test_wrong_input_is_one_line(refused, tmp_path, flags, message):
    assert message in refused("rig", "static", *flags, "--out", tmp_path / "hold.parquet")
    assert not (tmp_path / "hold.parquet").exists()
