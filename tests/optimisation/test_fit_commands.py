"""`aerodima fit ...` as a user calls it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

from aerodima.optimisation.identify.fit_batch import fit_logs
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.rig_scenario import load_rig_scenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.schema import write_run_log
from aerodima.workbench.stations.rig_station import simulate_static_log
from tests.optimisation.identify.line_file import fit_line_file


def run(*arguments: str | Path):
    return CliRunner().invoke(build_app(), ["fit", *map(str, arguments)])


@pytest.fixture
def springs(tmp_path: Path) -> list[Path]:
    """Front and rear suspension of Table 6.1 with 1 N of noise, and a file without forces."""
    x = np.linspace(0.0, 0.03, 31)
    rng = np.random.default_rng(1)
    paths = []
    for name, rate in (("front", 3463.30), ("rear", 3024.78)):
        paths.append(tmp_path / f"{name}.csv")
        force = rate * x + 2.0 + rng.normal(size=len(x))
        pd.DataFrame({"displacement_m": x, "force_n": force}).to_csv(paths[-1], index=False)
    paths.append(tmp_path / "bad.csv")
    paths[-1].write_text("displacement_m,weight\n0,1\n")
    return paths


def test_a_second_call_takes_up_what_is_there_and_does_the_rest(
    springs: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "fits"
    calls = []

    def work(name: str):
        calls.append(name)
        return fit_line_file(name)

    first = fit_logs(work, springs[:1], out, settings={"fit": "springs"})
    journal = out / "fits.jsonl"
    journal.write_text(journal.read_text() + '{"log": "cut o')  # an interruption within a line
    both = fit_logs(work, springs[:2], out, settings={"fit": "springs"})
    assert calls == [str(path) for path in springs[:2]]
    assert both.reused == 1
    assert both.results[0] == first.results[0]
    again = fit_logs(work, springs[:2], out, settings={"fit": "springs"})
    assert (again.reused, again.results) == (2, both.results)
    springs[0].write_text(springs[0].read_text() + "0.031,110.0\n")
    assert fit_logs(work, springs[:2], out, settings={"fit": "springs"}).reused == 1


def test_results_of_other_settings_are_not_mixed(springs: list[Path], tmp_path: Path) -> None:
    fit_logs(fit_line_file, springs[:1], tmp_path / "fits", settings={"fit": "springs"})
    with pytest.raises(FitError, match=r"other parameters, settings or versions \(settings\)"):
        fit_logs(fit_line_file, springs[:1], tmp_path / "fits", settings={"fit": "others"})
    fit_logs(fit_line_file, springs[:1], tmp_path / "fits", settings={"fit": "others"}, force=True)
    with pytest.raises(FitError, match="named twice"):
        fit_logs(fit_line_file, springs[:1] * 2, tmp_path / "twice", settings={})


@pytest.mark.slow
def test_static_logs_in_two_processes(tmp_path: Path) -> None:
    scenario = load_rig_scenario("static", ["experiment.duration=2", "experiment.wind_speed=20"])
    paths = [
        write_run_log(simulate_static_log(scenario.varied(seed=seed)), tmp_path / f"{seed}.parquet")
        for seed in (1, 2)
    ]
    (tmp_path / "cut.parquet").write_bytes(paths[0].read_bytes()[:1000])
    done = run(
        "static", *paths, tmp_path / "cut.parquet", "--out", tmp_path / "fits", "--workers", 2
    )
    assert done.exit_code == 3
    assert "cut off, damaged or not a Parquet file" in done.stderr
    assert "1 of 3 could not be fitted; the others are done" in done.stderr
    report = yaml.safe_load((tmp_path / "fits" / "fits.yaml").read_text())
    assert report["schema"] == "aerodima/fit-report/1"
    assert list(report["failed"]) == [str(tmp_path / "cut.parquet")]
    page = (tmp_path / "fits" / "report.html").read_text()
    assert "data:image/png;base64," in page
    assert not re.findall(r"(?:src|href|url|import|fetch)\W{1,4}https?:", page), (
        "nothing is loaded from elsewhere"
    )
    table = pd.read_csv(tmp_path / "fits" / "fits.csv")
    assert table.wind_speed_m_per_s.tolist() == [20.0, 20.0]
    assert table.warnings.str.contains("no rest phase").all()
    lines = (tmp_path / "fits" / "fits.jsonl").read_text().splitlines()
    assert json.loads(lines[0])["settings"]["fit"] == "Static fits"


def test_wrong_options_are_told_once_and_leave_nothing(springs: list[Path], tmp_path: Path) -> None:
    wrong = {
        (
            "friction",
            "--bound",
            "coulomb=1,0.5",
        ): "--bound coulomb=1,0.5: the lowest must be below the highest",
        (
            "friction",
            "--bound",
            "mass=0,1",
        ): "bound on 'mass': the free parameters are coulomb, viscous",
        ("added-mass", "--bound", "cd=0,1"): "bound on 'cd': the free parameters are added_mass",
        (
            "static",
            "--bound",
            "mass=0,1",
        ): "bound on 'mass': the free parameters are cd, cl, psi3, current",
        ("static", "--constants", "known"): "--constants known: allowed: uncertain, exact",
        ("static", "--loss", "bisquare"): "--loss bisquare: allowed: squares, huber",
        ("robot-tail", "--shape", "curve"): "--shape curve: allowed: constant, line, bins",
        (
            "static",
            "--free",
            "encoder_zer",
        ): "--free encoder_zer: this fit has no such constant; did you mean 'encoder_zero'?",
        ("friction", "--set", "maxon.torque=1"): "scenario: maxon.torque: unknown key; allowed: "
        "current_limit, current_noise, gear_ratio, reflected_inertia, torque_constant",
        (
            "added-mass",
            "--set",
            "experiment.tail=2",
        ): "--set experiment.tail=2: a log says itself what was tested; "
        "allowed: what describes the rig",
        ("robot-tail", "--rig", "none.yaml"): "none.yaml: no such file",
    }
    for (kind, *options), message in wrong.items():
        done = run(kind, *springs, *options, "--out", tmp_path / "none")
        assert done.exit_code == 2
        assert done.stderr.splitlines() == [f"error: {message}"]
    assert not (tmp_path / "none").exists()


def test_what_a_fit_warns_about_is_shown(tmp_path: Path) -> None:
    """A force axis that is missing, a logged current in mA, and a rest phase with the wind on."""
    scenario = load_rig_scenario("static", ["experiment.duration=2", "experiment.wind_speed=20"])
    log = simulate_static_log(scenario)
    table = log.table.drop(columns="force_y_n")
    table["current_a"] *= 1000.0
    write_run_log(
        replace(log, table=table, extra={**log.extra, "rest_s": [0.0, 0.9]}),
        tmp_path / "hold.parquet",
    )
    done = run("static", tmp_path / "hold.parquet", "--out", tmp_path / "fits", "--workers", 1)
    assert done.exit_code == 0
    warnings = [
        line.removeprefix("  warning: ")
        for line in done.stdout.splitlines()
        if line.startswith("  warning: ")
    ]
    assert "force_y_n is missing: fitted without it" in warnings
    assert any("beyond 60 A (is it in mA?): not compared" in warning for warning in warnings)
    assert any("is the wind off in it?" in warning for warning in warnings)
    assert "logged_current_a" not in pd.read_csv(tmp_path / "fits" / "fits.csv").columns
