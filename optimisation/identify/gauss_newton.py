"""The solver of every fit: Levenberg-Marquardt whose step is a quadratic program.

Each step solves min |R d + c|^2 / 2 + damping |d|^2 / 2 with the costs and constraints of the
`FitProgram`. A step that raises the cost is bent by the curvature that the residual showed there
(second-order correction), then shortened by damping. `README.md` has what else was tried.

It works on value / scale and on a residual that the caller has divided by its weights.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from aerodima.optimisation.identify.fit_program import FitProgram, LinearTerms, as_program
from aerodima.optimisation.identify.least_squares import Problem, Solution, StartResult
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.deprecation import renamed
from aerodima.workbench.core.errors import FitError

Ending = tuple[bool, str]
"""Success of the solver, and the reason why it ended."""
_MIN_DAMPING = 1e-8
"""Least damping, relative to the square of the least singular value that counts; the step is then
almost a Gauss-Newton step."""
_FIRST_DAMPING = 1.0
"""Damping after a refused step."""
_MAX_DAMPING = 1e20
"""Damping beyond which a solution is given up."""
_UNIDENTIFIABLE = 1e-9
"""Share of the largest singular value below which a singular value does not count, since its
direction is unidentifiable."""
_AT_BOUND = 1e-6
"""Distance from a bound, in lengths of the step, within which a step ends on the bound."""
_DECREASE_TOLERANCE = 1e-8
"""Predicted decrease, as a share of the cost, below which a step was refused because of rounding:
the minimum is reached."""
_KINK_TOLERANCE = 1e-4
"""The same where no step, however short, lowers the cost: the minimum is a kink of the
model (jet edge, node of a table)."""
_STEP_TOLERANCE = 1e-8
"""Share of the scaled unknowns below which a step is short."""
_COST_TOLERANCE = 1e-10
"""Decrease, as a share of the cost, below which the cost has settled."""
_GRADIENT_TOLERANCE = 1e-9
"""Ratio of the gradient to the root of the cost below which the gradient vanishes."""
_SAME_COST = 1.01
"""Factor within which costs belong to the same minimum."""
_SLOW = 0.5
"""A kept Jacobian is out of date when the last step lowered the cost by less than half of what it
predicted, and the next one predicts more than this part of that."""
_POOR = 3.0
"""Mean square of a residual above which no kept Jacobian is trusted to end a fit."""


@dataclass(frozen=True)
class SolverOptions:
    """Options of the solver.

    Attributes:
        max_steps: largest number of steps.
        jacobian: source of the Jacobian: `differences` takes it anew in every step; `secant`
            carries it on by Broyden's update, for residuals that cost seconds.
        settled: decrease of the cost below which the next step, by its prediction, ends the fit.
        roughness: amount by which a step may raise the cost; like `settled` in units of half a
            squared standard deviation, or of the mean square of the residual where that is above 1.
        reweigh: function that is called with the unknowns (p) before every step; returns the
            factors (m) by which the divisors of the residual grow there and from there on.
    """

    max_steps: int = 100
    jacobian: Literal["differences", "secant"] = "differences"
    settled: float = 0.0
    roughness: float = 0.0
    reweigh: Callable[[FloatArray], FloatArray] | None = None


DEFAULT = SolverOptions()


def solve(problem: Problem | FitProgram, starts: Sequence[FloatArray] | None = None) -> Solution:
    """Solve from every start and keep the lowest cost; of costs within 1 % that of a success.

    Args:
        problem: problem to solve, or its program with added terms.
        starts: vectors of the unknowns to start from (p); the initial values by default.

    Raises:
        FitError: no start gave a finite residual; the message has the reason of each.
    """
    program = as_program(problem)
    problem = program.problem
    starts = [problem.parameters.initial] if starts is None else starts
    attempts = tuple(solve_from(program, np.asarray(start, float)) for start in starts)
    best = best_start(attempts)
    if not np.isfinite(best.cost):
        reasons = "; ".join(dict.fromkeys(attempt.status for attempt in attempts))
        raise FitError(f"{problem.name}: no start of {len(attempts)} could be solved: {reasons}")
    residual = problem.finite_residual(best.x)
    return Solution(problem, best.x, residual, problem.central_jacobian(best.x), best, attempts)


def best_start(results: Sequence[StartResult]) -> StartResult:
    """Choose the result of lowest cost; of costs within 1 % that of a success."""
    least = min(result.cost for result in results)
    same = _SAME_COST * least if least >= 0.0 else least / _SAME_COST  # added costs may be negative
    near = [result for result in results if result.cost <= same]
    return min(near, key=lambda result: (not result.success, result.cost), default=results[0])


def solve_from(
    problem: Problem | FitProgram, start: FloatArray, options: SolverOptions = DEFAULT
) -> StartResult:
    """Solve from one start (p)."""
    return _Descent(as_program(problem), options).run(start)


class _Descent:
    """State of the descent from one start; vectors are in unknowns / scales."""

    def __init__(self, program: FitProgram, options: SolverOptions) -> None:
        parameters = program.problem.parameters
        self.problem = program.problem
        self.options = options
        self.scales = parameters.scales
        self.lower = parameters.lower / self.scales
        self.upper = parameters.upper / self.scales
        self.terms = program.linear_terms().scaled(self.scales)
        self.damping = _MIN_DAMPING
        self.J: FloatArray | None = None
        self.kept = False
        self.predicted = np.inf
        self.z = np.zeros(0)
        self.r = np.zeros(0)
        self.cost = np.inf
        self.refusal = ""

    def run(self, start: FloatArray) -> StartResult:
        """Step from a start (p) until the fit settles or cannot go on."""
        try:
            self.z = start / self.scales
            if len(self.terms.rows):
                self.z = self._feasible(self.z)
            self.r = self.problem.finite_residual(self.z * self.scales)
        except FitError as error:
            return StartResult(start, start, np.inf, False, str(error), 0)
        self.cost = self._cost(self.z, self.r)
        ending: Ending | None = None
        step = 0
        while ending is None and step < self.options.max_steps:
            step += 1
            try:
                ending = self._step()
            except FitError as error:
                ending = False, str(error)
        success, status = ending or (False, f"{step} steps were not enough")
        jacobian = None if self.J is None else self.J / self.scales
        x = self.z * self.scales
        added = self.terms.cost(self.z)
        return StartResult(start, x, self.cost, success, status, step, jacobian, added)

    def _feasible(self, z: FloatArray) -> FloatArray:
        """Find the nearest point that meets the constraints."""
        count = len(z)
        terms = self.terms.about(z)
        terms = replace(terms, factor=terms.factor[:0], slope=0.0 * terms.slope)  # without costs
        bounds = (self.lower - z, self.upper - z)
        return z + bounded_step(np.eye(count), np.zeros(count), 0.0, *bounds, terms)

    @property
    def _size(self) -> float:
        """Size of the cost; added costs may be negative."""
        return max(self.cost, 0.5 * float(self.r @ self.r))

    def _cost(self, z: FloatArray, r: FloatArray) -> float:
        return 0.5 * float(r @ r) + self.terms.cost(z)

    def _step(self) -> Ending | None:
        """Take one step, or drop an outdated Jacobian; return the ending once there is one."""
        if self.options.reweigh is not None:
            self._divide(self.options.reweigh(self.z * self.scales))
        if self.J is None:
            self.J = self.problem.forward_jacobian(self.z * self.scales, self.r) * self.scales
            self.kept = False
            self.predicted = np.inf
        terms = self.terms.about(self.z)
        gradient = self.J.T @ self.r + terms.slope
        if self._free_gradient(gradient) <= _GRADIENT_TOLERANCE * max(self._size, 1e-300) ** 0.5:
            return True, "the gradient vanishes"
        Q, R = np.linalg.qr(self.J)
        c = Q.T @ self.r
        bounds = (self.lower - self.z, self.upper - self.z)
        d = bounded_step(R, c, self.damping, *bounds, terms)
        left = float(np.sum(np.square(R @ d + c)))
        predicted = 0.5 * float(c @ c) - 0.5 * left - terms.cost(d)
        mean_square = float(self.r @ self.r) / len(self.r)
        unit = max(mean_square, 1.0)
        settled = predicted <= self.options.settled * unit
        if self.kept and ((settled and mean_square > _POOR) or predicted > _SLOW * self.predicted):
            self.J = None
            return None
        if settled:
            return True, "the next step is small against the intervals"
        limit = self.cost + self.options.roughness * unit
        first = d
        while True:
            trial = self._evaluate(d)
            if trial is not None and not self.kept and not self._lowers(d, trial, limit):
                # Bend the step by the curvature of the residual along it.
                bent = bounded_step(R, Q.T @ trial - R @ d, self.damping, *bounds, terms)
                refusal = self.refusal
                bent_trial = self._evaluate(bent)
                self.refusal = refusal
                if self._lowers(bent, bent_trial, limit):
                    d, trial = bent, bent_trial
            if trial is not None and self._lowers(d, trial, limit):
                return self._accept(d, trial, predicted, d is first)
            if self.kept:
                self.J = None
                return None
            ending = self._shorten(d, predicted)
            if ending is not None:
                return ending
            d = bounded_step(R, c, self.damping, *bounds, terms)

    def _divide(self, factors: FloatArray) -> None:
        """Divide residual and Jacobian by factors (m)."""
        self.r = self.r / factors
        self.cost = self._cost(self.z, self.r)
        if self.J is not None:
            self.J = self.J / factors[:, None]

    def _evaluate(self, d: FloatArray) -> FloatArray | None:
        """Compute the residual after a step; where the model ends, keep the reason, return None."""
        try:
            return self.problem.finite_residual((self.z + d) * self.scales)
        except FitError as error:
            self.refusal = str(error)
            return None

    def _lowers(self, d: FloatArray, r: FloatArray | None, limit: float) -> bool:
        """Tell whether the cost after a step is within the limit."""
        return r is not None and self._cost(self.z + d, r) <= limit

    def _shorten(self, d: FloatArray, predicted: float) -> Ending | None:
        """Raise the damping after a refused step; return the ending when that is of no use."""
        self.damping = max(10.0 * self.damping, _FIRST_DAMPING)
        if predicted <= _DECREASE_TOLERANCE * self._size:
            return True, "the next step predicts no decrease"
        if self._is_short(d):
            settled = not self.refusal and predicted <= _KINK_TOLERANCE * self._size
            return settled, self.refusal or "no smaller cost nearby"
        if self.damping > _MAX_DAMPING:
            return False, self.refusal or "no step lowers the cost"
        return None

    def _accept(self, d: FloatArray, r: FloatArray, predicted: float, whole: bool) -> Ending | None:
        """Go to z + d with its residual; return the ending when cost or step has settled."""
        assert self.J is not None
        cost = self._cost(self.z + d, r)
        decrease = self.cost - cost
        secant = whole and self.options.jacobian == "secant"
        if secant and decrease > 0.5 * predicted > 0.5 * self.options.roughness:
            missed = r - self.r - self.J @ d
            self.J = self.J + np.outer(missed, d) / (d @ d)
        elif not secant:
            self.J = None
        self.kept = True
        self.predicted = predicted if decrease < 0.5 * predicted else np.inf
        self.z = self.z + d
        self.r = r
        self.cost = cost
        self.refusal = ""
        self.damping = max(0.01 * self.damping, _MIN_DAMPING)
        exact = self.options.roughness == 0.0
        if exact and (decrease <= _COST_TOLERANCE * self._size or self._is_short(d)):
            return True, "cost and step have settled"
        return None

    def _is_short(self, d: FloatArray) -> bool:
        """Tell whether a step is small against the unknowns."""
        return bool(np.linalg.norm(d) <= _STEP_TOLERANCE * (1.0 + np.linalg.norm(self.z)))

    def _free_gradient(self, gradient: FloatArray) -> float:
        """Find the largest slope along which the bounds let z move."""
        held_low = (self.z <= self.lower) & (gradient > 0.0)
        held_high = (self.z >= self.upper) & (gradient < 0.0)
        return float(np.max(np.abs(np.where(held_low | held_high, 0.0, gradient))))


def bounded_step(
    R: FloatArray,
    c: FloatArray,
    damping: float,
    low: FloatArray,
    high: FloatArray,
    terms: LinearTerms,
) -> FloatArray:
    """Find the step d (n) of least |R d + c|^2 / 2 + damping s^2 |d|^2 / 2 plus costs of `terms`.

    R is (k, n), c is (k), low and high are (n), s is the least singular value of R that counts. The
    step lies within low <= d <= high and meets the constraints of `terms`.

    The QP is posed in e = T d / size with T'T the Hessian and `size` the length of the free step:
    its own Hessian is then the identity, however differently the rows are weighted and however
    small the last steps are. Only where a bound cuts the free step is the interior-point solver
    needed; it says which bounds hold, and the others are solved again exactly.
    """
    sizes = np.linalg.svd(R, compute_uv=False)
    least = 1.0
    if sizes[0] > 0.0:
        least = float(sizes[sizes > _UNIDENTIFIABLE * sizes[0]][-1])
    count = len(low)
    D = damping**0.5 * least * np.eye(count)
    A = np.vstack([R, D, terms.factor])
    b = np.concatenate([c, np.zeros(len(A) - len(c))])
    Q, T = np.linalg.qr(A)
    free = -(Q.T @ b) - np.linalg.solve(T.T, terms.slope)
    size = float(np.linalg.norm(free)) or 1.0
    inverse = np.linalg.inv(T) * size
    step = inverse @ (free / size)
    if not len(terms.rows) and np.all((low <= step) & (step <= high)):
        return step
    program = MathematicalProgram()
    e = program.NewContinuousVariables(count, "e")
    program.AddQuadraticCost(np.eye(count), -free / size, e, True)
    reach = np.linalg.norm(inverse, axis=1)
    program.AddLinearConstraint(inverse / reach[:, None], low / reach, high / reach, e)
    if len(terms.rows):
        program.AddLinearConstraint(terms.rows @ inverse, terms.lower, terms.upper, e)
    result = ClarabelSolver().Solve(program, None, None)
    if len(terms.rows) and not result.is_success():
        raise FitError("no values meet the bounds and the added constraints")
    step = inverse @ result.get_x_val()
    step = np.where(step - low < _AT_BOUND * reach, low, step)
    step = np.clip(np.where(high - step < _AT_BOUND * reach, high, step), low, high)
    if terms.present:
        return step
    return _exact_inside(A, b, step, low, high)


def _exact_inside(
    A: FloatArray, b: FloatArray, step: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Solve min |A d + b| again for the parts of an interior-point step (n) within their bounds."""
    inside = (step > low) & (step < high)
    at_bounds = b + A[:, ~inside] @ step[~inside]
    exact = step.copy()
    exact[inside], *_ = np.linalg.lstsq(A[:, inside], -at_bounds, rcond=None)
    if np.all((low <= exact) & (exact <= high)):
        return exact
    return step


solve_rollout = renamed("solve_rollout", solve_from)
"""Deprecated alias of `solve_from`."""
solve_formula = renamed("solve_formula", solve_from)
"""Deprecated alias of `solve_from`."""
