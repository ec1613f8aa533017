"""From log weights to weights: normalisation, effective sample size, draws by weight."""

import numpy as np
from numpy.typing import NDArray

from aerodima.workbench.config.array_types import FloatArray


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
