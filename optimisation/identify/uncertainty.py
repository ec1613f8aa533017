"""Confidence intervals of a fit: covariance, 95 % intervals, and undetermined parameters.

To first order the estimate is x = truth - J^+ e with e the error of the weighted residual, so
Cov x = J^+ S J^+' with S the covariance of e. The pseudo-inverse leaves out the directions that are
unidentifiable; a parameter with a part in one of them has an infinite interval, and so has one
whose estimate follows an undetermined one as that goes through its bounds.

`active_bounds` has the effect of a bound on the intervals, `noise` the covariance S.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import ndtr, stdtrit

from aerodima.optimisation.identify.active_bounds import (
    RANK_TOLERANCE,
    ActiveBounds,
    condition_on_active_bounds,
)
from aerodima.optimisation.identify.least_squares import Solution
from aerodima.optimisation.identify.noise import Noise
from aerodima.workbench.core.array_types import ArrayPair, FloatArray, Texts
from aerodima.workbench.core.errors import FitError

CONFIDENCE = 0.95
"""Probability of the intervals."""
_WIDE = 0.25
"""Ratio of an interval to the distance of its bounds above which it is checked for curvature."""
_CURVED = 1.5
"""Factor on a standard deviation from which its change counts as curvature."""
_MIN_UNIFORM_SHARE = 0.6
"""Share of uniformly distributed errors in a standard deviation below which the sum is as good as
normal."""
_MAX_UNIFORM_SHARE = 0.995
"""Share beyond which uniformly distributed errors are taken to be alone."""
_SHARE = 0.05
"""Share of a parameter in an unidentifiable direction above which the parameter is not
determined."""
_FOLLOWS = 0.2
"""Share of half an interval by which an estimate may follow an unknown that is not determined."""
_SAME = 1e-6
"""Change of an estimate, in scales, from rounding in the solver."""
_FAR = 10.0
"""Distance, in scales, by which an unknown that is not determined is moved within its bounds."""
_ROUNDS = 4
"""Number of Gauss-Newton steps in which the others follow it."""


@dataclass(frozen=True)
class Uncertainty:
    """Covariance and intervals of the unknowns of one solution.

    Attributes:
        covariance: covariance of the unknowns (p x p), in their units, with those that stopped at a
            bound kept there; infinite on the diagonal where not determined.
        standard_deviation: standard deviations of the unknowns (p); infinite where not determined.
            At a bound, width of the one-sided interval over the number of standard deviations in
            half a two-sided one.
        lower: lower ends of the 95 % intervals (p); one-sided at a bound.
        upper: upper ends of the 95 % intervals (p); one-sided at a bound.
        beyond: number of standard deviations beyond its bound to which the data ask an unknown to
            move (p); NaN for one that is not at a bound.
        identifiable: flags of the unknowns that the data determine (p).
        unidentifiable: directions that the data do not determine, in words; empty when there are
            none.
        effective_samples: number of independent samples, see `Noise`.
    """

    covariance: FloatArray
    standard_deviation: FloatArray
    lower: FloatArray
    upper: FloatArray
    beyond: FloatArray
    identifiable: np.ndarray
    unidentifiable: Texts
    effective_samples: float


def uncertainty(
    solution: Solution, noise: Noise, max_deviation: FloatArray | float = math.inf
) -> Uncertainty:
    """Compute covariance and intervals at the solution.

    Every interval holds its estimate and is cut at the bounds. One of a parameter that stopped at a
    bound is one-sided, and those of the others take that into account. A parameter is not
    identifiable if it has a part in an unidentifiable direction, if its interval is wider than its
    bounds, if its interval would be half as wide again, or as much narrower, elsewhere within the
    intervals (the linear theory does not hold there), or if another such parameter moves it within
    its bounds. None is identifiable where no residual is left to estimate the noise.

    Args:
        max_deviation: standard deviation (p) beyond which the data do not determine an unknown that
            has a prior.
    """
    parameters = solution.problem.parameters
    scales = parameters.scales
    x = solution.x
    inverse, hidden = _pseudo_inverse(solution.jacobian, scales)
    seen = np.all(np.abs(hidden) <= _SHARE, axis=0)
    alone = _deviation(_covariance(inverse, noise, scales))
    freedom = max(noise.degrees_of_freedom, 1.0)
    # An unidentifiable unknown stays where it started, which may be a bound.
    sides = np.where(seen, parameters.sides(x), 0)
    active = condition_on_active_bounds(
        solution.jacobian * scales, solution.residual, noise.covariance, sides, freedom
    )
    if np.any(sides):
        inverse = active.inverse
    covariance = _covariance(inverse, noise, scales)
    deviation = _deviation(covariance)
    factor = _factors(inverse, noise, deviation / scales, freedom)
    down, up = _widths(active, scales, factor * deviation)
    deviation = np.where(sides != 0, active.reach * scales / factor, deviation)
    names = np.array(parameters.names)
    leading = ", ".join(names[_leading(hidden)])
    reasons: dict[str, Any] = {
        "within its bounds": down + up > parameters.upper - parameters.lower,
        "(its interval depends on where it is)": _curved(solution, noise, alone, factor),
        f"(it follows {leading})": _following(solution, hidden, np.maximum(down, up)),
        "beyond its prior": deviation > max_deviation,
        "(no residual is left to tell the noise)": np.array(noise.degrees_of_freedom <= 0.0),
    }
    unidentifiable = [_in_words(direction, parameters.names) for direction in hidden]
    for reason, flags in reasons.items():
        unidentifiable += [f"{name} {reason}" for name in names[seen & flags]]
        seen &= ~flags
    deviation[~seen] = np.inf
    covariance[np.diag_indices_from(covariance)] = np.square(deviation)
    return Uncertainty(
        covariance=covariance,
        standard_deviation=deviation,
        lower=np.where(seen, np.maximum(x - down, parameters.lower), -np.inf),
        upper=np.where(seen, np.minimum(x + up, parameters.upper), np.inf),
        beyond=np.where(seen, active.beyond, np.nan),
        identifiable=seen,
        unidentifiable=tuple(unidentifiable),
        effective_samples=noise.effective_samples,
    )


def _deviation(covariance: FloatArray) -> FloatArray:
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _factors(
    inverse: FloatArray, noise: Noise, deviation: FloatArray, freedom: float
) -> FloatArray:
    """Compute half the widths of the intervals, in standard deviations (p); `deviation` is that of
    the scaled unknowns.
    """
    factor = np.full(len(deviation), _factor(freedom))
    if noise.rounding is None:
        return factor
    shares = np.abs(inverse @ noise.rounding) / (math.sqrt(3.0) * np.maximum(deviation, 1e-300))
    rounded = [_rounded_factor(round(share, 2)) for share in shares.tolist()]
    return factor * rounded / _factor(np.inf)


def _widths(active: ActiveBounds, scales: FloatArray, half_width: FloatArray) -> ArrayPair:
    """Compute the widths of the intervals below and above the estimates (p each)."""
    reach = active.reach * scales
    shift = active.shift * scales[:, None]
    shift_down = np.linalg.norm(np.minimum(shift, 0.0), axis=1)
    shift_up = np.linalg.norm(np.maximum(shift, 0.0), axis=1)
    at_lower = active.sides < 0
    at_upper = active.sides > 0
    down = np.where(at_lower, 0.0, np.hypot(half_width, shift_down))
    up = np.where(at_upper, 0.0, np.hypot(half_width, shift_up))
    down = np.where(at_upper, reach, down)
    up = np.where(at_lower, reach, up)
    return down, up


@lru_cache(maxsize=256)
def _factor(freedom: float) -> float:
    """Compute half the width of an interval in standard deviations, for a normal error."""
    return float(stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE))


@lru_cache(maxsize=128)
def _rounded_factor(share: float) -> float:
    """Compute the same for a normal error plus a uniformly distributed one, whose share of the
    standard deviation is `share`.

    A uniform error alone stays within 1.73 standard deviations, in 95 % of the cases within 1.65.
    """
    if share < _MIN_UNIFORM_SHARE:
        return _factor(np.inf)
    if share > _MAX_UNIFORM_SHARE:
        return CONFIDENCE * math.sqrt(3.0)
    from scipy.optimize import brentq

    half = math.sqrt(3.0) * share
    sigma = math.sqrt(1.0 - share * share)

    def missing(reach: float) -> float:
        ends = np.array([reach + half, reach - half]) / sigma
        density = np.exp(-0.5 * np.square(ends)) / math.sqrt(2.0 * math.pi)
        inside = ends * ndtr(ends) + density  # integral of the distribution function
        return float(sigma * (inside[0] - inside[1]) / (2.0 * half)) - (0.5 + 0.5 * CONFIDENCE)

    return float(brentq(missing, 1.0, 3.0))


def _pseudo_inverse(jacobian: FloatArray, scales: FloatArray) -> ArrayPair:
    """Compute J^+ in scaled unknowns (p x m), the unidentifiable directions (k x p)."""
    rows, count = jacobian.shape
    # Rows of zeros keep all directions where there are fewer residuals than unknowns.
    padded = np.pad(jacobian * scales, ((0, max(count - rows, 0)), (0, 0)))
    U, s, Vt = np.linalg.svd(padded, full_matrices=False)
    seen = s > RANK_TOLERANCE * max(float(s[0]), 1e-300)
    inverse = (Vt[seen].T / s[seen]) @ U[:rows, seen].T
    return inverse, _hidden_directions(Vt, seen)


def _covariance(inverse: FloatArray, noise: Noise, scales: FloatArray) -> FloatArray:
    S = noise.covariance
    spread = inverse * S if S.ndim == 1 else inverse @ S
    return spread @ inverse.T * np.outer(scales, scales)


def _curved(
    solution: Solution, noise: Noise, deviation: FloatArray, factor: FloatArray
) -> np.ndarray:
    """Flag unknowns whose standard deviation changes by more than half of it within the intervals,
    cut at the bounds (p).

    This is checked only if an interval covers a good part of its bounds: the Jacobian at the ends
    costs as much as a solution.
    """
    problem = solution.problem
    parameters = problem.parameters
    low = parameters.lower
    high = parameters.upper
    scales = parameters.scales
    changed = np.zeros(len(scales), bool)
    if not np.any(2.0 * factor * deviation > _WIDE * (high - low)):
        return changed
    for i, reach in enumerate(factor * deviation):
        middle = solution.x[i]
        for end in (max(middle - reach, low[i]), min(middle + reach, high[i])):
            if not np.isfinite(end) or reach == 0.0:
                continue
            x = solution.x.copy()
            x[i] = end
            try:
                inverse, _ = _pseudo_inverse(problem.central_jacobian(x), scales)
            except FitError:  # the model ends within the interval
                changed[i] = True
                continue
            there = _deviation(_covariance(inverse, noise, scales))
            changed |= (there > _CURVED * deviation) | (there < deviation / _CURVED)
    return changed


def _following(solution: Solution, hidden: FloatArray, half_width: FloatArray) -> np.ndarray:
    """Flag unknowns whose estimate moves by a part of its interval when one that is not determined
    goes through its bounds (p).

    The linear theory knows the direction at the solution only; the rest is found by solving for the
    others.
    """
    problem = solution.problem
    parameters = problem.parameters
    scales = parameters.scales
    follows = np.zeros(len(scales), bool)
    for index in _leading(hidden):
        reach = _FAR * scales[index] * np.array([-1.0, 0.0, 1.0])
        places = []
        for value in solution.x[index] + reach:
            x = solution.x.copy()
            x[index] = value
            with suppress(FitError):  # the model ends on the way
                for _ in range(_ROUNDS):
                    x = np.clip(x, parameters.lower, parameters.upper)
                    J = problem.central_jacobian(x) * scales
                    J[:, index] = 0.0
                    step = np.linalg.pinv(J, RANK_TOLERANCE) @ problem.finite_residual(x)
                    x -= scales * step
                places.append(x)
        if places:
            follows |= np.ptp(places, axis=0) > _FOLLOWS * half_width + _SAME * scales
    return follows


def _leading(hidden: FloatArray) -> list[int]:
    """List the unknown with the largest share in each direction (k)."""
    return np.argmax(np.abs(hidden), axis=1).tolist() if len(hidden) else []


def _hidden_directions(Vt: FloatArray, seen: np.ndarray) -> FloatArray:
    """Make a readable basis of the directions that are not seen (k x p): each has a parameter that
    the others lack.
    """
    hidden = Vt[~seen].copy()
    for row in range(len(hidden)):
        rest = np.abs(hidden[row:])
        i, j = np.unravel_index(int(np.argmax(rest)), rest.shape)
        hidden[[row, row + i]] = hidden[[row + i, row]]
        hidden[row] /= hidden[row, j]
        for other in range(len(hidden)):
            if other != row:
                hidden[other] -= hidden[other, j] * hidden[row]
    norms = np.linalg.norm(hidden, axis=1, keepdims=True)
    return hidden / np.where(norms > 0.0, norms, 1.0)


def _in_words(direction: FloatArray, names: Texts) -> str:
    """Describe a direction of scaled unknowns: `cd`, or `0.80 gap + 0.60 h0`."""
    order = np.argsort(-np.abs(direction))
    parts = [(direction[i], names[i]) for i in order if abs(direction[i]) > _SHARE]
    largest, first = parts[0]
    if len(parts) == 1:
        return first
    text = f"{largest:.2f} {first}"
    for share, name in parts[1:]:
        sign = "+" if share > 0 else "-"
        text += f" {sign} {abs(share):.2f} {name}"
    return text
