"""`aerodima fit` on the logs of a laboratory that is not ours (`other_lab`: formulae of its own,
truth in the file).
"""

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.signal import butter, sosfiltfilt

from aerodima.optimisation.identify.fit_options import FitOptions
from aerodima.optimisation.identify.residual_check import chance_of, check_residual
from aerodima.optimisation.identify.static_fit import fit_static
from aerodima.optimisation.identify.static_log import REACTIONS, static_data
from aerodima.optimisation.identify.swing_coefficients import (
    added_mass_parameter,
    fit_friction,
    still_tail_law,
)
from aerodima.optimisation.identify.swing_fit import SwingModel
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.logs.importers import import_log
from aerodima.workbench.logs.mapping import mapping_from
from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.commands import call, done
from tests.optimisation import coverage_study
from tests.optimisation.coverage import assert_held, assert_standard, draws
from tests.optimisation.identify import other_lab as lab
from tests.optimisation.identify.swing_truth import added_mass_of
from tests.refusals import assert_named
from tests.workbench.made_up_runs import stating


@pytest.mark.slow
@pytest.mark.parametrize("broken", [False, True])
def test_a_log_with_a_nan_costs_itself_and_the_table_but_nothing_else(tmp_path, broken):
    """A hold at each of two speeds and two angles."""
    cases = [(10.0, 15.0), (20.0, 15.0), (10.0, 30.0), (20.0, 30.0)]
    logs = [
        lab.hold(wind=wind, angle=math.radians(degrees), duration=5.0, seed=number)
        for number, (wind, degrees) in enumerate(cases)
    ]
    if broken:
        logs[3].table.loc[1000, "torque_x_n_m"] = math.nan
    paths = [lab.write(log, tmp_path, f"hold_{number}") for number, log in enumerate(logs)]
    out = tmp_path / "fits"
    result = call("fit", "static", *paths, "--out", out)
    assert result.exit_code == (3 if broken else 0), result.stderr
    assert (out / "cheetah_tail_1_major.yaml").is_file() != broken
    table = pd.read_csv(out / "fits.csv")
    assert table.wind_speed_m_per_s.tolist() == [wind for wind, _ in cases][: 4 - broken]
    assert table.cd.tolist() == pytest.approx([0.9] * (4 - broken), abs=0.02)
    report = yaml.safe_load((out / "fits.yaml").read_text())
    assert report["schema"] == "aerodima/fit-report/1"
    assert list(report["failed"]) == [str(path) for path in paths[3:] if broken]
    page = (out / "report.html").read_text()
    assert not re.findall(r"(?:src|href|url|import|fetch)\W{1,4}https?:", page)
    if broken:
        named = ("hold_3.parquet", "torque_x_n_m", "2 s", "cheetah_tail_1_major.yaml", "20 m/s")
        assert_named(result.stderr, named)


def test_another_motor_is_warned_about_and_can_be_told(tmp_path):
    path = lab.write(lab.hold(replace(lab.LAB, torque_constant=0.40)), tmp_path, "hold")
    plain = done("fit", "static", path, "--out", tmp_path / "plain")
    assert "maxon.torque_constant 0.346" in plain
    rig = tmp_path / "rig.yaml"
    rig.write_text("schema: aerodima/rig-scenario/1\nmaxon: {torque_constant: 0.4}\n")
    for flag, words in (("--set", "maxon.torque_constant=0.40"), ("--rig", rig)):
        out = tmp_path / flag
        assert "warning" not in done("fit", "static", path, "--out", out, flag, words)
        row = pd.read_csv(out / "fits.csv").iloc[0]
        assert row.current_a == pytest.approx(row.logged_current_a, abs=0.01)
        report = yaml.safe_load((out / "fits.yaml").read_text())
        assert report["fits"][0]["rig"] == {"maxon.torque_constant": 0.4}


def test_a_rig_scenario_is_taken_from_a_mapping(tmp_path):
    log = lab.bar_swing(replace(lab.LAB, bar_mass=0.35), duration=3.0)
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


SHEET = [0.01, 0.01, 0.01, 0.001, 0.001, 0.001]
"""What a sheet says of the offsets: standard deviations, N and N m."""


@pytest.mark.slow
@pytest.mark.parametrize("stated", ["tare", "sheet", "scenario"])
def test_an_offset_and_its_uncertainty_are_taken_as_stated(stated):
    """Of a sensor with offsets: zeroed without wind just before, known from a sheet, or better than
    Table 4.8.
    """
    angle = math.radians(20.0)
    bias = np.array([0.3, -0.2, 0.5, 0.02, 0.01, -0.03])
    facts = {"offsets_to_add": (-bias).tolist()}
    settings = ()
    if stated == "tare":
        # What the sensor shows without wind is taken away from its readings.
        bias = -lab.weight(lab.LAB, angle)[0]
        facts = {"tared_angle_rad": angle}
    elif stated == "sheet":
        facts["offsets_uncertainty"] = SHEET
    else:
        settings = tuple(f"force_sensor.{axis}_accuracy=0.005" for axis in REACTIONS)
    log = lab.hold(replace(lab.LAB, force_bias=bias), angle=angle, rest=0.0, **facts)
    found = fit_static(static_data(log, options=FitOptions(settings=settings)))
    for name, value in log.extra["truth"].items():
        assert abs(found[name].value - value) < 4.0 * found[name].standard_deviation, name
        assert found[name].standard_deviation < 0.1
    silent = stating(offsets_uncertainty=None, tared_angle_rad=None)(log)
    plain = fit_static(static_data(silent))
    assert plain["cl"].standard_deviation > 10.0 * found["cl"].standard_deviation


@pytest.mark.slow
@pytest.mark.parametrize(
    ("convention", "rate"), [("instantaneous", 1000.0), ("instantaneous", 100.0), ("mean", 100.0)]
)
def test_what_a_sample_of_the_current_is_belongs_to_the_log(rate, convention):
    rig = replace(lab.LAB, current_noise=1e-5)
    log = lab.flick(rig, rate=rate, convention=convention, added_mass=0.05, seed=3)
    constant = FitOptions(settings=coverage_study.AIR)
    found = {
        sampling: added_mass_of(stating(current_sampling=sampling)(log), constant)
        for sampling in ("instantaneous", "mean")
    }
    # What is left at 100 Hz is the step of the rollout; a convention taken for the other is off by
    # half a sample.
    right = found.pop(convention)
    (wrong,) = found.values()
    assert right["added_mass"].value == pytest.approx(0.05, rel=2e-4 if rate > 500.0 else 1e-3)
    assert right["added_mass"].identifiable
    assert right["start_angle"].value == pytest.approx(math.radians(60.0), abs=2e-5)
    assert abs(wrong["start_angle"].value - math.radians(60.0)) > 1e-4 * 1000.0 / rate / 2.0
    if convention == "instantaneous":  # of a foreign log this is the default
        assert added_mass_of(log, constant)["added_mass"] == right["added_mass"]


@pytest.mark.slow
def test_an_added_mass_far_from_every_seed_is_found(tmp_path):
    """Without the scan this one ends at 0.02 kg: the phase slips by a period."""
    log = lab.flick(added_mass=0.2, angle=0.5 * math.pi, duration=3.0, seed=2)
    path = lab.write(log, tmp_path, "flick")
    air = [word for setting in coverage_study.AIR for word in ("--set", setting)]
    done("fit", "added-mass", path, "--out", tmp_path / "fits", *air)
    (fit,) = yaml.safe_load((tmp_path / "fits" / "fits.yaml").read_text())["fits"]
    assert fit["estimates"][0]["value"] == pytest.approx(0.2, rel=2e-3)
    first, *_, last = (attempt["start"]["added_mass"] for attempt in fit["attempts"])
    assert first == 0.0
    assert last > 0.1


def static_scores(log, exact=True, **options):
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


def fitted(log, folder, *options):
    """What the command says of a hold."""
    path = lab.write(log, folder, "hold")
    return done("fit", "static", path, "--out", folder / "fits", *options)


@pytest.mark.slow
def test_a_burst_in_the_rest_is_told_and_a_robust_loss_holds_it_back(tmp_path):
    log = lab.hold(wander=lambda time: np.where((time > 1.0) & (time <= 1.1), 2.0, 0.0))
    told = fitted(log, tmp_path)
    assert_named(told, ("50", "1.002 s"))
    assert max(map(abs, static_scores(log, loss="huber").values())) < 3.5
    fitted(log, tmp_path / "robust", "--loss", "huber")
    assert pd.read_csv(tmp_path / "robust" / "fits" / "fits.csv").cd[0] == pytest.approx(
        0.9, abs=2e-3
    )


def test_a_drift_that_dies_out_is_told(tmp_path):
    """One percent of the sensor's accuracy, that dies out within a second and a half."""
    log = lab.hold(wander=lambda time: 0.01 * np.exp(-time / 1.5), seed=4)
    assert "warning" in fitted(log, tmp_path)
    assert max(map(abs, static_scores(log).values())) > 3.5


@pytest.mark.parametrize("windy", [True, False])
def test_a_rest_in_which_the_wind_blew_is_told_although_the_sensor_drifts(tmp_path, windy):
    log = lab.hold(rest=0.0, wander=lambda time: 2e-3 * np.exp(-time / 3.0), rest_s=[0.0, 2.0])
    told = fitted(log if windy else lab.hold(wind=10.0), tmp_path)
    assert ("warning" in told) == ("20 m/s" in told) == windy


@pytest.mark.parametrize("noise", ["white", "filtered"])
def test_honest_noise_passes_the_residual_check(noise):
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(100):
        residual = rng.normal(size=(2, 4000))
        if noise == "filtered":  # 10 Hz, forwards and back, at 500 Hz
            residual = sosfiltfilt(butter(3, 10.0, fs=500.0, output="sos"), residual)[:, 200:-200]
        checks = [check_residual(row - row.mean()) for row in residual]
        alarms += chance_of(checks) < 1e-3 or max(check.far_off for check in checks) > 0
    # At a chance of a thousandth three alarms in 100 are one in 6000 such tests.
    assert alarms <= 2
    slow = 0.2 * np.sin(np.linspace(0.0, 20.0, 4000))
    assert chance_of([check_residual(rng.normal(size=4000) + slow)]) < 1e-5


@pytest.mark.slow
def test_a_wrong_constant_of_a_swing_is_in_the_interval_and_leads_the_budget():
    """The centre of mass of the bar 1 mm off: twice what is said of it."""
    result = fit_friction(swing_data(lab.bar_swing(replace(lab.LAB, bar_com=0.101)), "bar_swing"))
    coulomb = result["coulomb"]
    assert abs(coulomb.value - 0.0435) < 3.0 * coulomb.standard_deviation
    assert coulomb.standard_deviation < 0.01 * 0.0435
    budget = result.budget["coulomb"]
    assert max(budget, key=lambda name: budget[name]) == "bar_com"


@pytest.fixture(scope="module")
def off_pivot():
    """The sensor's measuring point 2 mm off: twice what is said of it."""
    x, y, z = lab.LAB.pivot
    return lab.hold(replace(lab.LAB, pivot=(x, y, z + 0.002)))


@pytest.mark.slow
def test_a_wrong_constant_of_a_hold_is_in_the_interval_and_its_share_in_the_budget(
    off_pivot,
):
    assert max(map(abs, static_scores(off_pivot, exact=False).values())) < 3.0
    known = ("uncertainty.wind_speed=0", "uncertainty.air_density=0", "uncertainty.pivot_z=0")
    narrow = fit_static(static_data(off_pivot, options=FitOptions(settings=known)))
    wide = fit_static(static_data(off_pivot))
    assert "pivot_z" not in narrow.budget["cd"]
    assert narrow["cd"].standard_deviation < 0.6 * wide["cd"].standard_deviation
    assert sum(wide.budget["cd"].values()) == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_exact_constants_leave_the_noise_alone(off_pivot):
    wide = fit_static(static_data(off_pivot))
    exact = fit_static(static_data(off_pivot, options=FitOptions(constants="exact")))
    names = load_rig_scenario("static").uncertainty.model_dump()
    zero = FitOptions(settings=tuple(f"uncertainty.{name}=0" for name in names))
    assert exact.estimates == fit_static(static_data(off_pivot, options=zero)).estimates
    assert not exact.budget
    for name in ("cd", "cl", "psi3"):
        noise = exact[name].standard_deviation
        assert wide[name].noise_deviation == pytest.approx(noise, rel=0.05)
        assert wide[name].noise_deviation < wide[name].standard_deviation
        assert exact[name].noise_deviation == noise


@pytest.mark.slow
def test_an_encoder_zero_half_a_degree_off_is_named_and_can_be_freed(tmp_path):
    zero = math.radians(0.5)
    path = lab.write(lab.bar_swing(replace(lab.LAB, encoder_zero=zero)), tmp_path, "swing")
    plain = done("fit", "friction", path, "--out", tmp_path / "plain")
    assert_named(plain, ("encoder_zero", "0.0087"))
    words = ("--out", tmp_path / "freed", "--free", "encoder_zero")
    assert "warning" not in done("fit", "friction", path, *words)
    row = pd.read_csv(tmp_path / "freed" / "fits.csv").iloc[0]
    assert row.encoder_zero_rad == pytest.approx(zero, abs=1e-5)
    assert row.coulomb_n_m == pytest.approx(0.0435, rel=2e-3)


@pytest.mark.slow
def test_a_late_current_is_found_when_its_delay_is_free():
    rig = replace(lab.LAB, current_delay=0.004)
    log = lab.flick(rig, added_mass=0.05, seed=5)
    options = FitOptions(
        settings=(*coverage_study.AIR, "uncertainty.encoder_zero=0"), free=("current_delay",)
    )
    data = swing_data(log, "swing", options=options)
    found = SwingModel(data, still_tail_law).fit([added_mass_parameter(data)], options=options)
    for name, truth in (("current_delay", 0.004), ("added_mass", 0.05)):
        assert abs(found[name].value - truth) < 3.0 * found[name].standard_deviation
    assert found["current_delay"].standard_deviation < 0.002


def test_the_constants_of_a_simulated_log_are_exact():
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
    ("draw", "number"),
    [
        (coverage_study.static, 30),
        (coverage_study.friction, 10),
        (coverage_study.exact(coverage_study.static), 30),
        (coverage_study.exact(coverage_study.friction), 24),
        pytest.param(coverage_study.static, 200, marks=pytest.mark.nightly),
        pytest.param(coverage_study.friction, 40, marks=pytest.mark.nightly),
        pytest.param(coverage_study.added_mass, 6, marks=pytest.mark.nightly),
    ],
)
def test_intervals_hold_the_truth_when_the_constants_are_off_and_when_they_are_exact(draw, number):
    for found in coverage_study.scores(draw, number).values():
        assert len(found) >= 0.9 * number
        assert_standard(found)
        if number >= 100:
            assert 0.90 <= np.mean(np.abs(found) < 1.96) <= 0.98


KNOWN_OFFSETS = {"rest": 0.0, "offsets_uncertainty": SHEET}


@pytest.mark.parametrize(
    ("columns", "factor", "facts", "named"),
    [
        (["force_y_n"], -1.0, {}, "the other sign of fy"),
        (list(lab.READINGS[:3]), 1.0 / 9.80665, {}, "kgf in place of N in fx, fy, fz"),
        (["torque_x_n_m"], 9.80665, {}, "a factor of 9.81 in tx"),
        ([], 1.0, KNOWN_OFFSETS, "the weight of the rig is not in the readings"),
    ],
)
def test_a_sign_a_unit_and_the_weight_are_named_before_any_constant(columns, factor, facts, named):
    log = lab.hold(duration=4.0, **facts)
    table = log.table.copy()
    table[columns] *= factor
    if facts:
        table[list(lab.READINGS)] -= lab.weight(lab.LAB, lab.HOLD_ANGLE)[0]
    warnings = fit_static(static_data(replace(log, table=table))).warnings
    assert warnings[0].startswith(named)
    assert not any("shifted" in warning for warning in warnings)


def test_a_sign_is_named_where_no_constant_has_an_effect():
    names = load_rig_scenario("static").uncertainty.model_dump()
    zero = tuple(f"uncertainty.{name}=0" for name in names)
    options = FitOptions(settings=(*zero, "uncertainty.pivot_z=1e-9"))
    log = lab.hold(duration=4.0)
    log.table["force_y_n"] *= -1.0
    result = fit_static(static_data(log, options=options))
    assert not result.constants
    assert result.warnings[0].startswith("the other sign of fy")


def test_a_pivot_that_is_off_is_no_mistake_of_the_readings():
    rig = replace(lab.LAB, pivot=(0.11, -0.00011, 0.17138))
    warnings = fit_static(static_data(lab.hold(rig, duration=4.0))).warnings
    assert warnings[0].startswith("the data want pivot_x shifted by 0.01")


@pytest.mark.slow
@draws(5, 200)
@pytest.mark.parametrize("kind", coverage_study.OPEN)
def test_finite_intervals_hold_the_truth_where_the_log_leaves_unknowns_open(kind, number):
    finite, infinite = coverage_study.held(coverage_study.OPEN[kind], number)
    assert infinite >= number
    if finite:
        assert_held(finite)
