"""Effect of active bounds on the intervals of a fit.

A parameter that stopped at a bound would, without it, move further, to r >= 0 standard deviations
beyond. Given that the truth lies within the bounds, only the end of a distribution remains: with F
its upper tail, the truth lies within q standard deviations inside with 95 % confidence, where
F(r + q) = 5 % of F(r). The more the data ask for what the bound forbids, the shorter that is. The
other parameters are estimated with this one kept at its bound; the change that they would make if
it moved inside by q is added to their intervals, in quadrature and on the side where it leads.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from aerodima.workbench.core.array_types import FloatArray, IntArray

RANK_TOLERANCE = 1e-7
"""Singular values of the scaled Jacobian below this part of the largest count as zero."""
_TAIL = 0.05
"""Share of the tail beyond a bound that an interval leaves out."""
_MIN_TAIL = 1e-250
"""Smallest tail that is computed with; the floating-point numbers end not far below it."""


@dataclass(frozen=True)
class ActiveBounds:
    """Scaled unknowns that are held at a bound, and the other ones given them.

    Attributes:
        sides: -1 where an unknown is held at its lower bound, 1 at its upper one, else 0 (p).
        inverse: pseudo-inverse of the Jacobian of the other unknowns (p x m); zero in the rows of
            the held ones.
        beyond: distance beyond its bound to which the data ask an unknown to move, in standard
            deviations (p); NaN for the unknowns that are not held.
        reach: distance inside its bound within which the truth may lie, in scaled unknowns (p);
            zero for the unknowns that are not held.
        shift: change of the other unknowns when a held one moves inside by its reach, a column for
            each held unknown (p x p).
    """

    sides: IntArray
    inverse: FloatArray
    beyond: FloatArray
    reach: FloatArray
    shift: FloatArray


def condition_on_active_bounds(
    jacobian: FloatArray,
    residual: FloatArray,
    covariance: FloatArray,
    sides: IntArray,
    freedom: float,
) -> ActiveBounds:
    """Condition a linear fit on the bounds that it stopped at, see the head of this module.

    Args:
        jacobian: derivative of the weighted residual by the scaled unknowns (m x p).
        residual: weighted residual (m).
        covariance: covariance of the error of the residual (m x m), or its diagonal (m).
        sides: -1 where an unknown is held at its lower bound, 1 at its upper one, 0 where it is
            free (p).
        freedom: degrees of freedom of the variance.
    """
    count = len(sides)
    free = np.flatnonzero(sides == 0)
    inverse = np.zeros(jacobian.T.shape)
    inverse[free] = np.linalg.pinv(jacobian[:, free], RANK_TOLERANCE)
    beyond = np.full(count, math.nan)
    reach = np.zeros(count)
    shift = np.zeros((count, count))
    for k in np.flatnonzero(sides):
        # Remainder of this column once the other unknowns have followed it.
        column = jacobian[:, k]
        followed = inverse @ column
        alone = column - jacobian @ followed
        row = alone / float(alone @ alone)
        spread = row * covariance if covariance.ndim == 1 else row @ covariance
        deviation = math.sqrt(max(float(spread @ row), 0.0))
        asked = max(-float(row @ residual) * sides[k], 0.0)
        beyond[k] = asked / deviation if deviation > 0.0 else math.inf
        reach[k] = deviation * one_sided_quantile(float(beyond[k]), freedom)
        shift[:, k] = sides[k] * reach[k] * followed
    return ActiveBounds(sides, inverse, beyond, reach, shift)


def one_sided_quantile(beyond: float, freedom: float) -> float:
    """Compute the q of this module's head, in standard deviations: 1.96 at `beyond` = 0, about
    3 / beyond far out.
    """
    tail = float(stdtr(freedom, -beyond))
    if tail > _MIN_TAIL:
        return -float(stdtrit(freedom, _TAIL * tail)) - beyond
    # F falls like (1 + r^2 / freedom)^(-(freedom + 1) / 2), and like exp(-r^2 / 2) in the limit of
    # a known variance.
    drop = -2.0 * math.log(_TAIL)
    more = drop
    if math.isfinite(freedom):
        more = math.expm1(drop / (freedom + 1.0)) * (beyond**2 + freedom)
    return more / (math.sqrt(beyond**2 + more) + beyond)
