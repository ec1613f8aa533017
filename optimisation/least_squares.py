"""Bounded least squares in `MathematicalProgram`: the only two solvers that the fits use.

- `solve_algebraic`: residuals as slack variables with a quadratic cost, SNOPT, derivatives through AutoDiffXd. For
  residuals that are a formula.
- `solve_rollout`: Levenberg-Marquardt whose step is a bounded least-squares QP (Clarabel). For residuals that come out
  of a simulation, with a Jacobian by finite differences.

`solve_formula` tries the second before the first. All work on value / scale and on a residual that the caller has
divided by its weights. Which one fits where was measured (design section 12).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import (
    ChooseBestSolver,
    ClarabelSolver,
    MakeSolver,
    MathematicalProgram,
    SnoptSolver,
    SolverInterface,
    SolverOptions,
)

from optimisation.errors import FitError
from optimisation.parameters import Parameters

Residual = Callable[[np.ndarray], np.ndarray]
Jacobian = Callable[[np.ndarray], np.ndarray]

_DIFFERENCE = 1e-5
"""Step of one-sided differences, in scales: sqrt(1e-10), for rollouts that repeat to about ten digits."""
_CENTRAL_DIFFERENCE = 5e-4
"""Step of differences to both sides: cube root of 1e-10."""
_DAMPING_LEAST, _DAMPING_FIRST, _DAMPING_MOST = 1e-8, 1.0, 1e20
"""Relative to the square of the least singular value that counts. Least: next to a Gauss-Newton step. First: after a
refused step."""
_FEW_STEPS = 8
_UNSEEN = 1e-9
"""Singular values below this part of the largest do not count: directions that the data do not see."""
_AT_BOUND = 1e-6
"""A step that ends this near a bound, in units of its length, ends on it."""
_PROMISE_TOLERANCE = 1e-8
"""A refused step that promised less than this part of the cost was refused by rounding: the minimum is reached."""
_STEP_TOLERANCE, _COST_TOLERANCE, _GRADIENT_TOLERANCE = 1e-8, 1e-10, 1e-9


@dataclass(frozen=True)
class Problem:
    """A least-squares problem: minimise |residual|^2 / 2 over the free parameters within their bounds.

    Attributes:
        parameters: what may change.
        residual: weighted residual (m) of the unknowns (p) in their units; `FitError` where the model does not exist.
        jacobian: d residual / d unknowns (m x p); finite differences without it.
        batch: residuals of several vectors at once, (k x p) to (k x m), for rollouts that run side by side.
        name: of the fit, for messages.
    """

    parameters: Parameters
    residual: Residual
    jacobian: Jacobian | None = None
    batch: Callable[[np.ndarray], np.ndarray] | None = None
    name: str = "fit"

    def differences(self, x: np.ndarray, at_x: np.ndarray) -> np.ndarray:
        """The Jacobian (m x p): the given one, or one-sided differences that stay within the bounds."""
        if self.jacobian is not None:
            return np.asarray(self.jacobian(x), float)
        steps = _DIFFERENCE * self.parameters.scales
        steps = np.where(x + steps > self.parameters.upper, -steps, steps)
        return ((self._rows(x + np.diag(steps)) - at_x) / steps[:, None]).T

    def central_differences(self, x: np.ndarray) -> np.ndarray:
        """The Jacobian for the covariance (m x p): differences to both sides, one-sided at a bound."""
        if self.jacobian is not None:
            return np.asarray(self.jacobian(x), float)
        steps = _CENTRAL_DIFFERENCE * self.parameters.scales
        up = np.where(x + steps > self.parameters.upper, x, x + steps)
        down = np.where(x - steps < self.parameters.lower, x, x - steps)
        ends = np.concatenate([x + np.diag(up - x), x + np.diag(down - x)])
        rows = self._rows(ends)
        return ((rows[: len(x)] - rows[len(x) :]) / (up - down)[:, None]).T

    def _rows(self, vectors: np.ndarray) -> np.ndarray:
        if self.batch is not None:
            return np.asarray(self.batch(vectors), float)
        return np.array([self.residual(vector) for vector in vectors], float)

    def describe(self, x: np.ndarray) -> str:
        """The unknowns in words."""
        free = self.parameters.free
        return ", ".join(f"{p.name} = {value:.6g} {p.unit}" for p, value in zip(free, x, strict=True))


@dataclass(frozen=True)
class Attempt:
    """What became of one start.

    Attributes:
        start, x: unknowns (p).
        cost: |residual|^2 / 2; infinite when the solver never got a finite one.
        success: the solver met its tolerances.
        status: in the solver's words.
        iterations: steps of Levenberg-Marquardt, or evaluations of the residual by SNOPT.
    """

    start: np.ndarray
    x: np.ndarray
    cost: float
    success: bool
    status: str
    iterations: int


@dataclass(frozen=True)
class Solution:
    """The best attempt, with all others.

    Attributes:
        problem: that was solved.
        x: unknowns (p).
        residual: weighted, at x (m).
        jacobian: of the weighted residual at x (m x p).
        best: the attempt that x is from.
        attempts: one per start, in order.
    """

    problem: Problem
    x: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    best: Attempt
    attempts: tuple[Attempt, ...]


Solver = Callable[[Problem, np.ndarray], Attempt]


def solve(problem: Problem, method: Solver, starts: Sequence[np.ndarray] | None = None) -> Solution:
    """Runs a solver from every start and keeps the lowest cost, successes first.

    Raises:
        FitError: no start gave a finite residual; the message has the reason of each.
    """
    starts = [problem.parameters.seed] if starts is None else list(starts)
    attempts = tuple(method(problem, np.asarray(start, float)) for start in starts)
    best = min(attempts, key=lambda attempt: (not attempt.success, attempt.cost))
    if not np.isfinite(best.cost):
        reasons = "; ".join(dict.fromkeys(attempt.status for attempt in attempts))
        raise FitError(f"{problem.name}: no start of {len(attempts)} could be solved: {reasons}")
    residual = np.asarray(problem.residual(best.x), float)
    return Solution(problem, best.x, residual, problem.central_differences(best.x), best, attempts)


def solve_algebraic(problem: Problem, start: np.ndarray) -> Attempt:
    """Slack residuals with a quadratic cost, solved by SNOPT from one start."""
    evaluations = 0
    scales = problem.parameters.scales
    count = len(scales)

    def defect(z: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        evaluations += 1
        values = z if z.dtype == float else ExtractValue(z)[:, 0]
        x = values[:count] * scales
        r = _finite_residual(problem, x)
        if z.dtype == float:
            return (r - z[count:]) / rows
        gradient = ExtractGradient(z)
        slope = (problem.differences(x, r) * scales) @ gradient[:count] - gradient[count:]
        return InitializeAutoDiff((r - values[count:]) / rows, slope / rows[:, None])[:, 0]

    try:
        first = _finite_residual(problem, start)
        # Rows of very different weight would ask for more digits than there are.
        rows = np.maximum(np.linalg.norm(problem.differences(start, first) * scales, axis=1), 1.0)
        program, guess = _slack_program(problem, defect, start / scales, first)
        result = SnoptSolver().Solve(program, guess, _SNOPT_OPTIONS)
        x = np.clip(result.get_x_val()[:count] * scales, problem.parameters.lower, problem.parameters.upper)
        cost = 0.5 * float(np.sum(np.square(_finite_residual(problem, x))))
    except FitError as error:
        return Attempt(start, start, np.inf, False, str(error), evaluations)
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


def _finite_residual(problem: Problem, x: np.ndarray) -> np.ndarray:
    """The residual; FitError that names the unknowns when it is not finite."""
    r = np.asarray(problem.residual(x), float)
    bad = np.flatnonzero(~np.isfinite(r))
    if bad.size:
        raise FitError(f"the residual is not finite ({r[bad[0]]} in row {bad[0]}) at {problem.describe(x)}")
    return r


def solve_rollout(problem: Problem, start: np.ndarray, most_steps: int = 100) -> Attempt:
    """Levenberg-Marquardt from one start; each step is a bounded least-squares QP.

    A step to where the residual is not finite, or the model does not exist, is shortened like one that raises the cost.
    """
    parameters = problem.parameters
    scales = parameters.scales
    low, high = parameters.lower / scales, parameters.upper / scales
    try:
        r = _finite_residual(problem, start)
    except FitError as error:
        return Attempt(start, start, np.inf, False, str(error), 0)
    z, cost, damping = start / scales, 0.5 * float(r @ r), _DAMPING_LEAST
    refused = ""
    for step in range(1, most_steps + 1):
        try:
            J = problem.differences(z * scales, r) * scales
        except FitError as error:
            return Attempt(start, z * scales, cost, False, f"no derivative: {error}", step)
        if not np.all(np.isfinite(J)):
            status = f"the derivative is not finite at {problem.describe(z * scales)}"
            return Attempt(start, z * scales, cost, False, status, step)
        if _projected_gradient(J.T @ r, z, low, high) <= _GRADIENT_TOLERANCE * max(cost, 1e-300) ** 0.5:
            return Attempt(start, z * scales, cost, True, "the gradient vanishes", step)
        R, c = _triangle(J, r)
        promised = None
        while True:
            dz = _bounded_step(R, c, damping, low - z, high - z)
            if promised is None:
                promised = 0.5 * float(c @ c) - 0.5 * float(np.sum(np.square(R @ dz + c)))
            tried, status = _try(problem, (z + dz) * scales)
            new_cost = np.inf if tried is None else 0.5 * float(tried @ tried)
            refused = status or refused
            if tried is not None and new_cost <= cost:
                break
            damping = max(10.0 * damping, _DAMPING_FIRST)
            if promised <= _PROMISE_TOLERANCE * cost:
                return Attempt(start, z * scales, cost, True, "the next step promises nothing", step)
            if np.linalg.norm(dz) <= _STEP_TOLERANCE * (1.0 + np.linalg.norm(z)):
                return Attempt(start, z * scales, cost, False, refused or "no smaller cost nearby", step)
            if damping > _DAMPING_MOST:
                return Attempt(start, z * scales, cost, False, refused or "no step lowers the cost", step)
        drop, z, r, cost = cost - new_cost, z + dz, tried, new_cost
        damping = max(0.01 * damping, _DAMPING_LEAST)
        if drop <= _COST_TOLERANCE * cost or np.linalg.norm(dz) <= _STEP_TOLERANCE * (1.0 + np.linalg.norm(z)):
            return Attempt(start, z * scales, cost, True, "cost and step have settled", step)
    return Attempt(start, z * scales, cost, False, f"{most_steps} steps were not enough", most_steps)


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


def _try(problem: Problem, x: np.ndarray) -> tuple[np.ndarray | None, str]:
    try:
        return _finite_residual(problem, x), ""
    except FitError as error:
        return None, str(error)


def _triangle(J: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R and c with |J d + r|^2 = |R d + c|^2 + constant, R square: the QP does not grow with the data."""
    Q, R = np.linalg.qr(J)
    return R, Q.T @ r


def _bounded_step(R: np.ndarray, c: np.ndarray, damping: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The step that minimises |R d + c|^2 + damping s^2 |d|^2 within low <= d <= high, s the least singular value of R.

    The QP is posed in e = T d / size with T'T the Hessian and `size` the length of the free step: its own Hessian is
    then the identity, however differently the rows are weighted and however small the last steps are. Only where a
    bound cuts the free step is the interior-point solver needed; it says which bounds hold, and the rest is solved
    again exactly.
    """
    sizes = np.linalg.svd(R, compute_uv=False)
    least = float(sizes[sizes > _UNSEEN * sizes[0]][-1]) if sizes[0] > 0.0 else 1.0
    D = damping**0.5 * least * np.eye(len(low))
    A, b = np.vstack([R, D]), np.concatenate([c, np.zeros(len(D))])
    Q, T = np.linalg.qr(A)
    free = -(Q.T @ b)
    size = float(np.linalg.norm(free)) or 1.0
    inverse = np.linalg.inv(T) * size
    program = MathematicalProgram()
    e = program.NewContinuousVariables(len(low), "e")
    program.AddQuadraticCost(np.eye(len(low)), -free / size, e, True)
    step = inverse @ _free_solver().Solve(program, None, None).get_x_val()
    if np.all((low <= step) & (step <= high)):
        return step
    reach = np.linalg.norm(inverse, axis=1)
    program.AddLinearConstraint(inverse / reach[:, None], low / reach, high / reach, e)
    step = inverse @ ClarabelSolver().Solve(program, None, None).get_x_val()
    step = np.where(step - low < _AT_BOUND * reach, low, step)
    step = np.clip(np.where(high - step < _AT_BOUND * reach, high, step), low, high)
    inside = (step > low) & (step < high)
    exact = step.copy()
    exact[inside] = np.linalg.lstsq(A[:, inside], -(b + A[:, ~inside] @ step[~inside]), rcond=None)[0]
    return exact if np.all((low <= exact) & (exact <= high)) else step


@cache
def _free_solver() -> SolverInterface:
    """What Drake chooses for a QP without inequalities: closed form."""
    program = MathematicalProgram()
    program.AddQuadraticCost(np.eye(1), np.zeros(1), program.NewContinuousVariables(1), True)
    return MakeSolver(ChooseBestSolver(program))


def _projected_gradient(gradient: np.ndarray, z: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Largest slope along which the bounds let z move."""
    free = gradient.copy()
    free[(z <= low) & (gradient > 0.0)] = 0.0
    free[(z >= high) & (gradient < 0.0)] = 0.0
    return float(np.max(np.abs(free)))
