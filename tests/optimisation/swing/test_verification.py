"""`aerodima swing verify`: what it measures, what it refuses, what it leaves behind."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner, Result

from aerodima.optimisation.swing.verification import Check, Verification
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.swing_file import SwingFile, read_swing, write_swing
from aerodima.workbench.resources import model_path


def thesis() -> SwingFile:
    return read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))


def call(*words: object) -> Result:
    return CliRunner().invoke(
        build_app(), ["swing", "verify", *map(str, words)], catch_exceptions=False
    )


def test_each_limit_that_is_broken_is_named_with_value_and_limit() -> None:
    good = [
        Check("tail roll", 1.5, "rad", high=1.571),
        Check("distance", 0.01, "m", low=0.0),
        Check("peak roll", math.nan, "rad"),
    ]
    bad = [
        Check("motor torque", 25.0, "N m", high=24.8),
        Check("heading", math.nan, "", low=0.95),
        Check("height", -0.1, "m", low=0.0),
    ]
    found = Verification(thesis(), "", (*good, *bad), None)  # type: ignore[arg-type]
    assert found.complaints == [
        "motor torque: 25 N m; allowed: at most 24.8",
        "heading: nan; allowed: at least 0.95",
        "height: -0.1 m; allowed: at least 0",
    ]


@pytest.mark.slow
def test_the_published_swing_is_measured_and_a_report_is_left(tmp_path: Path) -> None:
    words = ("--set", "manoeuvre.speed=3.33", "--set", "manoeuvre.duration=3", "--step", 0.002)
    result = call("thesis_8_rad_per_s", "--out", tmp_path / "a", *words)
    verdict = yaml.safe_load((tmp_path / "a" / "verification.yaml").read_text())
    assert result.exit_code == (0 if verdict["verified"] else 1)
    own = {one["name"]: one["value"] for one in verdict["checks"]}
    assert own["survives and touches nothing"] == 1.0
    assert 0.0 < own["tail roll off the knots"] < 0.6
    assert own["motor torque"] < 24.8
    assert own["tail roll"] == pytest.approx(math.pi / 2, abs=0.01)
    page = (tmp_path / "a" / "report.html").read_text()
    assert "data:image/png;base64," in page
    again = call("thesis_8_rad_per_s", "--out", tmp_path / "a", *words)
    assert (again.exit_code, "exists already" in again.stderr) == (2, True)


def test_bad_swings_are_refused_before_anything_runs(tmp_path: Path) -> None:
    data = thesis().model_dump(mode="json", by_alias=True, exclude_none=True)
    good = yaml.safe_dump(data)
    for name, change, message in (
        ("gains", lambda d: d.pop("gains"), "gains: missing"),
        (
            "time",
            lambda d: d["knots"].update(time_s=[0.0, 0.5, 0.4]),
            "allowed: strictly increasing times",
        ),
        (
            "nan",
            lambda d: d["knots"].update(roll_velocity_rad_per_s=[8.0, math.nan, 0.0]),
            "nan is not allowed",
        ),
    ):
        bad = yaml.safe_load(good)
        change(bad)
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(bad))
        result = call(path, "--out", tmp_path / "out")
        assert result.exit_code == 2, name
        assert message in result.stderr
        assert result.stderr.count("\n") == 1
    heavy = thesis().model_copy(update={"car": {"car.mass": 7.5}})
    result = call(write_swing(heavy, tmp_path / "heavy.yaml"), "--out", tmp_path / "out")
    mass = load_scenario("turn_swing").car.mass
    assert f"car.mass: made for 7.5, the scenario has {mass:g};" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_swing_that_is_never_released_is_said_to_be(tmp_path: Path) -> None:
    lazy = thesis().model_copy(
        update={"trigger": thesis().trigger.model_copy(update={"threshold_rad_per_s": 50.0})}
    )
    path = write_swing(lazy, tmp_path / "lazy.yaml")
    short = ("--set", "manoeuvre.duration=2.7", "--step", 0.002)
    result = call(path, "--out", tmp_path / "out", *short)
    assert "was never released in this turn" in result.stderr
    assert np.array(list(tmp_path.glob("out/*"))).size == 0
