"""The stage of the car: surrogates from a design, members drawn in their own windows, weights by their own runs.

A car is held to a bracket (survives one speed, flips in the turn at another) and to a row of published metrics. What
decides the bracket is the group friction x height / half track, and the window of the group that meets it is narrow:
some hundredths of what the group may be. So a member is drawn in two steps.

1. All but its group, from candidates of the prior, with probability q ~ prior x surrogate likelihood of the metrics.
2. Its window is searched by bisection at both speeds, with its own runs at the default step, and its group is drawn
   uniformly within the window.

Its weight is prior density x width of the window x likelihood of the metrics / q, zero where its runs at the drawn
group miss the bracket: importance sampling, so that an error of the surrogates costs effective samples, not accuracy.
(One assumption remains: that a car meets the bracket in one window only, the one that the bisection finds.) Members
come in rounds; the surrogates of a round learn from the runs of those before, and a round counts by its effective size.
"""

from dataclasses import dataclass

import numpy as np

from optimisation.calibration.design import Design, Evaluated, FloatArray, Runner, Target, critical_groups, run_cars
from optimisation.calibration.plan import CALIBRATED_METRICS, CarStage, Round
from optimisation.calibration.prior import Prior
from optimisation.calibration.surrogate import FlipSurrogate, Surrogate, fit
from optimisation.calibration.weights import effective_size, log_likelihood, normalised, systematic_sample
from workbench.errors import UserError

POOL = 2**14
"""Candidates of the prior that surrogates choose from."""
FLOOR = 0.02
"""Added to surrogate probabilities: what a surrogate excludes is still drawn now and then."""
LEVELS = (np.arange(16) + 0.5) / 16
"""Places within a window at which it is asked whether a car is plausible."""
DEVIATIONS = 2.5
"""Of the surrogate of the flip: how far around its guess the flip is searched."""
LEAST_RUNS = 8
"""Runs that a surrogate of the metrics needs."""


@dataclass(frozen=True)
class StageResult:
    """Outcome of the stage.

    Attributes:
        target: that the members were held to.
        prior: its keys name the columns.
        flip: surrogate of the flip.
        metrics: surrogates of the metrics at the survived speed.
        members: the cars that were drawn for weights.
        weights: of them (m), summing to 1.
        drawn: how many cars were drawn; those without a window are no members.
        pool: candidates (k, n) from the prior within the surrogate's window.
        pool_prior, pool_posterior: weights (k) of the candidates before and after the targets, by the surrogates.
    """

    target: Target
    prior: Prior
    flip: FlipSurrogate
    metrics: dict[str, Surrogate]
    members: Evaluated
    weights: FloatArray
    drawn: int
    pool: FloatArray
    pool_prior: FloatArray
    pool_posterior: FloatArray

    @property
    def effective_size(self) -> float:
        """Effective sample size of the weights."""
        return effective_size(self.weights)


@dataclass(frozen=True)
class _Round:
    design: Design
    members: Evaluated
    log_weights: FloatArray


def run_stage(target: Target, prior: Prior, size: CarStage, seed: int, runner: Runner) -> StageResult:
    """Designs, runs, draws and weighs the cars.

    Raises:
        UserError: no member meets the target.
    """
    first, _ = prior.draw(16 * size.points, seed)
    whole = np.tile([0.0, 1.0], (size.points, 1))
    design = critical_groups(target, prior, first[: size.points], whole, (size.halvings,) * 2, size.step, runner)
    rounds: list[_Round] = []
    for place, wanted in enumerate(size.rounds):
        flip, metrics = _surrogates(design, target, prior)
        rounds.append(_draw_round(target, prior, wanted, seed + 1 + place, flip, metrics, runner))
        design = design.merged(rounds[-1].design)
    flip, metrics = _surrogates(design, target, prior)
    members = rounds[0].members
    for other in rounds[1:]:
        members = members.merged(other.members)
    weights = _combined([each.log_weights for each in rounds])
    if not np.any(weights):
        raise UserError(f"none of {len(weights)} cars meets its target with tail {target.tail_mode!r}")
    pool, log_prior = prior.draw(POOL, seed, window=flip.window)
    posterior = normalised(
        log_prior + np.log(flip.bracket(pool) + FLOOR) + _surrogate_log_likelihood(pool, metrics, target)
    )
    before = normalised(log_prior)
    return StageResult(
        target,
        prior,
        flip,
        metrics,
        members,
        weights,
        sum(wanted.cars for wanted in size.rounds),
        pool,
        before,
        posterior,
    )


def real_log_likelihood(runs: Evaluated, target: Target) -> FloatArray:
    """Log likelihood (m) of the target from the runs themselves, up to a constant; -inf where it is not met."""
    metrics: FloatArray = np.zeros(len(runs.coordinates))
    if target.published is not None:
        columns = {name: runs.slow[name].to_numpy(float) for name in CALIBRATED_METRICS}
        metrics = log_likelihood(columns, target.published, target.discrepancy)
    return np.where(runs.meet, metrics, -np.inf)


def _draw_round(
    target: Target,
    prior: Prior,
    wanted: Round,
    seed: int,
    flip: FlipSurrogate,
    metrics: dict[str, Surrogate],
    runner: Runner,
) -> _Round:
    points = prior.points(POOL, seed)
    low, high = flip.window(points, DEVIATIONS)
    points[:, prior.leading] = flip.guess(points)
    shares = np.mean([np.exp(_density_at(prior, points, low + level * (high - low))) for level in LEVELS], axis=0)
    log_proposal = np.log(shares + FLOOR * np.max(shares)) + _surrogate_log_likelihood(points, metrics, target)
    probability = normalised(log_proposal)
    chosen, counts = np.unique(systematic_sample(probability, wanted.cars, seed), return_counts=True)
    searched = np.column_stack([low[chosen], high[chosen]])
    design = critical_groups(target, prior, points[chosen], searched, wanted.halvings, None, runner)
    coordinates, log_widths = _drawn_in_windows(prior, design, seed)
    kept = np.isfinite(log_widths)
    members = run_cars(coordinates[kept], prior, target, runner)
    log_weights = (
        prior.log_density(prior.values(members.coordinates))
        + log_widths[kept]
        + real_log_likelihood(members, target)
        + np.log(counts[kept] / wanted.cars)
        - np.log(probability[chosen][kept])
    )
    return _Round(_found(design), members, log_weights)


def _drawn_in_windows(prior: Prior, design: Design, seed: int) -> tuple[FloatArray, FloatArray]:
    """Cars with a group drawn in the plausible part of their windows; log width of that part, -inf for none."""
    edges = design.windows
    draws = np.random.default_rng(seed).random(len(edges))
    coordinates = design.coordinates.copy()
    low, width = edges[:, 0], edges[:, 1] - edges[:, 0]
    inside = np.stack(
        [np.isfinite(_density_at(prior, coordinates, np.nan_to_num(low + level * width))) for level in LEVELS], axis=1
    )
    inside &= np.isfinite(width)[:, None]
    log_widths = np.full(len(edges), -np.inf)
    for place, cells in enumerate(inside):
        if not np.any(cells):
            continue
        cell, rest = divmod(draws[place] * np.count_nonzero(cells), 1.0)
        share = (np.flatnonzero(cells)[int(cell)] + rest) / len(LEVELS)
        coordinates[place, prior.leading] = low[place] + share * width[place]
        log_widths[place] = np.log(width[place] * np.mean(cells))
    return coordinates, log_widths


def _density_at(prior: Prior, points: FloatArray, group: FloatArray) -> FloatArray:
    moved = points.copy()
    moved[:, prior.leading] = group
    return prior.log_density(prior.values(moved))


def _found(design: Design) -> Design:
    """Only the cars whose flip was found: a surrogate learns nothing of use from the others."""
    kept = np.flatnonzero(design.found)
    runs = np.isin(design.cars, kept)
    return Design(
        design.coordinates[kept],
        design.slow[kept],
        design.fast[kept],
        design.searched[kept],
        design.upright[runs],
        design.rows[runs].reset_index(drop=True),
        np.searchsorted(kept, design.cars[runs]),
    )


def _combined(log_weights: list[FloatArray]) -> FloatArray:
    """Weights (m) of all rounds, each round scaled by its effective size over its own sum.

    Rounds estimate the same integral, so that their sums agree but for chance; which of them has the better proposal
    shows in its effective size.
    """
    parts = [normalised(each) for each in log_weights]
    scaled = np.concatenate([effective_size(part) * part for part in parts])
    total = np.sum(scaled)
    return scaled / total if total > 0.0 else scaled


def _surrogates(design: Design, target: Target, prior: Prior) -> tuple[FlipSurrogate, dict[str, Surrogate]]:
    others = np.delete(design.coordinates, prior.leading, axis=1)
    slow, fast = (fit(others, np.mean(ends, axis=1)) for ends in (design.slow, design.fast))
    flip = FlipSurrogate(prior.leading, target.speeds, slow, fast, design.resolution)
    if target.published is None or len(design.rows) < LEAST_RUNS:
        return flip, {}
    columns = {name: design.rows[name].to_numpy(float) for name in CALIBRATED_METRICS}
    return flip, {
        name: fit(design.upright, values, design.cars, prior.leading_of_metrics) for name, values in columns.items()
    }


def _surrogate_log_likelihood(coordinates: FloatArray, metrics: dict[str, Surrogate], target: Target) -> FloatArray:
    if target.published is None or not metrics:
        return np.zeros(len(coordinates))
    predicted = {name: surrogate.predict(coordinates) for name, surrogate in metrics.items()}
    return log_likelihood(predicted, target.published, target.discrepancy)
