"""From real runs to weights: likelihood of the published figures, importance weights, effective sample size."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from optimisation.calibration.plan import CALIBRATED_METRICS, Discrepancy
from workbench.published import PublishedFigures

FloatArray = NDArray[np.float64]


def log_likelihood(
    metrics: Mapping[str, FloatArray], published: PublishedFigures, discrepancy: Mapping[str, Discrepancy]
) -> FloatArray:
    """Logarithm of the probability of the published metrics given those of cars (m), up to a constant.

    Gaussian, independent, with the plan's discrepancy as standard deviation relative to the published figure.

    Args:
        metrics: name -> values (m) of `CALIBRATED_METRICS`.
        published: row of the table.
        discrepancy: name -> model discrepancy.
    """
    total: FloatArray = np.zeros(len(next(iter(metrics.values()))))
    for name in CALIBRATED_METRICS:
        figure = getattr(published.metrics, name)
        total = total - 0.5 * ((np.asarray(metrics[name]) - figure) / (discrepancy[name].relative * figure)) ** 2
    return total


def normalised(log_weights: FloatArray) -> FloatArray:
    """Weights (m) that sum to 1; zero where the logarithm is -inf. All zero if there is none above."""
    finite = np.isfinite(log_weights)
    if not np.any(finite):
        return np.zeros(len(log_weights))
    weights = np.where(finite, np.exp(np.where(finite, log_weights, 0.0) - np.max(log_weights[finite])), 0.0)
    return weights / np.sum(weights)


def effective_size(weights: FloatArray) -> float:
    """Effective sample size (sum w)^2 / sum w^2; 0 for weights that are all zero."""
    power = float(np.sum(np.square(weights)))
    return float(np.sum(weights)) ** 2 / power if power > 0.0 else 0.0


def systematic_sample(weights: FloatArray, number: int, seed: int) -> NDArray[np.int64]:
    """Indices of `number` draws with probability proportional to the weights, by systematic resampling."""
    start = np.random.default_rng(seed).random()
    places = (start + np.arange(number)) / number
    cumulative = np.cumsum(weights) / np.sum(weights)
    return np.minimum(np.searchsorted(cumulative, places), len(weights) - 1)
