"""Starts and bounds of the fits to swings, and Huber's loss on a swing with wild samples."""

from dataclasses import replace

import numpy as np
import pytest

from aerodima.optimisation.identify.fit_options import FitOptions
from aerodima.optimisation.identify.gauss_newton import best_start
from aerodima.optimisation.identify.least_squares import (
    StartResult,
)
from aerodima.optimisation.identify.swing_coefficients import (
    added_mass_parameter,
    fit_added_mass,
    fit_friction,
    potential_flow_mass,
)
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.rig.pendulum import (
    PendulumModel,
)
from tests.optimisation.identify import swing_truth as truth
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import changed


@pytest.fixture(scope="module")
def short():
    """Half a second of a driven swing with 0.02 kg of added mass per part."""
    return swing_data(truth.flick_log(0.02, seed=1, duration=0.5), "swing")


@pytest.mark.slow
def test_it_starts_from_zero_and_a_scan_and_from_the_table_where_that_leaves_inertia(short):
    windy = truth.flick_log(0.02, seed=1, wind_speed=20.0, duration=0.5)
    result, fast = (fit_added_mass(data) for data in (short, swing_data(windy, "swing")))
    assert result["added_mass"].value == pytest.approx(0.02, abs=0.001)
    starts, fast_starts = (
        [round(attempt["start"]["added_mass"], 1) for attempt in fitted.attempts]
        for fitted in (result, fast)
    )
    # Table 4.12 has -0.1 kg at 10 m/s, more than the inertia that tail 1 has.
    assert starts == [0.0, 0.0]
    assert fast_starts == [0.0, 0.1, 0.0]
    # rho pi R^2 of a part: 1.2 kg/m3, a cylinder of some 27 mm radius and 78 mm length.
    assert 1e-4 < potential_flow_mass(short) < 5e-4
    times = result["added_mass"].value / potential_flow_mass(short)
    assert result.facts["times_potential_flow"] == pytest.approx(times)


def test_bounds_of_the_added_mass_leave_some_inertia(short):
    least = PendulumModel.from_scenario(short.scenario).min_added_mass
    free = added_mass_parameter(short)
    assert least < free.lower < 0.95 * least
    assert free.upper == 1.0


def test_a_fit_that_stops_at_a_bound_says_so_and_bounds_need_a_parameter():
    data = swing_data(truth.bar_log(0.04, 0.036, 1.4, 2.0), "bar_swing")
    result = fit_friction(data, options=FitOptions(bounds=(("coulomb", 0.0, 0.0399),)))
    assert result["coulomb"].bound == "upper"
    assert result["coulomb"].lower < result["coulomb"].value == result["coulomb"].upper
    assert all(e.lower <= e.value <= e.upper for e in result.estimates)
    assert any("coulomb" in warning and "0.0399" in warning for warning in result.warnings)
    wrong = FitOptions(bounds=(("cd", 0.0, 1.0),))
    assert_refused(lambda: fit_friction(data, options=wrong), FitError, "cd", "coulomb", "viscous")
    far = fit_friction(data, options=FitOptions(bounds=(("viscous", 0.5, 1.0),)))
    assert far["viscous"].value == 0.5


def wild(log, number):
    """The log with so many samples of its angle 0.2 rad off."""
    angle = log.table.angle_rad.to_numpy().copy()
    angle[np.random.default_rng(5).choice(len(angle), number, replace=False)] += 0.2
    return changed(log, angle_rad=angle)


def test_wild_encoder_samples_do_not_move_the_friction_under_huber():
    data = swing_data(wild(truth.bar_log(0.04, 0.036, 1.4, 3.0), 60), "bar_swing")
    torn = fit_friction(data)
    held = fit_friction(data, options=FitOptions(loss="huber"))
    assert abs(torn["coulomb"].value - 0.04) > 10.0 * abs(held["coulomb"].value - 0.04)
    assert held["coulomb"].value == pytest.approx(0.04, rel=0.01)
    assert held["viscous"].value == pytest.approx(0.036, rel=0.01)
    assert held.facts["outliers"] >= 10  # of 60, one in four falls on the grid of the rollout


@pytest.mark.parametrize("number", [0, 60])
def test_nor_where_constants_of_the_rig_are_uncertain_and_the_intervals_stay(number):
    log = truth.bar_log(0.04, 0.036, 1.4, 3.0)
    known = ("uncertainty.bar_com=0.0005", "uncertainty.encoder_zero=0.002")
    plain, robust = FitOptions(settings=known), FitOptions("huber", settings=known)
    honest = fit_friction(swing_data(log, "bar_swing", options=plain))
    held = fit_friction(swing_data(wild(log, number), "bar_swing", options=robust), robust)
    assert set(held.constants) == {"bar_com", "encoder_zero"}
    for name in ("coulomb", "viscous"):
        deviation = honest[name].standard_deviation
        assert held[name].value == pytest.approx(honest[name].value, abs=deviation)
        assert held[name].standard_deviation == pytest.approx(deviation, rel=0.2)


def test_a_far_lower_cost_is_kept_although_the_solver_did_not_say_success():
    start = np.zeros(1)
    low = StartResult(start, np.array([3.1]), 0.005, False, "steps", 1)
    high = StartResult(start, np.array([9.0]), 18.0, True, "settled", 1)
    assert best_start([low, high]) is low
    assert best_start([low, replace(high, cost=0.00501)]).success
