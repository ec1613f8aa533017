"""How sure a fit is: covariance, 95 % intervals, and what the data do not determine.

To first order the estimate is x = truth - J^+ e with e the error of the weighted residual, so Cov x
= J^+ S J^+' with S the covariance of e. The pseudo-inverse leaves out the directions that are
unidentifiable; a parameter with a part in one of them has an infinite interval.

A parameter that stopped at a bound would, without it, be moved further, to r >= 0 standard
deviations beyond. Given that the truth lies within the bounds, what remains is the end of a
distribution: with F its upper tail, the truth lies within q standard deviations inside with 95 %
confidence, where F(r + q) = 5 % of F(r). The more the data ask for what the bound forbids, the
shorter that is. The others are estimated with the parameter kept at its bound; what they would
change by if it moved inside by q is added to their intervals, in quadrature and on the side where
it leads.

Filtered signals repeat themselves: n samples with autocorrelation rho_k count as n / (1 + 2 sum
rho_k) (design section 11: intervals that ignore this held the truth in 23 % of the cases instead of
95 %). Noise whose correlation is short, white or filtered, has a flat spectrum at the lowest
frequencies; drift, a burst in the middle and an error of the model do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import dct, idct
from scipy.special import fdtrc, ndtr, stdtr, stdtrit

from aerodima.optimisation.identify.least_squares import Solution, spread
from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.core.errors import FitError

FAR_OFF = 6.0
"""Robust standard deviations beyond which a sample is no noise: two in a thousand million of normal
ones."""
FEW_FAR_OFF = 3
"""Fewest such samples that are reported."""
_SLOW = 10
"""First modes of the cosine transform, in which wandering shows."""
_NEXT = 60
"""End of the modes whose power is compared with theirs."""
_LEAST_SAMPLES = 4 * _NEXT
"""Fewest samples in which wandering is looked for."""
CHANCE = 1e-5
"""That noise wanders as much: below it, it is not noise."""
_EXCESS = 0.2
"""A residual whose variance exceeds that of its rounding by this part is not explained by it.

Chosen on simulated swings, whose intervals hardly change between 0.05 and 1.
"""
CONFIDENCE = 0.95
"""Probability of the intervals."""
_RANK_TOLERANCE = 1e-7
"""Singular values of the scaled Jacobian below this part of the largest count as zero."""
_WIDE = 0.25
"""Share of the distance of its bounds beyond which an interval is checked for curvature."""
_CURVED = 1.5
"""Factor by which a standard deviation changes that counts as curved."""
_EVEN_MATTERS = 0.6
"""Share of a standard deviation that evenly spread errors have: below it the sum is as good as
normal."""
_EVEN_ALONE = 0.995
"""Share beyond which evenly spread errors are taken to be alone."""
_SHARE = 0.05
"""A parameter whose squared share in an unidentifiable direction exceeds the square of this is not
determined."""
_TAIL = 0.05
"""Share of the tail beyond a bound that an interval leaves out."""
_LEAST_TAIL = 1e-250
"""Smaller tails are not counted with: the floating-point numbers end."""


@dataclass(frozen=True)
class ResidualCheck:
    """What was found in a residual.

    Attributes:
        far_off: number of samples beyond six robust standard deviations.
        first: row of the first of them; -1 without.
        wander: power of the slowest modes over that of the next ones; about 1.
        freedom: degrees of freedom of both.
        swing: largest size of the slow part.
    """

    far_off: int = 0
    first: int = -1
    wander: float = 1.0
    freedom: tuple[int, int] = (1, 1)
    swing: float = 0.0


def check_residual(residual: FloatArray, unknowns: int = 1) -> ResidualCheck:
    """Checks a residual in the order of time (n).

    Args:
        unknowns: that were fitted to it, a constant among them; each takes a slow mode's worth of
            freedom.
    """
    x = np.asarray(residual, float) - np.median(residual)
    scale = spread(x)
    if scale == 0.0 or len(x) < _LEAST_SAMPLES:
        return ResidualCheck()
    beyond = np.abs(x) > FAR_OFF * scale
    first = int(np.argmax(beyond)) if np.any(beyond) else -1
    # Wild samples were reported above; they must not look like noise or like wandering.
    modes = dct(np.clip(x, -FAR_OFF * scale, FAR_OFF * scale), norm="ortho")
    freedom = (max(_SLOW - unknowns, 1), _NEXT - _SLOW)
    power = np.square(modes)
    ratio = np.sum(power[1:_SLOW]) / freedom[0] / np.mean(power[_SLOW:_NEXT])
    modes[_SLOW:] = 0.0
    modes[0] = 0.0
    slow = float(np.max(np.abs(idct(modes, norm="ortho"))))
    return ResidualCheck(int(np.sum(beyond)), first, float(ratio), freedom, slow)


def chance_of(checks: Sequence[ResidualCheck]) -> float:
    """That noise wanders as much as several residuals together do."""
    slow = sum(check.freedom[0] for check in checks)
    following = sum(check.freedom[1] for check in checks)
    wander = np.mean([check.wander for check in checks])
    return float(fdtrc(slow, following, wander))


@dataclass(frozen=True)
class Noise:
    """Covariance of the error of the weighted residual, and how much data it was estimated from.

    Attributes:
        covariance: (m x m), or its diagonal (m).
        degrees_of_freedom: of the variance estimate; infinite when it is known.
        effective_samples: that the residual stands for.
        rounding: change of the residual (m) per half count of a reading that was rounded; its error
            is evenly spread, not normal. It is part of `covariance` (a third of its square).
    """

    covariance: FloatArray
    degrees_of_freedom: float = np.inf
    effective_samples: float = np.nan
    rounding: FloatArray | None = None


def correlation_time(residual: FloatArray) -> float:
    """1 + 2 sum rho_k of a signal (n): how many samples count as one; at least 1.

    The autocorrelation is summed in pairs until a pair is no longer positive (initial positive
    sequence): longer sums scatter too much in short logs. Of a steep filter, whose autocorrelation
    rings, this takes the first lobe only and makes intervals about 8 % too wide.
    """
    x = np.asarray(residual, float) - np.mean(residual)
    n = len(x)
    power = float(x @ x)
    if n < 4 or power <= 0.0:
        return 1.0
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    rho = np.fft.irfft(spectrum * spectrum.conj(), size)[: n // 2] / power
    pairs = rho[0 : len(rho) - 1 : 2] + rho[1 : len(rho) : 2]
    falls = pairs <= 0.0
    end = int(np.argmax(falls)) if np.any(falls) else len(pairs)
    return max(1.0, float(2.0 * np.sum(pairs[:end]) - 1.0))


def serial_noise(
    residual: FloatArray, channels: list[slice], unknowns: int, rounding: float = 0.0
) -> Noise:
    """Noise of time series, one per channel, from the residual itself: its variance, times its
    correlation time.

    Args:
        residual: weighted, of all channels (m).
        channels: where each time series stands in it.
        unknowns: number of the free parameters; they are paid for out of the effective samples.
        rounding: step of the readings, in units of the residual. Where a reading moves through many
            steps, rounding errors are evenly spread and average out at least as fast as white
            noise, also when they look like a saw: a residual whose variance they explain (a twelfth
            of the step's square) counts for single samples, one that exceeds it by a fifth counts
            by its correlation, and in between by both in part.
    """
    variance = np.empty(len(residual))
    effective = 0.0
    for channel in channels:
        part = residual[channel]
        power = float(np.mean(np.square(part)))
        explained = rounding**2 / 12.0
        if explained > 0.0:
            slow = min(max(power / explained - 1.0, 0.0) / _EXCESS, 1.0)
        else:
            slow = 1.0
        variance[channel] = power * (1.0 + slow * (correlation_time(part) - 1.0))
        effective += len(part) * (power / variance[channel][0] if power > 0.0 else 1.0)
    freedom = max(effective - unknowns, 1.0)
    return Noise(variance * effective / freedom, freedom, effective)


def independent_noise(residual: FloatArray, unknowns: int) -> Noise:
    """Noise of rows that do not repeat each other (a table): one variance, from the residual."""
    freedom = max(len(residual) - unknowns, 1)
    variance = float(residual @ residual) / freedom
    return Noise(np.full(len(residual), variance), freedom, float(len(residual)))


@dataclass(frozen=True)
class Uncertainty:
    """Covariance and intervals of the unknowns of one solution.

    Attributes:
        covariance: (p x p), in the units of the unknowns, with what stopped at a bound kept there;
            infinite on the diagonal where not determined.
        standard_deviation: (p); infinite where not determined. At a bound: its one-sided interval
            over the width that a two-sided one has to either side.
        lower, upper: ends of the 95 % intervals (p); one-sided at a bound.
        beyond: (p) by how many standard deviations the data ask for more than the bound allows at
            which an unknown stopped; NaN for one that is not at a bound.
        identifiable: (p) flags.
        unidentifiable: the directions that the data do not determine, in words; empty when there
            are none.
        effective_samples: see `Noise`.
    """

    covariance: FloatArray
    standard_deviation: FloatArray
    lower: FloatArray
    upper: FloatArray
    beyond: FloatArray
    identifiable: np.ndarray
    unidentifiable: tuple[str, ...]
    effective_samples: float


def uncertainty(solution: Solution, noise: Noise) -> Uncertainty:
    """Covariance and intervals at the solution.

    Every interval holds its estimate and is cut at the bounds. One of a parameter that stopped at a
    bound is one-sided, and those of the others take that into account. Not identifiable is a
    parameter with a part in an unidentifiable direction, one whose interval is wider than its
    bounds, and one whose interval would be another half as wide, or narrower, elsewhere within the
    intervals of the parameters: there the linear theory does not hold.
    """
    parameters = solution.problem.parameters
    scales = parameters.scales
    names = parameters.names
    x = solution.x
    inverse, hidden = _pseudo_inverse(solution.jacobian, scales)
    if len(hidden):
        seen = np.all(np.abs(hidden) <= _SHARE, axis=0)
    else:
        seen = np.ones(len(scales), bool)
    alone = np.sqrt(np.maximum(np.diag(_covariance(inverse, noise, scales)), 0.0))
    freedom = max(noise.degrees_of_freedom, 1.0)
    # What the data do not see stays where it started, which may be a bound.
    sides = np.where(seen, parameters.sides(x), 0)
    given = held_at_bounds(
        solution.jacobian * scales,
        solution.residual,
        noise.covariance,
        sides,
        freedom,
        _RANK_TOLERANCE,
    )
    inverse = given.inverse if np.any(sides) else inverse
    covariance = _covariance(inverse, noise, scales)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    factor = np.full(len(scales), _factor(freedom))
    if noise.rounding is not None:
        rounding = np.abs(inverse @ noise.rounding) * scales
        shares = rounding / (math.sqrt(3.0) * np.maximum(deviation, 1e-300))
        normal = _factor(np.inf)
        factor *= [_rounded_factor(round(share, 2)) / normal for share in shares.tolist()]
    reach = given.reach * scales
    shift = given.shift * scales[:, None]
    half_width = factor * deviation
    at_lower = sides < 0
    at_upper = sides > 0
    shift_down = np.linalg.norm(np.minimum(shift, 0.0), axis=1)
    shift_up = np.linalg.norm(np.maximum(shift, 0.0), axis=1)
    down = np.where(at_lower, 0.0, np.hypot(half_width, shift_down))
    up = np.where(at_upper, 0.0, np.hypot(half_width, shift_up))
    down = np.where(at_upper, reach, down)
    up = np.where(at_lower, reach, up)
    deviation = np.where(sides != 0, reach / factor, deviation)
    loose = seen & (down + up > parameters.upper - parameters.lower)
    tight = seen & ~loose
    curved = tight & _curved(solution, noise, alone, factor)
    determined = tight & ~curved
    deviation[~determined] = np.inf
    variance = np.where(determined, np.square(deviation), np.inf)
    covariance[np.diag_indices_from(covariance)] = variance
    unidentifiable = [_in_words(direction, names) for direction in hidden]
    unidentifiable += [
        f"{name} within its bounds" for name, flag in zip(names, loose, strict=True) if flag
    ]
    unidentifiable += [
        f"{name} (its interval depends on where it is)"
        for name, flag in zip(names, curved, strict=True)
        if flag
    ]
    return Uncertainty(
        covariance=covariance,
        standard_deviation=deviation,
        lower=np.where(determined, np.maximum(x - down, parameters.lower), -np.inf),
        upper=np.where(determined, np.minimum(x + up, parameters.upper), np.inf),
        beyond=np.where(determined, given.beyond, np.nan),
        identifiable=determined,
        unidentifiable=tuple(unidentifiable),
        effective_samples=noise.effective_samples,
    )


@lru_cache(maxsize=256)
def _factor(freedom: float) -> float:
    """Half the width of the interval in standard deviations."""
    return float(stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE))


@lru_cache(maxsize=128)
def _rounded_factor(share: float) -> float:
    """The same for a normal error and an evenly spread one, whose part of the standard deviation is
    `share`.

    An even error alone stays within 1.73 standard deviations, and in 95 % of the cases within 1.65.
    """
    if share < _EVEN_MATTERS:
        return _factor(np.inf)
    if share > _EVEN_ALONE:
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


def _pseudo_inverse(jacobian: FloatArray, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
    """J^+ in scaled unknowns (p x m), the unidentifiable directions (k x p)."""
    U, s, Vt = np.linalg.svd(jacobian * scales, full_matrices=False)
    seen = s > _RANK_TOLERANCE * max(float(s[0]), 1e-300)
    inverse = (Vt[seen].T / s[seen]) @ U[:, seen].T
    return inverse, _hidden_directions(Vt, seen)


def _covariance(inverse: FloatArray, noise: Noise, scales: FloatArray) -> FloatArray:
    S = noise.covariance
    if S.ndim == 1:
        scaled = (inverse * S) @ inverse.T
    else:
        scaled = inverse @ S @ inverse.T
    return scaled * np.outer(scales, scales)


def _curved(
    solution: Solution, noise: Noise, deviation: FloatArray, factor: FloatArray
) -> np.ndarray:
    """Whose standard deviation changes by more than half of it within the intervals, cut at the
    bounds (p).

    Only asked where an interval covers a good part of its bounds: the Jacobian at the ends costs as
    much as a solution.
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
                inverse, _ = _pseudo_inverse(problem.central_differences(x), scales)
            except FitError:  # the model ends within the interval
                changed[i] = True
                continue
            there = np.sqrt(np.maximum(np.diag(_covariance(inverse, noise, scales)), 0.0))
            changed |= (there > _CURVED * deviation) | (there < deviation / _CURVED)
    return changed


def _hidden_directions(Vt: FloatArray, seen: np.ndarray) -> FloatArray:
    """A readable basis of the directions that are not seen (k x p): each has a parameter that the
    others lack.
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


def _in_words(direction: FloatArray, names: tuple[str, ...]) -> str:
    """A direction of scaled unknowns: `cd`, or `0.80 gap + 0.60 h0`."""
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


@dataclass(frozen=True)
class GivenBounds:
    """Bounds on the scaled unknowns, some of which are held at a bound.

    Attributes:
        inverse: pseudo-inverse of the Jacobian of the others (p x m); zero in the rows of what is
            held.
        beyond: how far the data ask for more than the bound allows, in standard deviations (p); NaN
            for the others.
        reach: how far inside the truth may lie (p); zero for the others.
        shift: change of the others per unknown that is held, when it moves inside by its reach (p x
            p).
    """

    inverse: FloatArray
    beyond: FloatArray
    reach: FloatArray
    shift: FloatArray


def held_at_bounds(
    jacobian: FloatArray,
    residual: FloatArray,
    covariance: FloatArray,
    sides: IntArray,
    freedom: float,
    rank_tolerance: float,
) -> GivenBounds:
    """What the bounds do, see the head of this module.

    Args:
        jacobian: of the weighted residual by the scaled unknowns (m x p).
        residual: weighted (m).
        covariance: of its error (m x m), or the diagonal (m).
        sides: -1 where an unknown is held at its lower bound, 1 at its upper one, 0 where it is
            free (p).
        freedom: degrees of freedom of the variance.
        rank_tolerance: singular values below this part of the largest count as zero.
    """
    count = len(sides)
    free = np.flatnonzero(sides == 0)
    inverse = np.zeros(jacobian.T.shape)
    inverse[free] = np.linalg.pinv(jacobian[:, free], rank_tolerance)
    beyond = np.full(count, math.nan)
    reach = np.zeros(count)
    shift = np.zeros((count, count))
    for k in np.flatnonzero(sides):
        # What is left of this column once the others have followed it.
        column = jacobian[:, k]
        followed = inverse @ column
        alone = column - jacobian @ followed
        row = alone / float(alone @ alone)
        if covariance.ndim == 1:
            spread = row * covariance
        else:
            spread = row @ covariance
        deviation = math.sqrt(max(float(spread @ row), 0.0))
        asked = max(-float(row @ residual) * sides[k], 0.0)
        if deviation > 0.0:
            beyond[k] = asked / deviation
        else:
            beyond[k] = math.inf
        reach[k] = deviation * reach_inside(float(beyond[k]), freedom)
        shift[:, k] = sides[k] * reach[k] * followed
    return GivenBounds(inverse, beyond, reach, shift)


def reach_inside(beyond: float, freedom: float) -> float:
    """The q of this module's head, in standard deviations: 1.96 at `beyond` = 0, about 3 / beyond
    far out.
    """
    tail = float(stdtr(freedom, -beyond))
    if tail > _LEAST_TAIL:
        return -float(stdtrit(freedom, _TAIL * tail)) - beyond
    # F goes like (1 + r^2 / freedom)^(-(freedom + 1) / 2); in the limit of a known variance like
    # exp(-r^2 / 2).
    drop = -2.0 * math.log(_TAIL)
    if math.isinf(freedom):
        more = drop
    else:
        more = math.expm1(drop / (freedom + 1.0)) * (beyond**2 + freedom)
    return more / (math.sqrt(beyond**2 + more) + beyond)
