"""Whether a residual is what its noise model says: samples that lie far off, and wandering that noise does not do.

Noise whose correlation is short, white or filtered, has a flat spectrum at the lowest frequencies. Drift, a burst in
the middle and an error of the model do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct
from scipy.special import fdtrc

from aerodima.optimisation.fit.robust_loss import spread

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
