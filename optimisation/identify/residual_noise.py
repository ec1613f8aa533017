"""Noise of residuals: how many samples count, and whether they are noise at all.

Filtered signals repeat themselves: n samples with autocorrelation rho_k count as n / (1 + 2 sum rho_k) (design section
11: intervals that ignore this held the truth in 23 % of the cases instead of 95 %). Noise whose correlation is short,
white or filtered, has a flat spectrum at the lowest frequencies; drift, a burst in the middle and an error of the model
do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct
from scipy.special import fdtrc

from aerodima.optimisation.identify.least_squares import spread

FAR_OFF = 6.0
"""Robust standard deviations beyond which a sample is no noise: two in a thousand million of normal ones."""
FEW_FAR_OFF = 3
_SLOW, _NEXT = 10, 60
"""Modes of the cosine transform: wandering shows in the first, whose power is compared with that of the next."""
_LEAST_SAMPLES = 4 * _NEXT
CHANCE = 1e-5
"""That noise wanders as much: below it, it is not noise."""


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


def check_residual(residual: np.ndarray, unknowns: int = 1) -> ResidualCheck:
    """Checks a residual in the order of time (n).

    Args:
        unknowns: that were fitted to it, a constant among them; each takes a slow mode's worth of freedom.
    """
    x = np.asarray(residual, float) - np.median(residual)
    scale = spread(x)
    if scale == 0.0 or len(x) < _LEAST_SAMPLES:
        return ResidualCheck()
    beyond = np.abs(x) > FAR_OFF * scale
    first = int(np.argmax(beyond)) if np.any(beyond) else -1
    # A few wild samples are told above; they must not look like noise or like wandering.
    modes = dct(np.clip(x, -FAR_OFF * scale, FAR_OFF * scale), norm="ortho")
    freedom = (max(_SLOW - unknowns, 1), _NEXT - _SLOW)
    ratio = np.sum(np.square(modes[1:_SLOW])) / freedom[0] / np.mean(np.square(modes[_SLOW:_NEXT]))
    modes[_SLOW:], modes[0] = 0.0, 0.0
    slow = float(np.max(np.abs(idct(modes, norm="ortho"))))
    return ResidualCheck(int(np.sum(beyond)), first, float(ratio), freedom, slow)


def chance_of(checks: Sequence[ResidualCheck]) -> float:
    """That noise wanders as much as several residuals together do."""
    low, high = (sum(check.freedom[i] for check in checks) for i in range(2))
    return float(fdtrc(low, high, np.mean([check.wander for check in checks])))


_EXCESS = 0.2
"""A residual whose variance exceeds that of its rounding by this part is not explained by it.

Chosen on simulated swings, whose intervals hardly change between 0.05 and 1.
"""


@dataclass(frozen=True)
class Noise:
    """Covariance of the error of the weighted residual, and how much data it was estimated from.

    Attributes:
        covariance: (m x m), or its diagonal (m).
        degrees_of_freedom: of the variance estimate; infinite when it is known.
        effective_samples: that the residual stands for.
        rounding: change of the residual (m) per half count of a reading that was rounded; its error is evenly spread,
            not normal. It is part of `covariance` (a third of its square).
    """

    covariance: np.ndarray
    degrees_of_freedom: float = np.inf
    effective_samples: float = np.nan
    rounding: np.ndarray | None = None


def correlation_time(residual: np.ndarray) -> float:
    """1 + 2 sum rho_k of a signal (n): how many samples count as one; at least 1.

    The autocorrelation is summed in pairs until a pair is no longer positive (initial positive sequence): longer sums
    scatter too much in short logs. Of a steep filter, whose autocorrelation rings, this takes the first lobe only and
    makes intervals about 8 % too wide.
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
    end = int(np.argmax(pairs <= 0.0)) if np.any(pairs <= 0.0) else len(pairs)
    return max(1.0, float(2.0 * np.sum(pairs[:end]) - 1.0))


def serial_noise(residual: np.ndarray, channels: list[slice], unknowns: int, rounding: float = 0.0) -> Noise:
    """Noise of time series, one per channel, from the residual itself: its variance, times its correlation time.

    Args:
        residual: weighted, of all channels (m).
        channels: where each time series stands in it.
        unknowns: number of the free parameters; they are paid for out of the effective samples.
        rounding: step of the readings, in units of the residual. Where a reading moves through many steps, rounding
            errors are evenly spread and average out at least as fast as white noise, also when they look like a saw: a
            residual whose variance they explain (a twelfth of the step's square) counts for single samples, one that
            exceeds it by a fifth counts by its correlation, and in between by both in part.
    """
    variance = np.empty(len(residual))
    effective = 0.0
    for channel in channels:
        part = residual[channel]
        power = float(np.mean(np.square(part)))
        explained = rounding**2 / 12.0
        slow = min(max(power / explained - 1.0, 0.0) / _EXCESS, 1.0) if explained > 0.0 else 1.0
        variance[channel] = power * (1.0 + slow * (correlation_time(part) - 1.0))
        effective += len(part) * (power / variance[channel][0] if power > 0.0 else 1.0)
    freedom = max(effective - unknowns, 1.0)
    return Noise(variance * effective / freedom, freedom, effective)


def independent_noise(residual: np.ndarray, unknowns: int) -> Noise:
    """Noise of rows that do not repeat each other (a table): one variance, from the residual."""
    freedom = max(len(residual) - unknowns, 1)
    variance = float(residual @ residual) / freedom
    return Noise(np.full(len(residual), variance), freedom, float(len(residual)))
