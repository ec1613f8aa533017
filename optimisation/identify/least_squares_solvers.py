"""Bounded least squares in `MathematicalProgram`: the only two solvers that the fits use.

- `solve_rollout`: Levenberg-Marquardt whose step is a bounded least-squares QP (Clarabel). For
  residuals that come out of a simulation, with a Jacobian by finite differences.
- `solve_algebraic`: residuals as slack variables with a quadratic cost, SNOPT, derivatives through
  AutoDiffXd. For residuals that are a formula. `solve_formula` tries the first before it.

All work on value / scale and on a residual that the caller has divided by its weights. Which one
fits where was measured (design section 12).
"""

from __future__ import annotations

from functools import cache

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

from aerodima.optimisation.identify.least_squares import (
    Attempt,
    Problem,
    Residual,
    finite_differences,
    finite_residual,
)
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import FitError

_DAMPING_LEAST = 1e-8
"""Least damping, relative to the square of the least singular value that counts: next to a
Gauss-Newton step."""
_DAMPING_FIRST = 1.0
"""Damping after a refused step."""
_DAMPING_MOST = 1e20
"""Damping beyond which a solution is given up."""
_UNIDENTIFIABLE = 1e-9
"""Singular values below this part of the largest do not count: unidentifiable directions."""
_AT_BOUND = 1e-6
"""A step that ends this near a bound, in units of its length, ends on it."""
_PROMISE_TOLERANCE = 1e-8
"""A refused step that promised less than this part of the cost was refused by rounding: the minimum
is reached."""
_KINK_TOLERANCE = 1e-4
"""The same where no step, however short, lowers the cost: the minimum is a kink of the
model (jet edge, node of a table)."""
_STEP_TOLERANCE = 1e-8
"""A step below this part of the scaled unknowns is short."""
_COST_TOLERANCE = 1e-10
"""A step that lowers the cost by less than this part has settled."""
_GRADIENT_TOLERANCE = 1e-9
"""Slope over the root of the cost below which the gradient vanishes."""
_FEW_STEPS = 8
"""Gauss-Newton steps before SNOPT takes over."""


def solve_rollout(problem: Problem, start: FloatArray, most_steps: int = 100) -> Attempt:
    """Levenberg-Marquardt from one start; each step is a bounded least-squares QP.

    A step to where the residual is not finite, or the model does not exist, is shortened like one
    that raises the cost.
    """
    parameters = problem.parameters
    scales = parameters.scales
    low = parameters.lower / scales
    high = parameters.upper / scales
    try:
        r = finite_residual(problem, start)
    except FitError as error:
        return Attempt(start, start, np.inf, False, str(error), 0)
    z = start / scales
    cost = 0.5 * float(r @ r)
    damping = _DAMPING_LEAST
    refused = ""
    for step in range(1, most_steps + 1):
        x = z * scales
        try:
            J = finite_differences(problem, x, r) * scales
        except FitError as error:
            return Attempt(start, x, cost, False, f"no derivative: {error}", step)
        slope = _projected_gradient(J.T @ r, z, low, high)
        if slope <= _GRADIENT_TOLERANCE * max(cost, 1e-300) ** 0.5:
            return Attempt(start, x, cost, True, "the gradient vanishes", step)
        R, c = triangle(J, r)
        promised = None
        while True:
            dz = bounded_step(R, c, damping, low - z, high - z)
            if promised is None:
                left = float(np.sum(np.square(R @ dz + c)))
                promised = 0.5 * float(c @ c) - 0.5 * left
            tried, status = _try(problem, (z + dz) * scales)
            new_cost = np.inf if tried is None else 0.5 * float(tried @ tried)
            refused = status or refused
            if tried is not None and new_cost <= cost:
                break
            damping = max(10.0 * damping, _DAMPING_FIRST)
            if promised <= _PROMISE_TOLERANCE * cost:
                return Attempt(start, x, cost, True, "the next step promises nothing", step)
            if _is_short(dz, z):
                settled = not refused and promised <= _KINK_TOLERANCE * cost
                reason = refused or "no smaller cost nearby"
                return Attempt(start, x, cost, settled, reason, step)
            if damping > _DAMPING_MOST:
                reason = refused or "no step lowers the cost"
                return Attempt(start, x, cost, False, reason, step)
        drop = cost - new_cost
        z = z + dz
        r = tried
        cost = new_cost
        damping = max(0.01 * damping, _DAMPING_LEAST)
        if drop <= _COST_TOLERANCE * cost or _is_short(dz, z):
            return Attempt(start, z * scales, cost, True, "cost and step have settled", step)
    reason = f"{most_steps} steps were not enough"
    return Attempt(start, z * scales, cost, False, reason, most_steps)


def _is_short(dz: FloatArray, z: FloatArray) -> bool:
    """Whether a step is small against the unknowns."""
    return bool(np.linalg.norm(dz) <= _STEP_TOLERANCE * (1.0 + np.linalg.norm(z)))


def _try(problem: Problem, x: FloatArray) -> tuple[FloatArray | None, str]:
    try:
        return finite_residual(problem, x), ""
    except FitError as error:
        return None, str(error)


def triangle(J: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R (n, n) and c (n) of J (m, n) and r (m): |J d + r|^2 is |R d + c|^2 and a constant.

    The QP stays small.
    """
    Q, R = np.linalg.qr(J)
    return R, Q.T @ r


def bounded_step(
    R: FloatArray, c: FloatArray, damping: float, low: FloatArray, high: FloatArray
) -> FloatArray:
    """The step d (n) that minimises |R d + c|^2 + damping s^2 |d|^2 within low <= d <= high.

    R is (n, n), c, low and high are (n), and s is the least singular value of R.

    The QP is posed in e = T d / size with T'T the Hessian and `size` the length of the free step:
    its own Hessian is then the identity, however differently the rows are weighted and however
    small the last steps are. Only where a bound cuts the free step is the interior-point solver
    needed; it says which bounds hold, and the rest is solved again exactly.
    """
    sizes = np.linalg.svd(R, compute_uv=False)
    if sizes[0] > 0.0:
        least = float(sizes[sizes > _UNIDENTIFIABLE * sizes[0]][-1])
    else:
        least = 1.0
    count = len(low)
    identity = np.eye(count)
    D = damping**0.5 * least * identity
    A = np.vstack([R, D])
    b = np.concatenate([c, np.zeros(len(D))])
    Q, T = np.linalg.qr(A)
    free = -(Q.T @ b)
    size = float(np.linalg.norm(free)) or 1.0
    inverse = np.linalg.inv(T) * size
    program = MathematicalProgram()
    e = program.NewContinuousVariables(count, "e")
    program.AddQuadraticCost(identity, -free / size, e, True)
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
    rest = -(b + A[:, ~inside] @ step[~inside])
    solution, *_ = np.linalg.lstsq(A[:, inside], rest, rcond=None)
    exact[inside] = solution
    if np.all((low <= exact) & (exact <= high)):
        return exact
    return step


@cache
def _free_solver() -> SolverInterface:
    """What Drake chooses for a QP without inequalities: closed form."""
    program = MathematicalProgram()
    x = program.NewContinuousVariables(1)
    program.AddQuadraticCost(np.eye(1), np.zeros(1), x, True)
    return MakeSolver(ChooseBestSolver(program))


def _projected_gradient(
    gradient: FloatArray, z: FloatArray, low: FloatArray, high: FloatArray
) -> float:
    """Largest slope along which the bounds let z move."""
    free = gradient.copy()
    free[(z <= low) & (gradient > 0.0)] = 0.0
    free[(z >= high) & (gradient < 0.0)] = 0.0
    return float(np.max(np.abs(free)))


def solve_formula(problem: Problem, start: FloatArray) -> Attempt:
    """Few bounded Gauss-Newton steps, and SNOPT where they do not settle: for formulas that are
    nearly linear.

    On static holds nine of ten settle in five steps, which takes a third of SNOPT's time; in the
    others the weight of the speed makes a bent valley that only SNOPT follows.
    """
    attempt = solve_rollout(problem, start, _FEW_STEPS)
    if attempt.success:
        return attempt
    other = solve_algebraic(problem, start)
    if (not other.success, other.cost) <= (True, attempt.cost):
        return other
    return attempt


def solve_algebraic(problem: Problem, start: FloatArray) -> Attempt:
    """Slack residuals with a quadratic cost, solved by SNOPT from one start."""
    evaluations = 0
    broken = ""
    parameters = problem.parameters
    scales = parameters.scales
    count = len(scales)

    def defect(z: np.ndarray) -> np.ndarray:
        nonlocal evaluations, broken
        evaluations += 1
        plain = z.dtype == float
        values = z if plain else ExtractValue(z)[:, 0]
        x = values[:count] * scales
        try:
            r = finite_residual(problem, x)
            J = np.zeros(0) if plain else finite_differences(problem, x, r)
        except FitError as error:
            broken = str(error)
            raise
        off = (r - values[count:]) / rows
        if plain:
            return off
        gradient = ExtractGradient(z)
        slope = (J * scales) @ gradient[:count] - gradient[count:]
        return InitializeAutoDiff(off, slope / rows[:, None])[:, 0]

    try:
        first = finite_residual(problem, start)
        # Rows of very different weight would ask for more digits than there are.
        J = finite_differences(problem, start, first) * scales
        rows = np.maximum(np.linalg.norm(J, axis=1), 1.0)
        program, guess = _slack_program(problem, defect, start / scales, first)
        result = SnoptSolver().Solve(program, guess, _SNOPT_OPTIONS)
        unknowns = result.get_x_val()[:count] * scales
        x = np.clip(unknowns, parameters.lower, parameters.upper)
        residual = finite_residual(problem, x)
        cost = 0.5 * float(np.sum(np.square(residual)))
    except FitError as error:
        return Attempt(start, start, np.inf, False, str(error), evaluations)
    except RuntimeError:  # Drake's, of what broke within SNOPT
        if not broken:
            raise
        return Attempt(start, start, np.inf, False, broken, evaluations)
    status = f"SNOPT: {result.get_solution_result().name}"
    return Attempt(start, x, cost, bool(result.is_success()), status, evaluations)


def _options() -> SolverOptions:
    options = SolverOptions()
    snopt = SnoptSolver.id()
    options.SetOption(snopt, "Major optimality tolerance", 1e-7)
    options.SetOption(snopt, "Major feasibility tolerance", 1e-9)
    options.SetOption(snopt, "Major step limit", 10.0)
    return options


_SNOPT_OPTIONS = _options()


def _slack_program(
    problem: Problem,
    defect: Residual,
    z: FloatArray,
    residual: FloatArray,
) -> tuple[MathematicalProgram, FloatArray]:
    """The program in (unknown / scale, slack) and its initial guess."""
    parameters = problem.parameters
    scales = parameters.scales
    low = parameters.lower / scales
    high = parameters.upper / scales
    rows = len(residual)
    program = MathematicalProgram()
    unknowns = program.NewContinuousVariables(len(z), "x")
    slacks = program.NewContinuousVariables(rows, "r")
    program.AddBoundingBoxConstraint(low, high, unknowns)
    zero = np.zeros(rows)
    program.AddConstraint(defect, zero, zero, np.concatenate([unknowns, slacks]))
    program.AddQuadraticCost(np.eye(rows), zero, slacks, True)
    return program, np.concatenate([z, residual])
