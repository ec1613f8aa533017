"""Checks of a residual in the order of time: samples far off, and slow wandering."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct
from scipy.special import fdtrc

from aerodima.optimisation.identify.huber import spread
from aerodima.workbench.core.array_types import FloatArray

FAR_OFF = 6.0
"""Distance, in robust standard deviations, beyond which a sample is not noise: probability 2e-9
under a normal distribution."""
FEW_FAR_OFF = 3
"""Smallest number of such samples that is reported."""
_SLOW = 10
"""Number of the first modes of the cosine transform, in which wandering shows."""
_NEXT = 60
"""End of the modes whose power is compared with theirs."""
_MIN_SAMPLES = 4 * _NEXT
"""Smallest number of samples in which wandering is looked for."""
CHANCE = 1e-5
"""Probability below which wandering is not noise."""


@dataclass(frozen=True)
class ResidualCheck:
    """Findings in a residual.

    Attributes:
        far_off: number of samples beyond six robust standard deviations.
        first: row of the first of these samples; -1 without one.
        wander: ratio of the power of the slowest modes to that of the next ones; about 1 for noise.
        freedom: degrees of freedom of the slowest modes and of the next ones.
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
        residual: residual of one reading (n).
        unknowns: number of unknowns that were fitted to it, a constant among them; each takes the
            freedom of one slow mode.
    """
    x = residual - np.median(residual)
    scale = spread(x)
    if scale == 0.0 or len(x) < _MIN_SAMPLES:
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
    """Compute the probability that noise wanders as much as several residuals together do."""
    slow = sum(check.freedom[0] for check in checks)
    following = sum(check.freedom[1] for check in checks)
    return float(fdtrc(slow, following, np.mean([check.wander for check in checks])))
