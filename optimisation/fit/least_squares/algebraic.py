"""Residuals that are a formula: SNOPT on slack residuals, derivatives through AutoDiffXd."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from aerodima.optimisation.fit.fit_errors import FitError
from aerodima.optimisation.fit.least_squares.levenberg_marquardt import solve_rollout
from aerodima.optimisation.fit.least_squares.problem import Attempt, Problem, finite_differences, finite_residual

_FEW_STEPS = 8


def solve_formula(problem: Problem, start: np.ndarray) -> Attempt:
    """Few bounded Gauss-Newton steps, and SNOPT where they do not settle: for formulas that are nearly linear.

    On static holds nine of ten settle in five steps, which takes a third of SNOPT's time; in the others the weight of
    the speed makes a bent valley that only SNOPT follows.
    """
    attempt = solve_rollout(problem, start, _FEW_STEPS)
    if attempt.success:
        return attempt
    other = solve_algebraic(problem, start)
    return other if (not other.success, other.cost) <= (True, attempt.cost) else attempt


def solve_algebraic(problem: Problem, start: np.ndarray) -> Attempt:
    """Slack residuals with a quadratic cost, solved by SNOPT from one start."""
    evaluations, broken = 0, ""
    scales = problem.parameters.scales
    count = len(scales)

    def defect(z: np.ndarray) -> np.ndarray:
        nonlocal evaluations, broken
        evaluations += 1
        values = z if z.dtype == float else ExtractValue(z)[:, 0]
        x = values[:count] * scales
        try:
            r = finite_residual(problem, x)
            J = np.zeros(0) if z.dtype == float else finite_differences(problem, x, r)
        except FitError as error:
            broken = str(error)
            raise
        if z.dtype == float:
            return (r - z[count:]) / rows
        gradient = ExtractGradient(z)
        slope = (J * scales) @ gradient[:count] - gradient[count:]
        return InitializeAutoDiff((r - values[count:]) / rows, slope / rows[:, None])[:, 0]

    try:
        first = finite_residual(problem, start)
        # Rows of very different weight would ask for more digits than there are.
        rows = np.maximum(np.linalg.norm(finite_differences(problem, start, first) * scales, axis=1), 1.0)
        program, guess = _slack_program(problem, defect, start / scales, first)
        result = SnoptSolver().Solve(program, guess, _SNOPT_OPTIONS)
        x = np.clip(result.get_x_val()[:count] * scales, problem.parameters.lower, problem.parameters.upper)
        cost = 0.5 * float(np.sum(np.square(finite_residual(problem, x))))
    except FitError as error:
        return Attempt(start, start, np.inf, False, str(error), evaluations)
    except RuntimeError:  # Drake's, of what broke within SNOPT
        if not broken:
            raise
        return Attempt(start, start, np.inf, False, broken, evaluations)
    details: Any = result.get_solver_details()
    info = details.info
    status = f"SNOPT info {info}: {_SNOPT_WORDS.get(info, 'see its manual')}"
    return Attempt(start, x, cost, bool(result.is_success()), status, evaluations)


_SNOPT_WORDS = {
    1: "optimality conditions satisfied",
    3: "requested accuracy could not be achieved",
    13: "nonlinear infeasibilities minimised",
    31: "iteration limit",
    32: "major iteration limit",
    41: "current point cannot be improved",
}


def _options() -> SolverOptions:
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major optimality tolerance", 1e-7)
    options.SetOption(SnoptSolver.id(), "Major feasibility tolerance", 1e-9)
    options.SetOption(SnoptSolver.id(), "Major step limit", 10.0)
    return options


_SNOPT_OPTIONS = _options()


def _slack_program(
    problem: Problem, defect: Callable[[np.ndarray], np.ndarray], z: np.ndarray, residual: np.ndarray
) -> tuple[MathematicalProgram, np.ndarray]:
    """The program in (unknown / scale, slack) and its initial guess."""
    parameters, scales = problem.parameters, problem.parameters.scales
    program = MathematicalProgram()
    unknowns = program.NewContinuousVariables(len(z), "x")
    slacks = program.NewContinuousVariables(len(residual), "r")
    program.AddBoundingBoxConstraint(parameters.lower / scales, parameters.upper / scales, unknowns)
    zero = np.zeros(len(residual))
    program.AddConstraint(defect, zero, zero, np.concatenate([unknowns, slacks]))
    program.AddQuadraticCost(np.eye(len(residual)), zero, slacks, True)
    return program, np.concatenate([z, residual])
