"""Noise of a residual, estimated from the residual itself.

Filtered signals are correlated in time: n samples with autocorrelation rho_k count as
n / (1 + 2 sum rho_k) (design section 11: intervals that ignore this held the truth in 23 % of the
cases instead of 95 %). Noise whose correlation is short, white or filtered, has a flat spectrum at
the lowest frequencies; drift, a burst in the middle and an error of the model do not.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate

from aerodima.workbench.core.array_types import FloatArray

_EXCESS = 0.2
"""Excess of a residual's variance over that of its rounding, as a share of the latter, from which
rounding does not explain the residual.

The value was chosen on simulated swings, whose intervals hardly change between 0.05 and 1.
"""


@dataclass(frozen=True)
class Noise:
    """Covariance of the error of the weighted residual, and how much data it was estimated from.

    Attributes:
        covariance: covariance of the error (m x m), or its diagonal (m).
        degrees_of_freedom: degrees of freedom of the variance estimate; infinite when the variance
            is known, zero when there are no more residuals than unknowns and nothing is left to
            estimate it from.
        effective_samples: number of independent samples that the residual stands for.
        rounding: change of the residual (m) per half count of a reading that was rounded; its error
            is uniformly distributed, not normal. It is part of `covariance` (a third of its
            square).
    """

    covariance: FloatArray
    degrees_of_freedom: float = np.inf
    effective_samples: float = np.nan
    rounding: FloatArray | None = None


def correlation_time(residual: FloatArray) -> float:
    """Compute 1 + 2 sum rho_k of a signal (n), the number of samples that count as one; at least 1.

    The autocorrelation is summed in pairs until a pair is no longer positive (initial positive
    sequence): longer sums scatter too much in short logs. For a steep filter, whose autocorrelation
    rings, this takes the first lobe only and makes intervals about 8 % too wide.
    """
    x = residual - np.mean(residual)
    n = len(x)
    power = float(x @ x)
    if n < 4 or power <= 0.0:
        return 1.0
    rho = correlate(x, x, method="fft")[n - 1 :][: n // 2] / power
    pairs = rho[0 : len(rho) - 1 : 2] + rho[1 : len(rho) : 2]
    falls = pairs <= 0.0
    end = int(np.argmax(falls)) if np.any(falls) else len(pairs)
    return max(1.0, float(2.0 * np.sum(pairs[:end]) - 1.0))


def serial_noise(
    residual: FloatArray, channels: list[slice], unknowns: int, rounding: float = 0.0
) -> Noise:
    """Estimate the noise of time series, one per channel, from the residual itself: its variance,
    times its correlation time.

    Args:
        residual: weighted residual of all channels (m).
        channels: rows of each time series in the residual.
        unknowns: number of free parameters; it is subtracted from the effective samples.
        rounding: step of the readings, in units of the residual. Where a reading moves through many
            steps, rounding errors are uniformly distributed and average out at least as fast as
            white noise, even when they look like a sawtooth: a residual whose variance they explain
            (a twelfth of the step's square) counts for single samples, one that exceeds it by a
            fifth counts by its correlation, and one in between by both in part.
    """
    variance = np.empty(len(residual))
    effective = 0.0
    for channel in channels:
        part = residual[channel]
        power = float(np.mean(np.square(part)))
        explained = rounding**2 / 12.0
        slow = 1.0
        if explained > 0.0:
            slow = min(max(power / explained - 1.0, 0.0) / _EXCESS, 1.0)
        variance[channel] = power * (1.0 + slow * (correlation_time(part) - 1.0))
        effective += len(part) * (power / variance[channel][0] if power > 0.0 else 1.0)
    freedom = max(effective - unknowns, 1.0)
    known = freedom if len(residual) > unknowns else 0.0
    return Noise(variance * effective / freedom, known, effective)


def independent_noise(residual: FloatArray, unknowns: int) -> Noise:
    """Estimate the noise of independent rows, such as those of a table: one variance, from the
    residual.
    """
    freedom = max(len(residual) - unknowns, 0)
    variance = float(residual @ residual) / max(freedom, 1)
    return Noise(np.full(len(residual), variance), freedom, float(len(residual)))
