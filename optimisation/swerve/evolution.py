"""Differential evolution (Storn and Price 1997, doi 10.1023/A:1008202821328)."""

from collections.abc import Callable

from scipy.optimize import differential_evolution

from aerodima.workbench.core.array_types import ArrayPair, FloatArray


def evolve(
    cost: Callable[[FloatArray], FloatArray],
    first: FloatArray,
    ranges: ArrayPair,
    generations: int,
    seed: int,
) -> tuple[float, FloatArray]:
    """Minimises a cost.

    Args:
        cost: function of a generation (members, numbers) that returns the cost of each member
            (members,).
        first: first generation (members, numbers).
        ranges: least and largest value of each number (numbers,).
        generations: number of generations after the first one.
        seed: seed of every random draw.

    Returns:
        The least cost, and the member that has it (numbers,).
    """
    low, high = ranges
    span = high - low
    result = differential_evolution(
        lambda shares: cost(low + shares.T * span),
        [(0.0, 1.0)] * len(low),
        init=(first - low) / span,
        maxiter=generations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=seed,
    )
    return float(result.fun), low + result.x * span
