"""Huber's loss: squares within a limit, straight beyond it, so that a few wild values do not decide a fit.

The limit stands in units of a scale taken from the data: 1.4826 times the median deviation of the residual, which is
the standard deviation of normal data however far a minority lies off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from aerodima.optimisation.fit.least_squares import Attempt, Problem, Solution, Solver, solve

Loss = Literal["squares", "huber"]
LOSSES: tuple[Loss, ...] = ("squares", "huber")
LIMIT = 1.345
"""In standard deviations: 95 % efficient on normal data."""
_NORMAL = 1.4826
_SETTLED, _MOST_SCALES = 0.05, 4


def huber(residual: np.ndarray, limit: float = LIMIT) -> np.ndarray:
    """Residuals whose squares are twice the Huber loss: unchanged within the limit, growing like a root beyond it."""
    size = np.abs(residual)
    beyond = np.sqrt(np.maximum(2.0 * limit * size - limit * limit, 0.0))
    return np.where(size <= limit, residual, np.sign(residual) * beyond)


def spread(values: np.ndarray) -> float:
    """1.4826 times the median deviation from the median."""
    return _NORMAL * float(np.median(np.abs(values - np.median(values))))


@dataclass(frozen=True)
class HuberSolution:
    """A solution under Huber's loss.

    Attributes:
        solution: x, and residual and Jacobian of the problem as it was given; its attempts end with the robust one.
        influence: the same x with the clipped residual, and the Jacobian times the share of the residuals within the
            limit: J^+ S J^+' of it is Huber's asymptotic covariance.
        scale: standard deviation of the residual without its outliers.
        beyond: number of residuals that the loss holds back more than three scales.
    """

    solution: Solution
    influence: Solution
    scale: float
    beyond: int


def solve_huber(problem: Problem, method: Solver, squares: Solution) -> HuberSolution:
    """Minimises Huber's loss from the least-squares solution on; the scale is taken anew until it settles.

    Raises:
        FitError: no finite residual on the way.
    """
    found = squares
    scale = spread(found.residual)
    # Residuals that vanish (fewer rows than unknowns, exact data) have no outliers.
    least = 1e-9 * max(float(np.max(np.abs(found.residual))), 1e-300)
    for _ in range(_MOST_SCALES if scale > least else 0):
        robust = solve(_huberised(problem, scale), method, [found.x])
        residual = np.asarray(problem.residual(robust.x), float)
        found = replace(squares, x=robust.x, residual=residual, best=robust.best)
        before, scale = scale, max(spread(residual), least)
        if abs(scale - before) <= _SETTLED * before:
            break
    if found is not squares:
        best = _named(found.best)
        attempts = (*squares.attempts, best)
        found = replace(found, jacobian=problem.central_differences(found.x), best=best, attempts=attempts)
    if scale <= least:
        return HuberSolution(found, found, scale, 0)
    clipped = np.clip(found.residual, -LIMIT * scale, LIMIT * scale)
    within = float(np.mean(np.abs(found.residual) <= LIMIT * scale))
    influence = replace(found, residual=clipped, jacobian=within * found.jacobian)
    return HuberSolution(found, influence, scale, int(np.sum(np.abs(found.residual) > 3.0 * scale)))


def _named(attempt: Attempt) -> Attempt:
    return replace(attempt, status=f"Huber: {attempt.status}")


def _huberised(problem: Problem, scale: float) -> Problem:
    """The problem whose squares are Huber's loss."""
    inner, batch, jacobian = problem.residual, problem.batch, problem.jacobian

    def slope(x: np.ndarray) -> np.ndarray:
        size = np.abs(np.asarray(inner(x), float)) / scale
        beyond = LIMIT / np.sqrt(np.maximum(2.0 * LIMIT * size - LIMIT * LIMIT, LIMIT * LIMIT))
        assert jacobian is not None
        return np.where(size <= LIMIT, 1.0, beyond)[:, None] * np.asarray(jacobian(x), float)

    return replace(
        problem,
        residual=lambda x: scale * huber(np.asarray(inner(x), float) / scale),
        jacobian=None if jacobian is None else slope,
        batch=None if batch is None else lambda xs: scale * huber(np.asarray(batch(xs), float) / scale),
    )
