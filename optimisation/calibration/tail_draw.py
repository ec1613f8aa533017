"""Tails for the cars of a calibration: each car is run with a few, and is as likely as they are on average.

A car that meets the tailless bracket gets its tails by importance sampling: from candidates of the prior, with a
probability in which a surrogate's likelihood of the fitted figures counts. The likelihood of a tail is that of its own
runs. The weight of the car takes the mean over its tails, and one of them, drawn by its part, becomes the car's own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import qmc

from aerodima.optimisation.calibration.bracket_design import Runner, run_turns
from aerodima.optimisation.calibration.calibration_runs import Datum, Turn, log_likelihood
from aerodima.optimisation.calibration.car_prior import Prior, normalised, systematic_sample
from aerodima.optimisation.calibration.surrogates import Surrogate, fit, surrogate_log_likelihood
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import UserError

CANDIDATES = 64
"""Tails of the prior that those of a car are drawn from; a few have a sail longer than the tail."""
AVERAGED = 8
"""Tails over which the likelihood of a car that is yet to be drawn is averaged."""
OF_THE_PRIOR = 0.25
"""Share of the tails that are drawn whatever the surrogates say."""
LEAST_RUNS = 8
"""Runs that a surrogate of a figure needs."""
FARTHEST = 6.0
"""Discrepancies beyond which a figure is, for a surrogate, as far off as it can be."""


@dataclass(frozen=True)
class TailSampling:
    """What tails are drawn for.

    Attributes:
        prior: over car and tail; the coordinates of the car come first.
        data: fitted figures that the tailless bracket's own runs do not show.
        tails: for each car.
    """

    prior: Prior
    data: tuple[Datum, ...]
    tails: int

    @property
    def turns(self) -> tuple[Turn, ...]:
        """The runs that each tail takes."""
        return tuple(dict.fromkeys(datum.turn for datum in self.data))


@dataclass(frozen=True)
class Tails:
    """Cars with their tails, and what runs say of these.

    Attributes:
        coordinates: of car and tail (m, k, n).
        log_weights: of the tails (m, k): prior x likelihood over probability of the draw, over k.
        values: name of the datum -> metric (m, k).
    """

    coordinates: FloatArray
    log_weights: FloatArray
    values: dict[str, FloatArray]

    @property
    def log_evidence(self) -> FloatArray:
        """Logarithm of the likelihood of each car (m), averaged over the tails of the prior."""
        found: FloatArray = logsumexp(self.log_weights, axis=1) if len(self.log_weights) else np.zeros(0)
        return found

    def own(self, seed: int) -> FloatArray:
        """Coordinates (m, n) of the cars with one of their tails each, drawn by its part of the evidence."""
        draws = np.random.default_rng(seed).random(len(self.coordinates))
        places = []
        for draw, logs in zip(draws, self.log_weights, strict=True):
            shares = np.cumsum(normalised(logs))
            places.append(min(int(np.searchsorted(shares, draw)), len(logs) - 1) if shares[-1] > 0.0 else 0)
        return self.coordinates[np.arange(len(places)), places]


def draw_tails(
    sampling: TailSampling, cars: FloatArray, surrogates: dict[Datum, Surrogate], seed: int, runner: Runner
) -> Tails:
    """Gives each car of (m, k) tails and runs them.

    Raises:
        UserError: a car has no plausible tail.
    """
    joint = _with_tails(sampling.prior, cars, CANDIDATES, seed)
    flat = joint.reshape(-1, joint.shape[2])
    plausible = sampling.prior.are_plausible(sampling.prior.values(flat)).reshape(joint.shape[:2])
    log_surrogate = surrogate_log_likelihood(flat, surrogates, widened=True).reshape(joint.shape[:2])
    chosen, log_proposals = [], []
    for place, (there, logs) in enumerate(zip(plausible, log_surrogate, strict=True)):
        if not np.any(there):
            raise UserError(f"a car of the calibration has no plausible tail among {CANDIDATES} drawn")
        likely = normalised(np.where(there, logs, -np.inf))
        probability = OF_THE_PRIOR * there / np.count_nonzero(there) + (1.0 - OF_THE_PRIOR) * likely
        own = systematic_sample(probability, sampling.tails, seed + place)
        chosen.append(joint[place, own])
        log_proposals.append(np.log(CANDIDATES * probability[own]))
    coordinates = np.array(chosen).reshape(len(cars), sampling.tails, joint.shape[2])
    values, logs = run_tails(sampling, coordinates.reshape(-1, joint.shape[2]), runner)
    shape = coordinates.shape[:2]
    log_weights = logs.reshape(shape) - np.array(log_proposals).reshape(shape) - np.log(sampling.tails)
    return Tails(coordinates, log_weights, {name: found.reshape(shape) for name, found in values.items()})


def run_tails(
    sampling: TailSampling, coordinates: FloatArray, runner: Runner
) -> tuple[dict[str, FloatArray], FloatArray]:
    """Metrics by name of the datum (m), and log likelihood (m), of cars with tails (m, n), from their own runs."""
    rows = run_turns(coordinates, sampling.prior, sampling.turns, runner)
    values = {datum.name: datum.values(rows[datum.turn]) for datum in sampling.data}
    return values, log_likelihood(sampling.data, values, len(coordinates))


def tail_surrogates(sampling: TailSampling, tails: Tails | None) -> dict[Datum, Surrogate]:
    """One surrogate per figure over car and tail; none from too few runs."""
    if tails is None or tails.log_weights.size < LEAST_RUNS:
        return {}
    cars, number = tails.log_weights.shape
    coordinates = tails.coordinates.reshape(cars * number, -1)
    whose = np.repeat(np.arange(cars), number)
    return {
        datum: figure_surrogate(datum, tails.values[datum.name].ravel(), coordinates, whose, sampling.prior)
        for datum in sampling.data
    }


def figure_surrogate(
    datum: Datum, values: FloatArray, coordinates: FloatArray, cars: NDArray[np.int64], prior: Prior
) -> Surrogate:
    """Surrogate of one figure from runs (m), far ones as far as `FARTHEST`."""
    reach = FARTHEST * datum.discrepancy
    clipped = np.clip(np.nan_to_num(values, nan=datum.figure + reach), datum.figure - reach, datum.figure + reach)
    return fit(coordinates, clipped, cars, prior.leading_of_metrics)


def expected_log_likelihood(
    sampling: TailSampling, cars: FloatArray, surrogates: dict[Datum, Surrogate], seed: int
) -> FloatArray:
    """Logarithm of the likelihood (m) that surrogates give cars (m, k), averaged over some tails of the prior."""
    if not surrogates:
        return np.zeros(len(cars))
    joint = _with_tails(sampling.prior, cars, AVERAGED, seed)
    logs = surrogate_log_likelihood(joint.reshape(-1, joint.shape[2]), surrogates, widened=True)
    found: FloatArray = logsumexp(logs.reshape(len(cars), AVERAGED), axis=1) - np.log(AVERAGED)
    return found


def _with_tails(prior: Prior, cars: FloatArray, number: int, seed: int) -> FloatArray:
    """Cars (m, k) with tails of the prior: (m, number, n); the tails of each car are a shifted Sobol sequence."""
    free = len(prior.keys) - cars.shape[1]
    points = qmc.Sobol(free, seed=seed).random_base2(int(np.ceil(np.log2(number))))[:number]
    shifts = np.random.default_rng(seed).random((len(cars), 1, free))
    tails = (points + shifts) % 1.0
    own = np.broadcast_to(cars[:, None, :], (len(cars), number, cars.shape[1]))
    return np.concatenate([own, tails], axis=2)
