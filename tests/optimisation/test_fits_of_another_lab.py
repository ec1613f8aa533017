"""`aerodima fit` on the logs of a laboratory that is not ours (`other_lab`: formulae of its own,
truth in the file).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.signal import butter, sosfiltfilt
from typer.testing import CliRunner

from aerodima.optimisation.identify.log_rig import FitOptions
from aerodima.optimisation.identify.static_fit import fit_static
from aerodima.optimisation.identify.static_log import static_data
from aerodima.optimisation.identify.swing_coefficients import (
    added_mass_parameter,
    fit_friction,
    still_tail_law,
)
from aerodima.optimisation.identify.swing_fit import SwingModel
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.optimisation.identify.uncertainty import chance_of, check_residual
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.rig_scenario import load_rig_scenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.importers import import_log
from aerodima.workbench.logs.mapping import mapping_from
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.stations.rig_station import simulate_static_log
from tests.optimisation.coverage_study import study
from tests.optimisation.identify import other_lab as lab

CONSTANT_AIR = ("aero.source=constant", "aero.drag=0.9", "aero.lift=0.25")


def run(*arguments: str | Path):
    return CliRunner().invoke(build_app(), ["fit", *map(str, arguments)])


def grid(folder: Path, **options) -> dict[tuple[float, float], Path]:
    """A hold at each of two speeds and two angles."""
    paths = {}
    for number, (wind, degrees) in enumerate(
        [(10.0, 15.0), (20.0, 15.0), (10.0, 30.0), (20.0, 30.0)]
    ):
        log = lab.hold(wind=wind, angle=math.radians(degrees), seed=number, **options)
        paths[wind, degrees] = lab.write(log, folder, f"hold_{wind:g}_{degrees:g}")
    return paths


@pytest.mark.slow
def test_a_log_with_a_nan_costs_itself_and_the_table_but_nothing_else(tmp_path: Path) -> None:
    paths = grid(tmp_path)
    log = lab.hold(wind=20.0, angle=math.radians(30.0))
    torque = log.signal("torque_x_n_m").copy()
    torque[1000] = math.nan
    lab.write(replace(log, table=log.table.assign(torque_x_n_m=torque)), tmp_path, "broken")
    done = run(
        "static", *list(paths.values())[:3], tmp_path / "broken.parquet", "--out", tmp_path / "fits"
    )
    assert done.exit_code == 3
    assert (
        "broken.parquet: column 'torque_x_n_m': 1 sample(s) not finite, first nan at 2 s"
        in done.stderr
    )
    assert (
        "cheetah_tail_1_major.yaml is left out: its grid of speed and angle lacks 20 m/s at 30 "
        "degrees" in done.stderr
    )
    assert "1 of 4 could not be fitted; the others are done" in done.stderr
    table = pd.read_csv(tmp_path / "fits" / "fits.csv")
    assert table.cd.tolist() == pytest.approx([0.9] * 3, abs=0.02)
    report = yaml.safe_load((tmp_path / "fits" / "fits.yaml").read_text())
    assert list(report["failed"]) == [str(tmp_path / "broken.parquet")]
    assert len(report["tables"]["averages"]) == 12
    assert "is left out" in (tmp_path / "fits" / "report.html").read_text()
    assert not (tmp_path / "fits" / "cheetah_tail_1_major.yaml").exists()


@pytest.mark.slow
def test_a_full_grid_is_written_and_leaves_nothing_out(tmp_path: Path) -> None:
    done = run("static", *grid(tmp_path).values(), "--out", tmp_path / "fits")
    assert done.exit_code == 0, done.stderr
    assert (tmp_path / "fits" / "cheetah_tail_1_major.yaml").is_file()


@pytest.mark.slow
def test_two_holds_that_hardly_differ_are_averaged(tmp_path: Path) -> None:
    log = lab.hold()
    nearly = replace(
        log, table=log.table.assign(force_y_n=np.nextafter(log.signal("force_y_n"), np.inf))
    )
    paths = [lab.write(log, tmp_path, "one"), lab.write(nearly, tmp_path, "other")]
    done = run("static", *paths, "--out", tmp_path / "fits")
    assert done.exit_code == 0, done.stderr
    averages = pd.read_csv(tmp_path / "fits" / "averages.csv").set_index("parameter")
    assert averages.loc["cd", "huber"] == pytest.approx(averages.loc["cd", "median"], rel=1e-9)


def test_another_motor_is_warned_about_and_can_be_told(tmp_path: Path) -> None:
    path = lab.write(lab.hold(replace(lab.LAB, torque_constant=0.40)), tmp_path, "hold")
    plain = run("static", path, "--out", tmp_path / "plain")
    assert plain.exit_code == 0
    assert "is maxon.torque_constant 0.346 N m/A that of this rig (--set)?" in plain.stdout
    told = run("static", path, "--out", tmp_path / "told", "--set", "maxon.torque_constant=0.40")
    assert "warning" not in told.stdout
    row = pd.read_csv(tmp_path / "told" / "fits.csv").iloc[0]
    assert row.current_a == pytest.approx(row.logged_current_a, abs=0.01)
    report = yaml.safe_load((tmp_path / "told" / "fits.yaml").read_text())
    assert report["fits"][0]["rig"] == {"maxon.torque_constant": 0.4}
    wrong = run("static", path, "--out", tmp_path / "wrong", "--set", "maxon.torque=0.40")
    assert wrong.exit_code == 2
    assert "maxon.torque: unknown key" in wrong.stderr


def test_a_rig_scenario_is_taken_from_a_file_and_from_a_mapping(tmp_path: Path) -> None:
    heavy = replace(lab.LAB, bar_mass=0.35)
    log = lab.bar_swing(heavy, duration=3.0)
    (tmp_path / "rig.yaml").write_text("schema: aerodima/rig-scenario/1\nbar: {mass: 0.35}\n")
    path = lab.write(log, tmp_path, "swing")
    assert (
        run("friction", path, "--out", tmp_path / "fits", "--rig", tmp_path / "rig.yaml").exit_code
        == 0
    )
    assert pd.read_csv(tmp_path / "fits" / "fits.csv").coulomb_n_m[0] == pytest.approx(
        0.0435, rel=1e-3
    )
    log.table.to_csv(tmp_path / "foreign.csv", index=False)
    mapping = {
        "schema": "aerodima/log-mapping/1",
        "kind": "bar_swing",
        "time": {"from": "time_s"},
        "columns": {"angle_rad": {"from": "angle_rad"}},
        "metadata": {"rest_s": [-1.0, 0.0]},
        "scenario": {"base": "bar", "set": ["bar.mass=0.35"]},
    }
    imported = import_log([tmp_path / "foreign.csv"], mapping_from(mapping)).run_log
    result = fit_friction(swing_data(imported, "bar_swing"))
    assert result["viscous"].value == pytest.approx(0.0364, rel=1e-3)
    assert result.rig == {"bar.mass": 0.35}


@pytest.mark.slow
@pytest.mark.parametrize("stated", ["tare", "sheet", "scenario"])
def test_an_offset_and_its_uncertainty_are_taken_as_stated(stated: str) -> None:
    """Of a sensor with offsets: zeroed without wind just before, known from a sheet, or better than
    Table 4.8.
    """
    angle = math.radians(20.0)
    bias = np.array([0.3, -0.2, 0.5, 0.02, 0.01, -0.03])
    rig = replace(lab.LAB, force_bias=bias)
    facts: dict = {"offsets_to_add": (-bias).tolist()}
    settings: tuple[str, ...] = ()
    if stated == "tare":
        # What the sensor shows without wind is taken away from its readings.
        rig = replace(rig, force_bias=-lab.weight(lab.LAB, angle)[0])
        facts = {"tared_angle_rad": angle}
    elif stated == "sheet":
        facts["offsets_uncertainty"] = [0.01, 0.01, 0.01, 0.001, 0.001, 0.001]
    else:
        settings = tuple(
            f"force_sensor.{axis}_accuracy=0.005" for axis in ("fx", "fy", "fz", "tx", "ty", "tz")
        )
    log = lab.hold(rig, angle=angle, rest=0.0, **facts)
    found = fit_static(static_data(log, options=FitOptions(settings=settings)))
    for name, value in log.extra["truth"].items():
        assert abs(found[name].value - value) < 4.0 * found[name].standard_deviation, name
        assert found[name].standard_deviation < 0.1
    plain = fit_static(
        static_data(
            replace(log, extra={**log.extra, "offsets_uncertainty": None, "tared_angle_rad": None})
        )
    )
    assert plain["cl"].standard_deviation > 10.0 * found["cl"].standard_deviation


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1000.0, 100.0])
@pytest.mark.parametrize("convention", ["instantaneous", "mean"])
def test_what_a_sample_of_the_current_is_belongs_to_the_log(rate: float, convention: str) -> None:
    rig = replace(lab.LAB, current_noise=1e-5)
    log = lab.flick(rig, rate=rate, convention=convention, added_mass=0.05, seed=3)
    constant = FitOptions(settings=CONSTANT_AIR)
    found = {}
    for sampling in ("instantaneous", "mean"):
        stated = replace(log, extra={**log.extra, "current_sampling": sampling})
        data = replace(swing_data(stated, "swing", options=constant), constants=())
        found[sampling] = SwingModel(data, still_tail_law).fit([added_mass_parameter(data)])
    # What is left at 100 Hz is the step of the rollout; a convention taken for the other is off by
    # half a sample.
    right = found[convention]
    wrong = found["mean" if convention == "instantaneous" else "instantaneous"]
    assert right["added_mass"].value == pytest.approx(0.05, rel=2e-4 if rate > 500.0 else 1e-3)
    assert right["added_mass"].identifiable
    assert right["start_angle"].value == pytest.approx(math.radians(60.0), abs=2e-5)
    assert abs(wrong["start_angle"].value - math.radians(60.0)) > 1e-4 * 1000.0 / rate / 2.0
    if convention == "instantaneous":  # of a foreign log this is the default
        data = replace(swing_data(log, "swing", options=constant), constants=())
        assert (
            SwingModel(data, still_tail_law).fit([added_mass_parameter(data)])["added_mass"]
            == right["added_mass"]
        )
    with pytest.raises(
        FitError, match="'current_sampling' is 'often'; allowed: mean, instantaneous"
    ):
        swing_data(replace(log, extra={**log.extra, "current_sampling": "often"}), "swing")


@pytest.mark.slow
def test_an_added_mass_far_from_every_seed_is_found(tmp_path: Path) -> None:
    """Without the scan this one ends at 0.02 kg: the phase slips by a period."""
    path = lab.write(
        lab.flick(added_mass=0.2, angle=0.5 * math.pi, duration=3.0, seed=2), tmp_path, "flick"
    )
    air = [word for setting in CONSTANT_AIR for word in ("--set", setting)]
    done = run("added-mass", path, "--out", tmp_path / "fits", *air)
    assert done.exit_code == 0, done.stderr
    fits = yaml.safe_load((tmp_path / "fits" / "fits.yaml").read_text())["fits"]
    assert fits[0]["estimates"][0]["value"] == pytest.approx(0.2, rel=2e-3)
    starts = [attempt["start"]["added_mass"] for attempt in fits[0]["attempts"]]
    assert starts[0] == 0.0
    assert starts[-1] > 0.1


def static_scores(log: RunLog, exact: bool = True, **options) -> dict[str, float]:
    """How many standard deviations each coefficient is off; without the uncertainty of constants by
    default.
    """
    data = static_data(log, options=FitOptions(**options))
    found = fit_static(replace(data, constants=()) if exact else data)
    truth = log.extra["truth"]
    return {
        name: (found[name].value - truth[name]) / found[name].standard_deviation
        for name in ("cd", "cl", "psi3")
    }


def test_a_burst_in_the_rest_is_told_and_a_robust_loss_holds_it_back(tmp_path: Path) -> None:
    def burst(time: np.ndarray) -> np.ndarray:
        return np.where((time > 1.0) & (time <= 1.1), 2.0, 0.0)

    log = lab.hold(wander=burst)
    path = lab.write(log, tmp_path, "hold")
    done = run("static", path, "--out", tmp_path / "plain")
    assert "50 samples lie more than 6 standard deviations off, the first at 1.002 s" in done.stdout
    robust = static_scores(log, loss="huber")
    assert max(map(abs, robust.values())) < 3.5
    done = run("static", path, "--out", tmp_path / "robust", "--loss", "huber")
    assert pd.read_csv(tmp_path / "robust" / "fits.csv").cd[0] == pytest.approx(0.9, abs=2e-3)


def test_a_drift_that_dies_out_is_told(tmp_path: Path) -> None:
    """One percent of the sensor's accuracy, that dies out within a second and a half."""
    log = lab.hold(wander=lambda time: 0.01 * np.exp(-time / 1.5), seed=4)
    path = lab.write(log, tmp_path, "hold")
    done = run("static", path, "--out", tmp_path / "plain")
    assert "wander about the fitted drift" in done.stdout
    assert max(map(abs, static_scores(log).values())) > 3.5


def test_a_rest_in_which_the_wind_blew_is_told_although_the_sensor_drifts(tmp_path: Path) -> None:
    log = lab.hold(rest=0.0, wander=lambda time: 2e-3 * np.exp(-time / 3.0), wind=20.0)
    log = replace(log, extra={**log.extra, "rest_s": [0.0, 2.0]})
    done = run("static", lab.write(log, tmp_path, "hold"), "--out", tmp_path / "fits")
    assert "is the wind off in it?" in done.stdout
    well = run(
        "static", lab.write(lab.hold(wind=10.0), tmp_path, "well"), "--out", tmp_path / "well"
    )
    assert "warning" not in well.stdout


@pytest.mark.parametrize("noise", ["white", "filtered"])
def test_honest_noise_passes_the_residual_check(noise: str) -> None:
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(300):
        residual = rng.normal(size=(2, 4000))
        if noise == "filtered":  # 10 Hz, forwards and back, at 500 Hz
            residual = sosfiltfilt(butter(3, 10.0, fs=500.0, output="sos"), residual)[:, 200:-200]
        checks = [check_residual(row - row.mean()) for row in residual]
        alarms += chance_of(checks) < 1e-3 or max(check.far_off for check in checks) > 0
    # At a chance of a thousandth one alarm in 300 is usual, four are one in 300 such tests.
    assert alarms <= 3
    slow = 0.2 * np.sin(np.linspace(0.0, 20.0, 4000))
    assert chance_of([check_residual(rng.normal(size=4000) + slow)]) < 1e-5


def test_a_wrong_constant_is_in_the_interval_and_the_budget(tmp_path: Path) -> None:
    """The centre of mass of the bar 1 mm off, the sensor's measuring point 2 mm: twice what is said
    of them.
    """
    swing = lab.write(lab.bar_swing(replace(lab.LAB, bar_com=0.101)), tmp_path, "swing")
    assert run("friction", swing, "--out", tmp_path / "friction").exit_code == 0
    row = pd.read_csv(tmp_path / "friction" / "fits.csv").iloc[0]
    assert abs(row.coulomb_n_m - 0.0435) < 3.0 * row.coulomb_std_n_m
    assert row.coulomb_std_n_m < 0.01 * 0.0435
    budget = pd.read_csv(tmp_path / "friction" / "budget.csv").set_index("parameter")
    assert budget.loc["coulomb"].drop("fit").astype(float).idxmax() == "bar_com"
    assert "What the intervals are made of" in (tmp_path / "friction" / "report.html").read_text()
    x, y, z = lab.LAB.pivot
    hold = lab.hold(replace(lab.LAB, pivot=(x, y, z + 0.002)))
    assert max(map(abs, static_scores(hold, exact=False).values())) < 3.0
    known = ("uncertainty.wind_speed=0", "uncertainty.air_density=0", "uncertainty.pivot_z=0")
    narrow = fit_static(static_data(hold, options=FitOptions(settings=known)))
    assert "pivot_z" not in narrow.budget["cd"]
    wide = fit_static(static_data(hold))
    assert narrow["cd"].standard_deviation < 0.6 * wide["cd"].standard_deviation
    assert sum(wide.budget["cd"].values()) == pytest.approx(1.0, abs=0.02)
    exact = fit_static(static_data(hold, options=FitOptions(constants="exact")))
    zero = tuple(
        f"uncertainty.{name}=0" for name in load_rig_scenario("static").uncertainty.model_dump()
    )
    same = fit_static(static_data(hold, options=FitOptions(settings=zero)))
    assert exact.estimates == same.estimates
    assert not exact.budget
    for name in ("cd", "cl", "psi3"):
        # Noise alone is what the same log gives on a rig that is known exactly, but for where the
        # fit stands.
        assert wide[name].noise_deviation == pytest.approx(exact[name].standard_deviation, rel=0.05)
        assert wide[name].noise_deviation < wide[name].standard_deviation
        assert exact[name].noise_deviation == exact[name].standard_deviation


@pytest.mark.slow
def test_an_encoder_zero_half_a_degree_off_is_named_and_can_be_freed(tmp_path: Path) -> None:
    zero = math.radians(0.5)
    path = lab.write(lab.bar_swing(replace(lab.LAB, encoder_zero=zero)), tmp_path, "swing")
    plain = run("friction", path, "--out", tmp_path / "plain")
    assert "the data want encoder_zero shifted by 0.0087" in plain.stdout
    freed = run("friction", path, "--out", tmp_path / "freed", "--free", "encoder_zero")
    assert "warning" not in freed.stdout
    row = pd.read_csv(tmp_path / "freed" / "fits.csv").iloc[0]
    assert row.encoder_zero_rad == pytest.approx(zero, abs=1e-5)
    assert row.coulomb_n_m == pytest.approx(0.0435, rel=2e-3)
    wrong = run("friction", path, "--out", tmp_path / "wrong", "--free", "encoder_zer")
    assert (
        "--free encoder_zer: this fit has no such constant; did you mean 'encoder_zero'?"
        in wrong.stderr
    )


@pytest.mark.slow
def test_a_late_current_is_found_when_its_delay_is_free() -> None:
    rig = replace(lab.LAB, current_delay=0.004)
    log = lab.flick(rig, added_mass=0.05, seed=5)
    options = FitOptions(
        settings=(*CONSTANT_AIR, "uncertainty.encoder_zero=0"), free=("current_delay",)
    )
    data = swing_data(log, "swing", options=options)
    found = SwingModel(data, still_tail_law).fit([added_mass_parameter(data)], options=options)
    assert (
        abs(found["current_delay"].value - 0.004) < 3.0 * found["current_delay"].standard_deviation
    )
    assert found["current_delay"].standard_deviation < 0.002
    assert abs(found["added_mass"].value - 0.05) < 3.0 * found["added_mass"].standard_deviation


def test_the_constants_of_a_simulated_log_are_exact() -> None:
    log = simulate_static_log(
        load_rig_scenario("static", ["experiment.duration=2", "experiment.wind_speed=20"])
    )
    assert not static_data(log).constants
    stated = static_data(log, options=FitOptions(settings=("uncertainty.pivot_z=0.001",))).constants
    assert [constant.name for constant in stated if not constant.name.endswith("_bias")] == [
        "pivot_z"
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "logs", "least", "most"),
    [("static", 60, 0.65, 1.4), ("friction", 20, 0.65, 1.4), ("added_mass", 6, 0.5, 1.6)],
)
def test_intervals_hold_the_truth_when_the_constants_are_off(
    kind: str, logs: int, least: float, most: float, tmp_path: Path
) -> None:
    """A part of `coverage_study`: constants drawn from the priors, fits at their defaults."""
    table = study(kind, logs, tmp_path)
    # Of 60, 20 and 6 scores the deviation is known to 9, 16 and 29 %; the draws are the same in
    # every run, so intervals half or twice as wide give twice or half of what stands.
    assert table.score_deviation.between(least, most).all(), table
    assert (table.determined >= 0.9 * logs).all(), table
    assert (table.percent >= 83.0).all(), table
