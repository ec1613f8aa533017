"""Huber's loss: quadratic within a limit and linear beyond it, so that a few wild values do not
decide a fit.

The limit is in units of a scale that is taken from the data: 1.4826 times the median deviation of
the residual, which is the standard deviation of normal data however far off a minority lies.
"""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from scipy import special

from aerodima.optimisation.identify.gauss_newton import solve
from aerodima.optimisation.identify.least_squares import Problem, Solution
from aerodima.workbench.core.array_types import FloatArray

Loss = Literal["squares", "huber"]
LIMIT = 1.345
"""Limit of the squares, in standard deviations: 95 % efficient on normal data."""
_NORMAL = 1.4826
"""Ratio of the standard deviation of normal data to its median deviation."""
_SETTLED = 0.05
"""Relative change of the scale below which it has settled."""
_MAX_SCALES = 4
"""Largest number of fits, each with the scale taken anew."""
_OUTLIER = 3.0
"""Size of a residual, in scales, above which it is reported as an outlier."""


def huber(residual: FloatArray, limit: float = LIMIT) -> FloatArray:
    """Bend residuals (m) so that their squares are twice the Huber loss: unchanged within the
    limit, growing like a root beyond it.
    """
    return np.asarray(np.sign(residual) * np.sqrt(2.0 * special.huber(limit, residual)))


def huber_weight(size: FloatArray) -> FloatArray:
    """Compute weights of samples from their sizes (m): 1 up to the limit, limit / size beyond."""
    return LIMIT / np.maximum(np.abs(size), LIMIT)


def spread(values: FloatArray) -> float:
    """Compute the robust standard deviation: 1.4826 times the median deviation from the median."""
    return _NORMAL * float(np.median(np.abs(values - np.median(values))))


def clip(residual: FloatArray, scale: float) -> tuple[FloatArray, float]:
    """Clip a residual (m) at the limit of a scale; also compute the share that lies within."""
    limit = LIMIT * scale
    return np.clip(residual, -limit, limit), float(np.mean(np.abs(residual) <= limit))


class HuberSolution(NamedTuple):
    """A solution under Huber's loss.

    Attributes:
        solution: robust x, with residual and Jacobian of the problem as it was given; its attempts
            end with the robust one.
        influence: same x with the clipped residual, and the Jacobian times the share of the
            residuals within the limit: J^+ S J^+' of it is Huber's asymptotic covariance.
        outliers: number of residuals beyond three scales.
    """

    solution: Solution
    influence: Solution
    outliers: int


def solve_huber(problem: Problem, squares: Solution) -> HuberSolution:
    """Minimise Huber's loss, starting at the least-squares solution; the scale is taken anew until
    it settles.

    Raises:
        FitError: no finite residual on the way.
    """
    scale = spread(squares.residual)
    # Residuals that vanish (fewer rows than unknowns, exact data) have no outliers.
    least = 1e-9 * max(float(np.max(np.abs(squares.residual))), 1e-300)
    if scale <= least:
        return HuberSolution(squares, squares, 0)
    x = squares.x
    for _ in range(_MAX_SCALES):
        best = solve(huberised(problem, scale), [x]).best
        x = best.x
        residual = problem.finite_residual(x)
        before = scale
        scale = max(spread(residual), least)
        if abs(scale - before) <= _SETTLED * before:
            break
    best = replace(best, status=f"Huber: {best.status}")
    attempts = (*squares.attempts, best)
    solution = Solution(problem, x, residual, problem.central_jacobian(x), best, attempts)
    if scale <= least:
        return HuberSolution(solution, solution, 0)
    clipped, within = clip(residual, scale)
    influence = replace(solution, residual=clipped, jacobian=within * solution.jacobian)
    return HuberSolution(solution, influence, int(np.sum(np.abs(residual) > _OUTLIER * scale)))


def huberised(problem: Problem, scale: float) -> Problem:
    """State the problem whose squares are Huber's loss.

    Differences are taken of the residual before it is bent: their steps may reach beyond the limit.
    """

    def residual(x: FloatArray) -> FloatArray:
        return scale * huber(problem.finite_residual(x) / scale)

    def jacobian(x: FloatArray) -> FloatArray:
        return huber_weight(residual(x) / scale)[:, None] * problem.central_jacobian(x)

    return replace(problem, residual=residual, jacobian=jacobian)
