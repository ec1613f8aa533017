"""What the targets say about the parameters: sensitivities, shrinkage of the prior, and what stays undetermined.

A direction of the parameters is undetermined when its variance after the calibration is that of the prior. The
directions are the generalised eigenvectors of C_posterior v = lambda C_prior v, so lambda is that ratio. Parameters
that are positive count by their logarithm: a product such as friction x height is then a direction.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import eigh
from scipy.stats import sobol_indices, uniform

from aerodima.optimisation.calibration.car_prior import HEIGHT, Prior, normalised
from aerodima.optimisation.calibration.member_draw import Draw
from aerodima.optimisation.calibration.surrogates import predictions
from aerodima.workbench.config.array_types import FloatArray

SAMPLES, RESAMPLES = 2**11, 200
"""Of the Sobol indices: base samples, and resamples for their intervals."""
MU_OVER_SSF = "mu/SSF"
"""What varies in the place of the height of the centre of mass."""
CANDIDATES = 2**17
"""Of the prior, for the covariances: with some hundred of them effective after the calibration, the least determined
variances scatter by about a tenth of the prior's; with a quarter of it a third combination seemed determined."""
FLIP_SPEED = "flip_speed_m_per_s"
NAMED = 0.35
"""A parameter is named in a direction when its loading reaches this share of the largest."""


@dataclass(frozen=True)
class Direction:
    """One combination of parameters.

    Attributes:
        ratio: variance after the calibration over that of the prior.
        loadings: (n), in standard deviations of the prior, largest magnitude 1.
        words: the combination, largest loadings first.
    """

    ratio: float
    loadings: FloatArray
    words: str


def sensitivities(draw: Draw, seed: int, samples: int = SAMPLES) -> pd.DataFrame:
    """Sobol indices of each fitted quantity over the prior's coordinates, from the surrogates.

    The first-order index of a parameter is the share of the variance that it explains alone, the total index that in
    which it takes part at all (Saltelli et al. 2010, doi 10.1016/j.cpc.2009.09.018, by `scipy.stats.sobol_indices`).
    Coordinates are independent and uniform; that of the height of the centre of mass is mu/SSF (`Prior`). Cars that
    the prior rules out are among them, since independence ends there.

    Args:
        draw: with the surrogates.
        seed: of the samples.
        samples: a power of two; each takes a run of the surrogates per parameter and two more.

    Returns:
        One row per target and parameter: `target` (source and metric, with unit at its end), `parameter`, `first` and
        `total`, and `_low` and `_high` of both, 95 % intervals by bootstrap: of the sampling, not of the surrogates.
    """
    prior, cars, surrogates = draw.prior, len(draw.cars.keys), draw.surrogates

    def predicted(coordinates: FloatArray) -> FloatArray:
        points = coordinates.T
        own, tailed = list(surrogates.car.values()), list(surrogates.tailed.values())
        flip_speed = surrogates.flip.flip_speed(points[:, :cars])
        return np.array([flip_speed, *predictions(points[:, :cars], own), *predictions(points, tailed)])

    targets = [FLIP_SPEED, *(datum.name for datum in (*surrogates.car, *surrogates.tailed))]
    names = [MU_OVER_SSF if key == HEIGHT else key for key in prior.keys]
    return sobol_table(predicted, targets, names, samples, seed)


def sobol_table(
    predicted: Callable[[FloatArray], FloatArray], targets: list[str], names: list[str], samples: int, seed: int
) -> pd.DataFrame:
    """Sobol indices of quantities over independent coordinates that are uniform from 0 to 1; see `sensitivities`.

    Args:
        predicted: quantities (targets, n) at points (coordinates, n).
        targets: their names.
        names: of the coordinates.
        samples: a power of two.
        seed: of the samples.
    """
    generator, runs = np.random.default_rng(seed), list[FloatArray]()

    def indices(f_A: FloatArray, f_B: FloatArray, f_AB: FloatArray) -> FloatArray:
        runs[:] = f_A, f_B, f_AB
        return _first_and_total(f_A, f_B, f_AB)

    dists = [uniform()] * len(names)
    found = sobol_indices(func=predicted, n=samples, dists=dists, rng=generator, method=indices)
    # Not the bootstrap of SciPy's result: it takes no seed, so that the same calibration would have other intervals.
    drawn = generator.integers(0, samples, (RESAMPLES, samples))
    resampled = [_first_and_total(*(values[..., places] for values in runs)) for places in drawn]
    lows, highs = np.quantile(resampled, [0.025, 0.975], axis=0)
    table = pd.DataFrame({"target": np.repeat(targets, len(names)), "parameter": names * len(targets)})
    for name, values, low, high in zip(
        ("first", "total"), (found.first_order, found.total_order), lows, highs, strict=True
    ):
        ends = {"": values, "_low": low, "_high": high}
        table = table.assign(**{name + end: np.reshape(numbers, -1) for end, numbers in ends.items()})
    return table


def _first_and_total(f_A: FloatArray, f_B: FloatArray, f_AB: FloatArray) -> FloatArray:
    """Indices (2, targets, coordinates) of runs (targets, n) and (coordinates, targets, n).

    Saltelli et al. 2010, table 2, b and f; the runs are centred.
    """
    first = np.mean(f_B * (f_AB - f_A), axis=-1)
    total = 0.5 * np.mean((f_A - f_AB) ** 2, axis=-1)
    found: FloatArray = (np.array([first, total]) / np.var([f_A, f_B], axis=(0, -1))).transpose(0, 2, 1)
    return found


def shrinkage(prior: Prior, values: FloatArray, weights: FloatArray, reference: FloatArray) -> FloatArray:
    """1 - variance of the members over the variance of the prior, per parameter (n): 0 = nothing was learnt.

    Args:
        prior: for the scale of the parameters.
        values: of the members (m, n).
        weights: of the members (m).
        reference: cars of the prior (k, n), equally likely.
    """
    scaled, plain = _scaled(prior, values), _scaled(prior, reference)
    mean = weights @ scaled
    result: FloatArray = 1.0 - (weights @ (scaled - mean) ** 2) / np.var(plain, axis=0)
    return result


def directions(draw: Draw, seed: int) -> list[Direction]:
    """Combinations of parameters, best determined first; from candidates of the prior with the draw's surrogates.

    The members themselves are too few for a covariance of this size.
    """
    prior, cars, surrogates = draw.prior, len(draw.cars.keys), draw.surrogates
    flip = surrogates.flip
    plain, log_plain = prior.draw(CANDIDATES, seed)
    points, log_prior = prior.draw(CANDIDATES, seed, window=lambda p: flip.window(flip.edges(p[:, :cars])))
    log_after = log_prior + surrogates.log_likelihood(points, cars)
    pairs = (plain, normalised(log_plain)), (points, normalised(log_after))
    before, after = (_covariance(_scaled(prior, prior.values(each)), shares) for each, shares in pairs)
    deviation = np.sqrt(np.diag(before))
    ratios, vectors = eigh(after / np.outer(deviation, deviation), before / np.outer(deviation, deviation))
    found = []
    for ratio, vector in zip(ratios, vectors.T, strict=True):
        loadings = vector / vector[int(np.argmax(np.abs(vector)))]
        found.append(Direction(float(ratio), loadings, _in_words(loadings, prior)))
    return found


def _scaled(prior: Prior, values: FloatArray) -> FloatArray:
    positive = prior.ranges[:, 0] > 0.0
    return np.where(positive, np.log(np.where(positive, values, 1.0)), values)


def _covariance(points: FloatArray, weights: FloatArray) -> FloatArray:
    centred = points - weights @ points
    return (centred.T * weights) @ centred


def _in_words(loadings: FloatArray, prior: Prior) -> str:
    order = [i for i in np.argsort(-np.abs(loadings)) if abs(loadings[i]) >= NAMED][:5]
    words = ""
    for place, i in enumerate(order):
        name = f"log {prior.keys[i]}" if prior.ranges[i, 0] > 0.0 else prior.keys[i]
        sign = "-" if loadings[i] < 0 else "+" if place else ""
        words += f"{' ' if place else ''}{sign}{' ' if place and sign else ''}{abs(loadings[i]):.2f} {name}"
    return words
