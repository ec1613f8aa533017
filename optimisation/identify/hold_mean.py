"""Mean readings of a static hold without the drift of the sensor, and signs of more than noise."""

from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.identify.huber import Loss, clip, huber_weight, spread
from aerodima.optimisation.identify.noise import correlation_time
from aerodima.optimisation.identify.residual_check import (
    CHANCE,
    FAR_OFF,
    FEW_FAR_OFF,
    ResidualCheck,
    chance_of,
    check_residual,
)
from aerodima.workbench.core.array_types import FloatArray

_MAX_ROUNDS = 40
"""Largest number of rounds of the robust regression."""
_SETTLED = 1e-4
"""Change, in scales, below which the robust regression has settled."""
MAX_CORRELATED = 8192
"""Largest number of samples from which the correlation time of a noise is taken."""


@dataclass(frozen=True)
class HoldMean:
    """Means of k readings over a hold.

    Attributes:
        value: step of each reading at the end of the rest, or its mean without a rest (k).
        variance: variance of the error of `value` from noise (k).
        lags: number of samples that count as one (k).
        checks: checks of the residual of each reading (k).
    """

    value: FloatArray
    variance: FloatArray
    lags: FloatArray
    checks: tuple[ResidualCheck, ...]


def hold_mean(
    time: FloatArray, values: FloatArray, step: FloatArray | None, loss: Loss = "squares"
) -> HoldMean:
    """Fits a line over time, and the step, to each reading.

    Args:
        time: times of the samples (n), s.
        values: readings (k x n).
        step: 0 in the rest and 1 in the hold (n); None without a rest.
        loss: loss function, `squares` or `huber`, which holds back samples that lie far off.
    """
    constant = np.ones_like(time)
    drift = time - time.mean()
    # The wanted coefficient stands last.
    design = np.stack([drift, constant] if step is None else [constant, drift, step])
    readings = [_reading_mean(row, design, loss) for row in values]
    means, variances, lags, checks = zip(*readings, strict=True)
    return HoldMean(np.array(means), np.array(variances), np.array(lags), checks)


def _reading_mean(
    row: FloatArray, design: FloatArray, loss: Loss
) -> tuple[float, float, float, ResidualCheck]:
    """Fits one reading; returns the last coefficient, its variance, lag and check."""
    count = len(design)
    coefficients, scatter, widened = _coefficients(row, design, loss)
    lag = correlation_time(scatter[:MAX_CORRELATED])
    freedom = max(len(row) / lag - count, 1.0)
    share = np.linalg.inv(design @ design.T)[-1, -1]
    variance = float(scatter @ scatter) / freedom * widened * share
    check = check_residual(scatter, count)
    if loss == "squares" and (check.far_off or chance_of([check]) < CHANCE):
        # Samples far off have bent the fit; a robust fit, which is bent less, shows how far off.
        robust, _, _ = _coefficients(row, design, "huber")
        check = check_residual(row - robust @ design, count)
    return coefficients[-1], variance, lag, check


def _coefficients(
    row: FloatArray, design: FloatArray, loss: Loss
) -> tuple[FloatArray, FloatArray, float]:
    """Solves for one reading; returns the coefficients, the residual, which `huber` clips, and the
    factor by which clipping widens the variance.
    """
    solution = row @ design.T @ np.linalg.inv(design @ design.T)
    residual = row - solution @ design
    if loss == "squares":
        return solution, residual, 1.0
    for _ in range(_MAX_ROUNDS):
        scale = spread(residual)
        if scale == 0.0:
            return solution, residual, 1.0
        weight = huber_weight(residual / scale)
        weighted = design * weight
        before = solution
        solution = (row * weight) @ design.T @ np.linalg.inv(weighted @ design.T)
        residual = row - solution @ design
        change = np.abs((solution - before) @ design)
        if np.max(change) < _SETTLED * scale:
            break
    clipped, within = clip(residual, scale)
    return solution, clipped, 1.0 / within**2


def residual_warnings(mean: HoldMean, channels: list[str], time: FloatArray) -> list[str]:
    """Warn of readings that behave as noise does not."""
    checks = dict(zip(channels, mean.checks, strict=True))
    far = {name: check for name, check in checks.items() if check.far_off >= FEW_FAR_OFF}
    warnings = []
    if far:
        worst = max(far.values(), key=lambda check: check.far_off)
        warnings.append(
            f"{', '.join(far)}: up to {worst.far_off} samples lie more than {FAR_OFF:g} standard "
            "deviations off, the "
            f"first at {time[worst.first]:g} s: no noise does that (try --loss huber)"
        )
    if chance_of(mean.checks) < CHANCE:
        name, check = max(checks.items(), key=lambda pair: pair[1].wander)
        warnings.append(
            f"the readings wander about the fitted drift as noise does not ({name}: by up to "
            f"{check.swing:.2g}, slow "
            f"power {check.wander:.3g} times that of its noise): the intervals are too narrow"
        )
    return warnings
