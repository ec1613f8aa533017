"""The solvers of least-squares problems, and Huber's loss: wild values do not decide, without them
nothing is lost.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.solvers import SnoptSolver
from scipy.optimize import least_squares

from aerodima.optimisation.identify.fit_pipeline import fit
from aerodima.optimisation.identify.fit_program import FitProgram
from aerodima.optimisation.identify.gauss_newton import SolverOptions, solve, solve_from
from aerodima.optimisation.identify.huber import solve_huber, spread
from aerodima.optimisation.identify.least_squares import Parameter
from aerodima.optimisation.identify.noise import independent_noise
from aerodima.workbench.core.errors import FitError
from tests.optimisation.coverage import assert_held, assert_standard, draws
from tests.optimisation.identify.problems import fit_line, problem_of
from tests.refusals import assert_refused

TIME = np.linspace(0.0, 3.0, 40)


def decay(amplitude_size=1.0, fastest=5.0):
    """y = a exp(-k t) + c with a ripple that no model explains; `a` may be of any size."""
    y = amplitude_size * (2.0 * np.exp(-1.3 * TIME) + 0.5 + 0.05 * np.sin(17.0 * TIME))
    return problem_of(
        lambda x: (x[0] * np.exp(-x[1] * TIME) + x[2] - y) / amplitude_size,
        Parameter("a", "N", amplitude_size, 0.0, 10.0 * amplitude_size),
        Parameter("k", "1/s", 0.5, 0.0, fastest),
        Parameter("c", "N", 0.0, scale=amplitude_size),
        name="decay",
    )


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_agrees_with_scipy_whatever_the_units(size):
    problem = decay(size)
    scales = np.array([size, 1.0, size])
    reference = least_squares(
        lambda z: problem.residual(z * scales),
        problem.parameters.initial / scales,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    solution = solve(problem)
    assert solution.best.success
    # Both stop where a step changes about the ninth digit.
    assert solution.x / scales == pytest.approx(reference.x, rel=1e-6)


def test_stops_on_a_bound_at_the_constrained_minimum():
    problem = decay(fastest=1.0)
    reference = least_squares(
        problem.residual, problem.parameters.initial, bounds=([0, 0, -np.inf], [10, 1.0, np.inf])
    )
    solution = solve(problem)
    sides = problem.parameters.by_name(problem.parameters.sides(solution.x))
    assert {name: side for name, side in sides.items() if side} == {"k": 1}
    # scipy's interior method stays about 1e-8 short of the bound.
    assert solution.x == pytest.approx(reference.x, abs=1e-5)


def test_a_residual_that_is_not_finite_at_the_seed_names_the_unknowns():
    mass = Parameter("mass", "kg", -0.1)
    problem = problem_of(lambda x: np.array([np.sqrt(x[0]) - 1.0]), mass, name="pendulum")
    with np.errstate(invalid="ignore"):
        assert_refused(lambda: solve(problem), FitError, "pendulum", "mass = -0.1 kg")


def test_other_seeds_are_tried_when_one_has_no_model():
    def residual(x):
        if x[0] < 0.0:
            raise FitError(f"the mass matrix is indefinite at {x[0]} kg")
        return np.array([x[0] - 2.0, 0.1 * x[0]])

    problem = problem_of(residual, Parameter("mass", "kg", -0.1, -1.0, 10.0))
    solution = solve(problem, problem.parameters.starts([{"mass": 1.0}]))
    assert [attempt.success for attempt in solution.attempts] == [False, True]
    assert "-0.1" in solution.attempts[0].status
    assert solution.x[0] == pytest.approx(2.0 / 1.01, rel=1e-8)


def test_a_rollout_that_breaks_down_within_the_solve_shortens_the_step():
    # From 0.2 the full Gauss-Newton step of log(x) - 3 goes to 1.1, from there to 4.2; beyond 25
    # there is no model.
    def residual(x):
        return np.array([np.log(x[0]) - 3.0, 0.0]) if x[0] < 25.0 else np.array([np.nan, 0.0])

    solution = solve(problem_of(residual, Parameter("x", "1", 0.2, 0.0, 100.0)))
    assert solution.x[0] == pytest.approx(np.exp(3.0), rel=1e-6)


@pytest.mark.parametrize("ends", ["nan", "error"])
def test_a_model_that_ends_beside_the_solution_has_a_one_sided_derivative(ends):
    def residual(x):
        if x[0] < 1.0 and ends == "error":
            raise FitError(f"no model at {x[0]}")
        if x[0] < 1.0:
            return np.full(2, np.nan)
        return np.array([np.log(x[0] - 0.9) - np.log(0.10001), x[0] - 1.00001])

    x = Parameter("x", "1", 2.0, 0.0, 5.0, scale=1.0)
    problem = problem_of(residual, x, name="edge")
    solution = solve(problem)
    assert solution.x[0] == pytest.approx(1.00001, abs=1e-8)
    assert solution.jacobian[:, 0] == pytest.approx([10.0, 1.0], rel=0.01)
    alone = replace(problem, residual=lambda x: residual(x) * (1.0 if x[0] == 1.1 else np.nan))
    assert_refused(lambda: alone.central_jacobian(np.array([1.1])), FitError, "edge", "x = 1.1")


def test_of_several_minima_the_lowest_is_kept_and_all_are_listed():
    # The cost is stationary where (x + 2) (2 x (x - 2) + 1/4) = 0: minima at 1 + sqrt(7/8) and,
    # lower, at -2.
    x = Parameter("x", "1", 3.0, -5.0, 5.0)
    problem = problem_of(lambda x: np.array([x[0] ** 2 - 4.0, 0.5 * (x[0] + 2.0)]), x)
    solution = solve(problem, problem.parameters.starts([{"x": -3.0}]))
    minima = [attempt.x[0] for attempt in solution.attempts]
    assert minima == pytest.approx([1.0 + np.sqrt(0.875), -2.0], abs=1e-6)
    assert solution.x[0] == minima[1]


def test_jacobian_at_the_solution_is_that_of_the_formula():
    solution = solve(decay())
    a, k, _ = solution.x
    exact = np.column_stack([np.exp(-k * TIME), -a * TIME * np.exp(-k * TIME), np.ones_like(TIME)])
    # Central differences with a step of 5e-4 scales: error of order step^2.
    assert np.allclose(solution.jacobian, exact, atol=1e-6)


def test_a_bent_valley_is_followed_by_bending_the_steps():
    # Rosenbrock's valley with a weight of 1e5: unbent steps from here are many and short.
    x, y = (Parameter(name, "1", at, -5.0, 5.0) for name, at in (("x", -1.5), ("y", 2.0)))
    problem = problem_of(lambda p: np.array([1e5 * (p[1] - p[0] ** 2), 1.0 - p[0]]), x, y)
    solution = solve(problem)
    assert solution.best.success
    assert solution.best.iterations < 20
    assert solution.x == pytest.approx([1.0, 1.0], abs=1e-8)


def test_costs_and_constraints_of_a_user_are_met_and_snopt_agrees_on_the_whole_program():
    program = FitProgram(decay())
    program.prog.AddLinearConstraint(program["a"] + program["c"], 3.0, 3.0)
    program.prog.AddQuadraticCost((program["k"] - 2.0) ** 2)
    solution = solve(program)
    assert solution.best.success
    assert solution.x[0] + solution.x[2] == pytest.approx(3.0, abs=1e-9)
    oracle = SnoptSolver().Solve(program.prog, decay().parameters.initial, None)
    assert solution.x == pytest.approx(oracle.GetSolution(program.x), abs=1e-5)
    assert solution.best.cost == pytest.approx(oracle.get_optimal_cost(), rel=1e-9)
    result = fit(program, lambda s: independent_noise(s.residual, 3))
    assert any("constraints" in warning for warning in result.warnings)
    assert result.added_cost == pytest.approx((result["k"].value - 2.0) ** 2, rel=1e-9)
    residual = solution.residual
    assert result.cost == pytest.approx(0.5 * float(residual @ residual), rel=1e-9)
    program.prog.AddConstraint(program["a"] ** 2 <= 1.0)
    assert_refused(lambda: solve(program), FitError, "decay", "linear")


def test_a_kept_jacobian_asks_for_fewer_residuals_and_finds_the_same_minimum():
    problem = decay()
    start = problem.parameters.initial
    calls = []

    def counted(x):
        calls[-1] += 1
        return decay().residual(x)

    for jacobian in ("differences", "secant"):
        calls.append(0)
        options = SolverOptions(jacobian=jacobian, settled=1e-9)
        kept = solve_from(replace(problem, residual=counted), start, options)
    assert calls[1] < calls[0]
    assert kept.x == pytest.approx(solve(problem).x, rel=1e-3)


def test_spread_is_the_standard_deviation_of_normal_values_and_ignores_a_wild_tenth():
    values = np.random.default_rng(1).normal(3.0, 2.0, 20000)
    assert spread(values) == pytest.approx(2.0, rel=0.03)
    values[::10] += 1e6
    assert spread(values) < 2.4


def test_wild_points_tear_the_least_squares_line_away_and_not_the_huber_line():
    rng = np.random.default_rng(2)
    x = np.linspace(0.0, 1.0, 60)
    y = 4.0 * x - 1.0 + 0.05 * rng.normal(size=60)
    y[[50, 54, 58]] += 6.0
    torn = fit_line(x, y, "squares")
    held = fit_line(x, y, "huber")
    assert torn["slope"].value > 5.0
    assert held["slope"].value == pytest.approx(4.0, abs=0.1)
    assert held["slope"].holds(4.0)
    assert held.facts["loss"] == "huber"
    assert held.facts["outliers"] == 3
    # The interval is that of the good points, not of the wild ones.
    assert held["slope"].standard_deviation < 0.2 * torn["slope"].standard_deviation


def test_normal_data_lose_a_twentieth_of_their_variance_to_the_huber_loss():
    """Huber's limit of 1.345 is 95 % efficient."""
    x = np.linspace(0.0, 1.0, 2000)
    y = 2.0 * x + 0.1 * np.random.default_rng(8).normal(size=2000)
    least, robust = (
        fit_line(x, y, loss)["slope"].standard_deviation for loss in ("squares", "huber")
    )
    assert (robust / least) ** 2 == pytest.approx(1.0 / 0.95, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("wild", [0.0, 0.05])
@draws(60, 400)
def test_intervals_under_huber_hold_the_truth_in_95_percent(number, wild):
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 80)
    scores = []
    held = []
    for _ in range(number):
        y = 2.0 * x + 0.5 + 0.1 * rng.normal(size=80)
        y += np.where(rng.uniform(size=80) < wild, 3.0 * rng.choice([-1.0, 1.0], size=80), 0.0)
        slope = fit_line(x, y, "huber")["slope"]
        held.append(slope.holds(2.0))
        scores.append((slope.value - 2.0) / slope.standard_deviation)
    assert_held(held)
    assert_standard(scores)


def test_given_and_differenced_jacobians_lead_to_the_same_minimum():
    rng = np.random.default_rng(4)
    x = np.linspace(0.0, 2.0, 50)
    y = np.exp(-1.3 * x) + 0.01 * rng.normal(size=50)
    y[10] = 3.0

    def residual(p):
        return np.exp(-p[0] * x) - y

    differenced = problem_of(residual, Parameter("decay", "1", 1.0, 0.0, 5.0))
    given = replace(differenced, jacobian=lambda p: (-x * np.exp(-p[0] * x))[:, None])
    first, second = (solve_huber(problem, solve(problem)) for problem in (differenced, given))
    assert first.solution.x == pytest.approx(second.solution.x, abs=1e-5)
    assert first.solution.x[0] == pytest.approx(1.3, abs=0.02)
    assert spread(first.solution.residual) == pytest.approx(0.01, rel=0.3)
    # At the minimum the clipped residual asks for no step (against 0.003, the standard deviation):
    # the intervals stand around it.
    influence = second.influence
    assert abs(np.linalg.lstsq(influence.jacobian, influence.residual, rcond=None)[0][0]) < 1e-4


def test_data_that_fit_exactly_are_left_alone():
    x = np.linspace(0.0, 1.0, 12)
    result = fit_line(x, 3.0 * x + 1.0, "huber")
    assert result["slope"].value == pytest.approx(3.0, abs=1e-6)
    assert result.facts["outliers"] == 0
