"""The draw of the cars: surrogates from a design, members drawn in their own windows, weights by their own runs.

A car is held to a bracket without tail (survives one speed, flips in the turn at another) and to published figures of
runs without and with a tail. What decides the bracket is mu/SSF = friction x height / half track, and the window of
mu/SSF that meets it is narrow: some hundredths of what mu/SSF may be. So a member is drawn in three steps.

1. All but its mu/SSF and its tail, from candidates of the prior, with probability q ~ prior x surrogate likelihood of
   the figures, that of the tailed runs averaged over tails.
2. A few pilot runs say where its window lies (`aerodima.optimisation.calibration.surrogates`), and its mu/SSF is
   drawn uniformly from an interval that holds the window. It is a member when its own runs there meet the bracket.
3. It is run with a few tails (`aerodima.optimisation.calibration.tail_draw`), one of which becomes its own.

Its weight is prior density x width of the interval x likelihood of the figures without tail x mean likelihood of those
with tail / q: importance sampling, so that an error of the surrogates costs effective samples, not accuracy. (One
assumption remains: that the interval holds the whole window; its ends are 1 % quantiles of what the pilots say.)
Members come in rounds; the surrogates of a round learn from the runs of those before, and a round counts by its
effective size.
"""

from dataclasses import dataclass, replace

import numpy as np

from aerodima.optimisation.calibration.bracket_design import (
    BELOW,
    LEVELS,
    Design,
    Evaluated,
    Runner,
    Target,
    critical_ratios,
    run_through,
)
from aerodima.optimisation.calibration.calibration_plan import Round, Size
from aerodima.optimisation.calibration.calibration_runs import Datum, joined
from aerodima.optimisation.calibration.car_prior import Prior, effective_size, normalised, systematic_sample
from aerodima.optimisation.calibration.surrogates import Edge, FlipSurrogate, Surrogate, fit, surrogate_log_likelihood
from aerodima.optimisation.calibration.tail_draw import (
    LEAST_RUNS,
    Tails,
    TailSampling,
    draw_tails,
    expected_log_likelihood,
    figure_surrogate,
    tail_surrogates,
)
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import UserError

POOL = 2**14
"""Candidates of the prior that surrogates choose from."""
FLOOR = 0.02
"""Share that is added to surrogate probabilities: what a surrogate calls unlikely is still drawn now and then."""
FOCUS = 2.0
"""Factor on the discrepancy with which the first cars are chosen."""
FIRST_RATIO, FIRST_DEVIATION = 1.03, 0.09
"""Where the first cars are searched: what sliding tyres allow is about 1 (design section 7)."""
KNOWN = 0.01
"""Standard deviation of a critical mu/SSF that a surrogate learns from."""
NARROWEST = 0.003
"""Least distance of the critical mu/SSF of the two speeds."""
NEGLIGIBLE = 14.0
"""Logarithm below the largest proposal at which a candidate is not looked at with tails."""


@dataclass(frozen=True)
class Surrogates:
    """What steers the draw.

    Attributes:
        flip: over the coordinates of the car.
        car: figures of the tailless run, over the coordinates of the car.
        tailed: the other fitted figures, over the coordinates of car and tail.
    """

    flip: FlipSurrogate
    car: dict[Datum, Surrogate]
    tailed: dict[Datum, Surrogate]

    def log_likelihood(self, coordinates: FloatArray, cars: int) -> FloatArray:
        """Log likelihood (m) of bracket and figures at coordinates (m, n), of which the first `cars` are the car's."""
        own = coordinates[:, :cars]
        bracket = np.log(self.flip.bracket(own) + FLOOR)
        figures = surrogate_log_likelihood(own, self.car) + surrogate_log_likelihood(coordinates, self.tailed)
        found: FloatArray = bracket + figures
        return found


@dataclass(frozen=True)
class Draw:
    """Outcome of the draw.

    Attributes:
        target: the tailless bracket and the figures of its run.
        cars: prior over the car alone.
        sampling: prior over car and tail, figures of the other runs, number of tails.
        surrogates: at the end.
        members: the cars that meet the bracket (m), without tail.
        tails: of them.
        coordinates: of the members, each with its own tail (m, n).
        weights: of them (m), summing to 1.
        drawn: how many cars were drawn; those that miss the bracket are no members.
    """

    target: Target
    cars: Prior
    sampling: TailSampling
    surrogates: Surrogates
    members: Evaluated
    tails: Tails
    coordinates: FloatArray
    weights: FloatArray
    drawn: int

    @property
    def prior(self) -> Prior:
        """Over car and tail."""
        return self.sampling.prior

    @property
    def effective_size(self) -> float:
        """Effective sample size of the weights."""
        return effective_size(self.weights)


@dataclass(frozen=True)
class _Round:
    design: Design
    members: Evaluated
    tails: Tails
    log_weights: FloatArray


def draw_cars(target: Target, cars: Prior, sampling: TailSampling, size: Size, seed: int, runner: Runner) -> Draw:
    """Designs, runs, draws and weighs the cars; rounds go on until the effective sample size is enough.

    Raises:
        UserError: no member meets the target.
    """
    design, drawn = _first_design(target, cars, size, seed, runner), 0
    found: _Round | None = None
    parts: list[FloatArray] = []
    for place, wanted in enumerate(size.rounds):
        surrogates = _surrogates(design, found.tails if found else None, target, cars, sampling)
        new = _draw_round(target, cars, sampling, wanted, seed + 1 + place, surrogates, runner)
        design = design.merged(new.design)
        found = (
            new
            if found is None
            else replace(new, members=joined(found.members, new.members), tails=joined(found.tails, new.tails))
        )
        parts.append(new.log_weights)
        weights = _combined(parts)
        drawn += wanted.cars
        size_so_far = effective_size(weights)
        runner.progress(f"round {place + 1}: {drawn} cars drawn, effective sample size {size_so_far:.0f}")
        if size_so_far >= size.enough:
            break
    if found is None or not np.any(weights):
        raise UserError(f"none of {drawn} cars meets its bracket without tail")
    surrogates = _surrogates(design, found.tails, target, cars, sampling)
    own = found.tails.own(seed)
    return Draw(target, cars, sampling, surrogates, found.members, found.tails, own, weights, drawn)


def _draw_round(
    target: Target,
    cars: Prior,
    sampling: TailSampling,
    wanted: Round,
    seed: int,
    surrogates: Surrogates,
    runner: Runner,
) -> _Round:
    points, slow, below, log_proposal = _proposal(cars, sampling, surrogates, seed)
    probability = normalised(log_proposal)
    chosen, counts = np.unique(systematic_sample(probability, wanted.cars, seed), return_counts=True)
    before = Edge.around(slow[chosen], np.full(len(chosen), surrogates.flip.deviation))
    design = critical_ratios(target, cars, points[chosen], (before, below[chosen]), wanted.pilots, None, runner)
    coordinates, log_widths = _drawn_in_windows(cars, design, seed)
    drawn = np.flatnonzero(np.isfinite(log_widths))
    meet, members = run_through(coordinates[drawn], cars, target, runner)
    kept = drawn[meet]
    log_weights = (
        cars.log_density(cars.values(members.coordinates))
        + log_widths[kept]
        + members.log_likelihood(target)
        + np.log(counts[kept] / wanted.cars)
        - np.log(probability[chosen][kept])
    )
    there = np.isfinite(log_weights)  # within its window a car may cross the limit of what is plausible
    members = members.kept(there)
    tails = draw_tails(sampling, members.coordinates, surrogates.tailed, seed, runner)
    return _Round(_known(design, cars), members, tails, log_weights[there] + tails.log_evidence)


def _proposal(
    cars: Prior, sampling: TailSampling, surrogates: Surrogates, seed: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Candidates (m, k), their critical coordinate and how far the fast one lies below it (m), log proposal (m)."""
    flip = surrogates.flip
    points = cars.points(POOL, seed)
    slow, below = flip.edges(points)
    points[:, cars.leading] = np.clip(slow - 0.5 * below, 0.0, 1.0)
    likely, at_all = (_plausible_share(cars, points, flip.window((slow, below), reach)) for reach in (1.0, 3.0))
    with np.errstate(divide="ignore"):
        log_proposal = np.log(below * (likely + FLOOR * at_all))
    log_proposal = log_proposal + surrogate_log_likelihood(points, surrogates.car, widened=True)
    shown = log_proposal > np.max(log_proposal) - NEGLIGIBLE
    tailed = expected_log_likelihood(sampling, points[shown], surrogates.tailed, seed)
    log_proposal[shown] += tailed
    log_proposal[~shown] += np.min(tailed)
    return points, slow, below, log_proposal


def _first_design(target: Target, prior: Prior, size: Size, seed: int, runner: Runner) -> Design:
    """Cars of the prior whose critical mu/SSF are searched without any surrogate."""
    middle = (FIRST_RATIO - prior.plausible.lowest_mu_over_ssf.value) / prior.ratio_scale
    deviation = FIRST_DEVIATION / prior.ratio_scale
    low, high = np.clip([middle - deviation, middle + deviation], 0.0, 1.0)
    drawn, _ = prior.draw(64 * size.points, seed, window=lambda p: (np.full(len(p), low), np.full(len(p), high)))
    cars = drawn[np.unique(systematic_sample(_crude_likelihood(target, prior, drawn), size.points, seed))]
    guess = Edge.around(np.full(len(cars), middle), np.full(len(cars), deviation))
    below = np.full(len(cars), BELOW / prior.ratio_scale)
    return _known(critical_ratios(target, prior, cars, (guess, below), size.pilots, size.step, runner), prior)


def _crude_likelihood(target: Target, prior: Prior, cars: FloatArray) -> FloatArray:
    """What the largest lateral acceleration says before any run (m): sliding tyres give friction x gravity."""
    friction = prior.values(cars)[:, prior.leading_of_metrics[0]]
    likelihood: FloatArray = np.ones(len(cars))
    for datum in target.data:
        if datum.metric == "max_linear_acceleration_m_per_s2":
            z = (prior.base.environment.gravity * friction - datum.figure) / (FOCUS * datum.discrepancy)
            likelihood *= np.exp(-0.5 * z**2)
    return likelihood


def _plausible_share(prior: Prior, points: FloatArray, window: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Mean prior density (m) of cars with their mu/SSF within a window; 0 where none of them is plausible."""
    low, high = window
    found: FloatArray = np.mean(
        [np.exp(prior.log_density_at(points, low + level * (high - low))) for level in LEVELS], axis=0
    )
    return found


def _drawn_in_windows(prior: Prior, design: Design, seed: int) -> tuple[FloatArray, FloatArray]:
    """Cars with a mu/SSF drawn in the plausible part of their windows; log width of that part, -inf for none."""
    edges = np.clip(design.windows, 0.0, 1.0)
    draws = np.random.default_rng(seed).random(len(edges))
    coordinates = design.coordinates.copy()
    low, width = edges[:, 0], edges[:, 1] - edges[:, 0]
    inside = np.stack([np.isfinite(prior.log_density_at(coordinates, low + level * width)) for level in LEVELS], axis=1)
    inside &= (width > 0.0)[:, None]
    log_widths = np.full(len(edges), -np.inf)
    for place, cells in enumerate(inside):
        if not np.any(cells):
            continue
        cell, rest = divmod(draws[place] * np.count_nonzero(cells), 1.0)
        share = (np.flatnonzero(cells)[int(cell)] + rest) / len(LEVELS)
        coordinates[place, prior.leading] = low[place] + share * width[place]
        log_widths[place] = np.log(width[place] * np.mean(cells))
    return coordinates, log_widths


def _known(design: Design, prior: Prior) -> Design:
    """Only the cars whose critical mu/SSF are known: a surrogate learns nothing of use from the others."""
    return design.kept(np.all(design.deviations * prior.ratio_scale < KNOWN, axis=1))


def _combined(log_weights: list[FloatArray]) -> FloatArray:
    """Weights (m) of all rounds, each round scaled by its effective size over its own sum.

    Rounds estimate the same integral, so that their sums agree but for chance; which of them has the better proposal
    shows in its effective size.
    """
    parts = [normalised(each) for each in log_weights]
    scaled = np.concatenate([effective_size(part) * part for part in parts])
    total = np.sum(scaled)
    return scaled / total if total > 0.0 else scaled


def _surrogates(design: Design, tails: Tails | None, target: Target, cars: Prior, sampling: TailSampling) -> Surrogates:
    others = np.delete(design.coordinates, cars.leading, axis=1)
    slow, fast = (fit(others, edge) for edge in design.edges.T)
    flip = FlipSurrogate(cars.leading, target.speeds, slow, fast, NARROWEST / cars.ratio_scale)
    own = {}
    if len(design.rows) >= LEAST_RUNS:
        own = {
            datum: figure_surrogate(datum, datum.values(design.rows), design.upright, design.cars, cars)
            for datum in target.data
        }
    return Surrogates(flip, own, tail_surrogates(sampling, tails))
