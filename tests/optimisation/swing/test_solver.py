"""Collocation and its solution: gradients, limits that hold, names of what is violated, determinism."""

from __future__ import annotations

import time

import numpy as np
import pytest

from aerodima.optimisation.swing.mesh_refinement import collocation_error, refined, tail_at
from aerodima.optimisation.swing.reduced_car import lift_roll
from aerodima.optimisation.swing.solver import best_of, bounds_of, multi_start, solve, violations_of
from aerodima.optimisation.swing.swing_problem import ANGLE, RATE, ROLL, TORQUE, SwingLimits, random_start
from aerodima.optimisation.swing.transcription import constraints
from aerodima.workbench.errors import SwingError
from tests.optimisation.swing.turn import car, problem


@pytest.mark.parametrize("dof", [1, 2])
@pytest.mark.parametrize("objective", ["friction", "speed"])
def test_jacobians_are_those_of_finite_differences_and_keep_to_their_pattern(dof: int, objective: str) -> None:
    posed = problem(dof, knots=4, members=2, objective=objective, parameter_range=(0.8, 6.0))
    x, step = random_start(posed, np.random.default_rng(3)), 1e-6
    for block in constraints(posed):
        jacobian = block.jacobian(x)
        ahead, behind = (
            np.stack([block.at(x + moved)[0] for moved in sign * step * np.eye(len(x))], axis=1) for sign in (1, -1)
        )
        measured = (ahead - behind) / (2 * step)
        assert np.max(np.abs(measured - jacobian)) < 1e-6 * max(1.0, np.max(np.abs(jacobian)))


def test_solution_keeps_to_every_limit_and_ends_at_rest() -> None:
    posed = problem(limits={"torque": 4.0})
    solution = solve(posed, random_start(posed, np.random.default_rng(0)))
    assert solution.success
    layout = posed.layout
    torque = solution.x[layout.cars[0].torque[0]] * TORQUE
    angle, rate = solution.x[layout.tail[0].angle] * ANGLE, solution.x[layout.tail[0].rate] * RATE
    assert np.max(np.abs(torque)) <= 4.0 + 1e-4
    assert np.max(np.abs(np.diff(torque) / np.diff(posed.knots))) <= posed.limits.torque_rate * (1 + 1e-6)
    assert np.max(np.abs(angle)) <= np.pi / 2 + 1e-6
    assert angle[0] == pytest.approx(-np.pi / 2)
    assert rate[-1] == pytest.approx(0.0, abs=1e-6)
    assert np.max(rate) > 1.0  # it swings, and to the outside


def test_the_car_leans_inwards_only_while_its_outer_wheels_bear_load() -> None:
    c = car()
    weight = (c.mass + c.tail_mass) * c.gravity
    most = lift_roll(c)
    assert 0.5 * weight - c.half_track * c.side_stiffness * most == pytest.approx(0.0, abs=1e-9)  # load of one side
    for asked, allowed in ((0.25, most), (0.02, 0.02)):
        posed = problem(limits={"roll_inwards": asked})
        roll = posed.layout.cars[0].roll[1:]
        assert np.allclose(bounds_of(posed)[0][roll] * ROLL, -allowed)
    over = random_start(posed, np.random.default_rng(0))
    over[roll[5]] = -1.05 * most / ROLL
    assert any(found.name == "car roll" for found in violations_of(problem(), over))


def test_snopt_and_ipopt_find_the_same() -> None:
    posed = problem(objective="roll", parameter_range=(0.0, 1.0))
    start = random_start(posed, np.random.default_rng(1))
    first, second = solve(posed, start), solve(posed, start, solver="ipopt")
    assert first.success
    assert second.success
    assert first.cost == pytest.approx(second.cost, rel=0.01)


def test_same_seed_gives_the_same_swing_and_more_starts_begin_with_the_same_ones() -> None:
    posed = problem(objective="effort", parameter_range=(0.0, 1.0))
    one, two = multi_start(posed, 5, 1, iterations=40), multi_start(posed, 5, 2, iterations=40)
    assert np.array_equal(one[0].x, two[0].x)
    assert best_of(two).cost <= one[0].cost + 1e-12


def test_an_impossible_swing_is_reported_with_name_and_unit_worst_first() -> None:
    posed = problem(limits={"roll": 0.03}, objective="effort", parameter_range=(0.0, 1.0), wait=0.95)
    solution = solve(posed, random_start(posed, np.random.default_rng(0)), iterations=60)
    assert not solution.success
    assert any("car roll" in violation.name for violation in solution.violations)
    assert all(violation.unit and violation.amount > 0.0 for violation in solution.violations)
    sizes = [violation.scaled for violation in solution.violations]
    assert sizes == sorted(sizes, reverse=True)


def test_wall_time_holds() -> None:
    posed = problem(knots=41)
    begun = time.perf_counter()
    solution = solve(posed, random_start(posed, np.random.default_rng(0)), wall_time=0.05)
    assert time.perf_counter() - begun < 5.0
    assert solution.timed_out
    assert np.all(np.isfinite(solution.x))


def test_a_fixed_trigger_time_holds_the_tail_until_then() -> None:
    posed = problem(wait=0.2)
    solution = solve(posed, random_start(posed, np.random.default_rng(0)))
    waiting = posed.knots <= 0.2
    assert np.allclose(solution.x[posed.layout.tail[0].angle][waiting], -np.pi / 2)


@pytest.mark.parametrize("torque", [0.0, -1.0, 30.0])
def test_a_torque_limit_outside_the_motors_is_refused(torque: float) -> None:
    with pytest.raises(SwingError, match="torque limit"):
        SwingLimits.of(car(), 1, torque)


def test_a_solver_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Missing:
        def available(self) -> bool:
            return False

    monkeypatch.setattr("aerodima.optimisation.swing.solver.IpoptSolver", Missing)
    posed = problem(knots=7)
    with pytest.raises(SwingError, match="solver ipopt: not available"):
        solve(posed, random_start(posed, np.random.default_rng(0)), solver="ipopt")


def test_a_finer_mesh_carries_the_same_motion() -> None:
    posed = problem()
    x = solve(posed, random_start(posed, np.random.default_rng(0)), iterations=200).x
    finer, y = refined(posed, x)
    time_ = np.linspace(0.0, 1.0, 77)
    for coarse, fine in zip(tail_at(posed, x, time_), tail_at(finer, y, time_), strict=True):
        assert np.allclose(coarse, fine, atol=1e-4)
    defects = [block for block in constraints(finer) if block.linear and "defect" in block.rows[0].name]
    assert len(defects) == 2
    assert all(np.max(np.abs(block.at(y)[0])) < 1e-4 for block in defects)


@pytest.mark.slow
def test_collocation_error_shrinks_with_the_mesh() -> None:
    posed = problem(knots=41)
    coarse = solve(posed, random_start(posed, np.random.default_rng(0)))
    finer, start = refined(posed, coarse.x)
    fine = solve(finer, start)
    assert collocation_error(finer, fine) < max(collocation_error(posed, coarse), 2e-3)


def test_one_swing_for_two_cars_keeps_both_upright() -> None:
    posed = problem(knots=15, members=2)
    solution = solve(posed, random_start(posed, np.random.default_rng(0)))
    assert solution.success
    assert not violations_of(posed, solution.x)
    low, high = bounds_of(posed)
    assert np.all(solution.x >= low - 1e-4)
    assert np.all(solution.x <= high + 1e-4)
