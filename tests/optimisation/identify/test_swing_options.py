"""Seeds, bounds and verdicts of the added-mass fit, and Huber's loss on a swing with wild samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerodima.optimisation.identify.added_mass import (
    SEEDS,
    added_mass_parameter,
    fit_added_mass,
    seed_value,
)
from aerodima.optimisation.identify.fit_parameters import Parameter, Parameters
from aerodima.optimisation.identify.least_squares import Attempt, Problem, solve
from aerodima.optimisation.identify.log_rig import FitOptions
from aerodima.optimisation.identify.pendulum import Pendulum
from aerodima.optimisation.identify.swing_coefficients import fit_friction
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.errors import FitError
from tests.optimisation.identify import swing_truth as truth


@pytest.fixture(scope="module")
def short():
    """Half a second of a driven swing with 0.02 kg of added mass per part."""
    return swing_data(truth.flick_log(0.02, seed=1, duration=0.5), "swing")


def test_all_seeds_are_reported_and_those_beyond_the_bounds_with_the_reason(short) -> None:
    seeds = ("zero", "table-4.12-10", "table-4.12-20", "0.03")
    result = fit_added_mass(short, seeds=seeds)
    assert result["added_mass"].value == pytest.approx(0.02, abs=0.001)
    by_name = {attempt["seed"]: attempt for attempt in result.attempts}
    assert set(by_name) == {*seeds, "scan"}
    assert by_name["table-4.12-20"]["start"]["added_mass"] == pytest.approx(0.1)  # Table 4.12
    assert by_name["0.03"]["found"]["added_mass"] == pytest.approx(0.02, abs=0.001)
    assert not by_name["table-4.12-10"]["success"]
    assert "not positive definite" in by_name["table-4.12-10"]["status"]
    assert result.facts["times_potential_flow"] == pytest.approx(
        result["added_mass"].value / SEEDS["potential-flow"](short)
    )


def test_seeds_have_names_or_are_numbers(short) -> None:
    # 10 m/s: the nearest row is that of 10 m/s.
    assert seed_value("table-4.12", short) == seed_value("table-4.12-10", short) == pytest.approx(-0.1)
    # rho pi R^2 of a part: 1.2 kg/m3, a cylinder of some 27 mm radius and 78 mm length.
    assert 1e-4 < seed_value("potential-flow", short) < 5e-4
    for wrong in ("table-10.1", "nan"):
        with pytest.raises(FitError, match=r"allowed: zero, potential-flow, table-4\.12"):
            seed_value(wrong, short)


def test_bounds_leave_some_inertia_and_the_printed_ones_can_be_chosen(short) -> None:
    least = Pendulum.of(short.scenario).least_added_mass
    wide, printed = added_mass_parameter(short), added_mass_parameter(short, "printed")
    assert least < wide.lower == printed.lower < 0.95 * least
    assert (wide.upper, printed.upper) == (1.0, 0.5)
    with pytest.raises(FitError, match=r"no seed can be tried: zero: 0 kg lies outside the bounds 0\.05 \.\. 0\.1 kg"):
        fit_added_mass(short, seeds=("zero",), options=FitOptions(bounds=(("added_mass", 0.05, 0.1),)))


def test_a_fit_that_stops_at_a_bound_says_so_and_bounds_need_a_parameter() -> None:
    data = swing_data(truth.bar_log(0.04, 0.036, 1.4, 2.0), "bar_swing")
    result = fit_friction(data, options=FitOptions(bounds=(("coulomb", 0.0, 0.0399),)))
    assert result["coulomb"].bound == "upper"
    assert result["coulomb"].lower < result["coulomb"].value == result["coulomb"].upper
    assert all(e.lower <= e.value <= e.upper for e in result.estimates)
    assert any("coulomb stopped at its upper bound 0.0399 N m" in warning for warning in result.warnings)
    with pytest.raises(FitError, match=r"bound on 'cd': the free parameters are coulomb, viscous"):
        fit_friction(data, options=FitOptions(bounds=(("cd", 0.0, 1.0),)))
    with pytest.raises(FitError, match=r"the seed 0\.03\d+ N m s/rad lies outside its bounds"):
        fit_friction(data, options=FitOptions(bounds=(("viscous", 0.5, 1.0),)))


def test_wild_encoder_samples_do_not_move_the_friction_under_huber() -> None:
    log = truth.bar_log(0.04, 0.036, 1.4, 3.0)
    wild = log.table.angle_rad.to_numpy().copy()
    wild[np.random.default_rng(5).choice(len(wild), 60, replace=False)] += 0.2
    data = swing_data(replace(log, table=log.table.assign(angle_rad=wild)), "bar_swing")
    torn, held = fit_friction(data), fit_friction(data, options=FitOptions(loss="huber"))
    assert abs(torn["coulomb"].value - 0.04) > 10.0 * abs(held["coulomb"].value - 0.04)
    assert held["coulomb"].value == pytest.approx(0.04, rel=0.01)
    assert held["viscous"].value == pytest.approx(0.036, rel=0.01)
    assert held.facts["outliers"] >= 10  # of 60, one in four falls on the grid of the rollout


def test_a_far_lower_cost_is_kept_although_the_solver_did_not_say_success() -> None:
    problem = Problem(Parameters.of([Parameter("x", "1", 0.0)]), lambda x: x - 3.0)
    outcomes = iter([(np.array([3.1]), 0.005, False), (np.array([9.0]), 18.0, True)])

    def method(_: Problem, start: np.ndarray) -> Attempt:
        x, cost, success = next(outcomes)
        return Attempt(start, x, cost, success, "told", 1)

    assert solve(problem, method, [np.zeros(1), np.ones(1)]).x[0] == 3.1


@pytest.mark.parametrize("amplitude", [1.4, 0.5])
def test_breakaway_friction_is_found_from_large_and_from_small_swings(amplitude: float) -> None:
    log = truth.bar_log(0.04, 0.036, amplitude, 4.0, stribeck=(0.03, 0.6))
    found = fit_friction(swing_data(log, "bar_swing"), stribeck=True)
    assert found["coulomb"].value == pytest.approx(0.04, rel=0.03)
    assert found["breakaway_excess"].value == pytest.approx(0.03, rel=0.03)
    assert found["stribeck_speed"].value == pytest.approx(0.6, rel=0.01)
    assert len(found.attempts) == 2
