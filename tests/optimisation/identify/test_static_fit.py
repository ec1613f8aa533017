"""Static fits: the balance against the rig's plant, synthetic truth, and what is wrong with a
log.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from aerodima.optimisation.identify.fit_options import FitOptions
from aerodima.optimisation.identify.static_fit import (
    StaticResidual,
    fit_static,
    shifted_data,
    static_problem,
)
from aerodima.optimisation.identify.static_log import static_data
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.rig.pendulum import StaticBalance
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.rig.static_hold import simulate_static_log
from tests.optimisation.identify import static_truth as truth
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import changed, stating


@pytest.fixture(scope="module")
def windy():
    """Tail 1 at 15 degrees in 20 m/s with psi3 = 0.05 rad, 5 s, the first without wind."""
    scenario = truth.static_scenario(1, "major", 15.0, 20.0, 0.05).varied(
        experiment={"duration": 5.0}
    )
    calm = Rig(scenario.varied(experiment={"wind_speed": 0.0}))
    return truth.log_with_rest(scenario, Rig(scenario), calm, 1.0)


@pytest.mark.parametrize("axis", ["major", "minor"])
@pytest.mark.parametrize(
    ("tail", "degrees"), [(1, 0), (2, 0.3), (1, 30), (2, 45), (3, 60), (2, 75)]
)
def test_balance_is_that_of_the_plant(tail, degrees, axis):
    scenario = truth.static_scenario(tail, axis, degrees, 20.0, -0.08)
    rig = Rig(scenario)
    balance = StaticBalance.from_scenario(scenario)
    angle = math.radians(degrees)
    current = balance.holding_current(angle, 20.0, truth.CD, truth.CL, -0.08)
    assert current == pytest.approx(rig.holding_current(angle), abs=1e-10)
    effect = np.array([1.0, truth.CD, truth.CL]) @ np.array(balance.wind_effect(angle, 20.0, -0.08))
    wrench = balance.hanging(angle)[0] + effect[:6]
    # Same law and jet, another arrangement of the sums: rounding only.
    np.testing.assert_allclose(
        wrench, rig.reaction(angle, 0.0, rig.torque_of(current)).wrench, atol=1e-10
    )


def test_truth_lies_within_narrow_intervals_and_scipy_agrees(windy):
    data = static_data(windy)
    result = fit_static(data)
    for name, value in windy.extra["truth"].items():
        estimate = result[name]
        # Three half widths: this is one log, coverage over many is another test.
        assert abs(estimate.value - value) < 3.0 * estimate.standard_deviation
        assert estimate.standard_deviation < 0.02 * max(abs(value), 0.1)
    problem = static_problem(data)
    reference = least_squares(
        problem.residual, problem.parameters.initial, x_scale="jac", xtol=1e-12, ftol=1e-12
    )
    assert [result[name].value for name in problem.parameters.names] == pytest.approx(
        reference.x.tolist(), rel=1e-5
    )


def test_rounding_of_the_angle_is_half_a_count_in_the_residual(windy):
    data = static_data(windy)
    x = np.array([0.9, 0.3, 0.07, 5.0])
    half = 0.5 * data.scenario.count_angle
    ends = [StaticResidual(shifted_data(data, {"encoder_zero": off}))(x) for off in (-half, half)]
    noise = StaticResidual(data).noise(x)
    assert noise.rounding == pytest.approx(0.5 * (ends[1] - ends[0]), rel=1e-3, abs=1e-9)


def test_without_exposure_only_the_current_is_determined():
    scenario = truth.static_scenario(1, "major", 75.0, 20.0, 0.0).varied(
        experiment={"duration": 2.0}
    )
    result = fit_static(static_data(simulate_static_log(scenario)))
    assert set(result.unidentifiable) == {"cd", "cl", "psi3"}
    assert result["cd"].upper == math.inf
    assert result["current"].identifiable
    assert result.facts["exposed_length_m"] == 0.0


def test_without_rest_phase_the_bias_widens_the_intervals_and_is_told(windy):
    with_rest = fit_static(static_data(windy))
    windy_only = windy.table[windy.time > 1.0].reset_index(drop=True)
    log = stating(rest_s=None)(replace(windy, table=windy_only))
    without = fit_static(static_data(log))
    assert len(without.warnings) > len(with_rest.warnings)
    assert without["current"].standard_deviation > 50.0 * with_rest["current"].standard_deviation


def test_a_log_that_was_cut_and_starts_at_zero_again_keeps_its_rest_phase(windy):
    kept = windy.table[windy.time > 0.5 - 1e-9].reset_index(drop=True)
    part = replace(windy, table=kept.assign(time_s=kept.time_s - 0.5))
    part = stating(rest_s=[at - 0.5 for at in windy.extra["rest_s"]])(part)
    assert part.time[0] == 0.0
    assert fit_static(static_data(part))["cd"].holds(truth.CD)


def test_a_missing_and_a_dead_axis_are_left_out_and_told(windy):
    log = replace(windy, table=windy.table.drop(columns="force_z_n"))
    log = changed(log, torque_y_n_m=np.full(len(log.table), 0.2))
    result = fit_static(static_data(log))
    assert set(result.residual_rms) == {"fx", "fy", "tx", "tz", "speed"}
    for axis in ("force_z_n", "torque_y_n_m"):
        assert any(axis in warning for warning in result.warnings)
    assert result["cd"].value == pytest.approx(truth.CD, abs=0.02)


def changing(name, change):
    """Makes a log in which a column becomes a function of itself."""
    return lambda log: changed(log, **{name: change(log.table[name])})


def gap(log):
    return replace(log, table=log.table.drop(index=range(2000, 2500)).reset_index(drop=True))


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (
            changing("force_y_n", lambda f: np.where(f.index == 2000, np.nan, f)),
            ("force_y_n", "2 s"),
        ),
        (gap, ("time_s",)),
        (changing("time_s", lambda time: time.to_numpy()[::-1]), ("time_s",)),
        (changing("angle_rad", np.degrees), ("angle_rad",)),
        (changing("torque_x_n_m", lambda torque: 1000.0 * torque), ("torque_x_n_m",)),
        (changing("angle_rad", lambda angle: angle + 1e-4 * angle.index), ("1 degree",)),
        (lambda log: replace(log, table=log.table.head(3)), ("3 samples",)),
        (lambda log: replace(log, kind="swing"), ("swing",)),
        (stating(wind_speed_m_per_s=200.0), ("wind_speed_m_per_s", "200")),
        (stating(wind_speed_m_per_s=True), ("wind_speed_m_per_s", "True")),
        (stating(offsets_to_add=[1, 2]), ("offsets_to_add", "[1, 2]", "6")),
        (stating(rest_s=None, tared_angle_rad=20.0), ("tared_angle_rad", "20 rad", "1.9")),
        (stating(tail="7"), ("tail", "7")),
        (stating(rest_s=[0.0, 0.01]), ("rest",)),
        (stating(rest_s=1), ("rest_s", "1", "2")),
    ],
)
def test_a_bad_log_is_refused(windy, damage, named):
    assert_refused(lambda: static_data(damage(windy)), UserError, *named)


def test_a_logged_current_that_is_no_number_is_not_said_to_be_in_another_unit(windy):
    log = changed(windy, current_a=windy.table.current_a.where(windy.table.index != 3000))
    (warning,) = [text for text in static_data(log).warnings if "current_a" in text]
    assert "numbers" in warning
    assert "mA" not in warning


def test_a_bound_of_the_user_stops_what_the_wide_ones_allow(windy):
    data = static_data(windy)
    shifted = replace(data, wrench=data.wrench + np.array([-4.0, 0.0, 0.0, 0.0, 1.0, 0.0]))
    assert fit_static(shifted)["psi3"].value > 0.13
    printed = fit_static(shifted, FitOptions(bounds=(("psi3", -0.12, 0.12),)))
    assert (printed["psi3"].value, printed["psi3"].bound) == (0.12, "upper")
