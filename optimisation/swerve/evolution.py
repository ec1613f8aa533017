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
        cost: of members (members, numbers).
        first: generation (members, numbers).
        ranges: least and largest numbers (numbers,).
        generations: beside the first one.
        seed: of all draws.

    Returns:
        The least cost and its member (numbers,).
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
