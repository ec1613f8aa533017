"""Differential evolution (Storn and Price 1997, doi 10.1023/A:1008202821328)."""

from __future__ import annotations

from collections.abc import Callable

from scipy.optimize import differential_evolution

from aerodima.workbench.core.array_types import FloatArray


def evolve(
    cost: Callable[[FloatArray], FloatArray], first: FloatArray, generations: int, seed: int
) -> tuple[float, FloatArray]:
    """Minimises a cost of shares between 0 and 1.

    Args:
        cost: of members (numbers, members).
        first: generation (members, numbers).
        generations: beside the first one.
        seed: of all draws.

    Returns:
        The least cost and its member (numbers,).
    """
    result = differential_evolution(
        cost,
        [(0.0, 1.0)] * first.shape[1],
        init=first,
        maxiter=generations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=seed,
    )
    return float(result.fun), result.x
