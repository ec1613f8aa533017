"""The stage of the car: surrogates from a design, members drawn in their own windows, weights by their own runs.

A car is held to a bracket (survives one speed, flips in the turn at another) and to a row of published metrics. What
decides the bracket is the group friction x height / half track, and the window of the group that meets it is narrow:
some hundredths of what the group may be. So a member is drawn in two steps.

1. All but its group, from candidates of the prior, with probability q ~ prior x surrogate likelihood of the metrics.
2. A few pilot runs say where its window lies (`optimisation.calibration.edge`), and its group is drawn uniformly from
   an interval that holds the window. It is a member when its own runs at the drawn group meet the bracket.

Its weight is prior density x width of the interval x likelihood of the metrics / q: importance sampling, so that an
error of the surrogates costs effective samples, not accuracy. (One assumption remains: that the interval holds the
whole window; its ends are 1 % quantiles of what the pilots say.) Members come in rounds; the surrogates of a round
learn from the runs of those before, and a round counts by its effective size.
"""

from dataclasses import dataclass

import numpy as np

from optimisation.calibration.design import (
    BELOW,
    LEVELS,
    Design,
    Evaluated,
    FloatArray,
    Runner,
    Target,
    critical_groups,
    run_through,
)
from optimisation.calibration.edge import Edge
from optimisation.calibration.plan import CALIBRATED_METRICS, CarStage, Discrepancy, Round
from optimisation.calibration.prior import Prior
from optimisation.calibration.surrogate import FlipSurrogate, Surrogate, fit
from optimisation.calibration.weights import effective_size, log_likelihood, normalised, systematic_sample
from workbench.errors import UserError

POOL = 2**14
"""Candidates of the prior that surrogates choose from."""
FLOOR = 0.02
"""Share that is added to surrogate probabilities: what a surrogate calls unlikely is still drawn now and then."""
FOCUS = 2.0
"""Factor on the discrepancy with which the first cars are chosen."""
FIRST_GROUP, FIRST_DEVIATION = 1.06, 0.07
"""Where the first cars are searched: what sliding tyres allow is about 1 (design section 7)."""
KNOWN = 0.01
"""Standard deviation of a critical group that a surrogate learns from."""
NARROWEST = 0.003
"""Least distance of the critical groups of the two speeds."""
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
        drawn: how many cars were drawn; those that miss the bracket are no members.
        before, before_weights: cars of the prior (k, n) and their weights (k).
        after, after_weights: the same after the targets, by the surrogates.
    """

    target: Target
    prior: Prior
    flip: FlipSurrogate
    metrics: dict[str, Surrogate]
    members: Evaluated
    weights: FloatArray
    drawn: int
    before: FloatArray
    before_weights: FloatArray
    after: FloatArray
    after_weights: FloatArray

    @property
    def effective_size(self) -> float:
        """Effective sample size of the weights."""
        return effective_size(self.weights)


@dataclass(frozen=True)
class _Round:
    design: Design
    members: Evaluated
    log_weights: FloatArray


def run_stage(target: Target, prior: Prior, size: CarStage, seed: int, runner: Runner, enough: float) -> StageResult:
    """Designs, runs, draws and weighs the cars; rounds go on until the cars are worth `enough` equally likely ones.

    Raises:
        UserError: no member meets the target.
    """
    design = _first_design(target, prior, size, seed, runner)
    rounds: list[_Round] = []
    weights: FloatArray = np.zeros(0)
    drawn = 0
    for place, wanted in enumerate(size.rounds):
        flip, metrics = _surrogates(design, target, prior)
        rounds.append(_draw_round(target, prior, wanted, seed + 1 + place, flip, metrics, runner))
        design = design.merged(rounds[-1].design)
        weights = _combined([each.log_weights for each in rounds])
        drawn += wanted.cars
        runner.say(f"round {place + 1}: {drawn} cars drawn, worth {effective_size(weights):.0f} equally likely ones")
        if effective_size(weights) >= enough:
            break
    flip, metrics = _surrogates(design, target, prior)
    members = rounds[0].members
    for other in rounds[1:]:
        members = members.merged(other.members)
    if not np.any(weights):
        raise UserError(f"none of {len(weights)} cars meets its target with tail {target.tail_mode!r}")
    before, log_before = prior.draw(POOL, seed)
    after, log_prior = prior.draw(POOL, seed, window=flip.window)
    log_after = log_prior + np.log(flip.bracket(after) + FLOOR) + _surrogate_log_likelihood(after, metrics, target)
    return StageResult(
        target,
        prior,
        flip,
        metrics,
        members,
        weights,
        drawn,
        before,
        normalised(log_before),
        after,
        normalised(log_after),
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
    slow, below = flip.edges(points)
    points[:, prior.leading] = np.clip(slow - 0.5 * below, 0.0, 1.0)
    likely, at_all = (_plausible_share(prior, points, flip.window(points, reach)) for reach in (1.0, 3.0))
    with np.errstate(divide="ignore"):
        log_prior = np.log(below * (likely + FLOOR * at_all))
    log_proposal = log_prior + _surrogate_log_likelihood(points, metrics, target, widened=True)
    probability = normalised(log_proposal)
    chosen, counts = np.unique(systematic_sample(probability, wanted.cars, seed), return_counts=True)
    before = Edge.around(slow[chosen], np.full(len(chosen), flip.deviation))
    design = critical_groups(target, prior, points[chosen], (before, below[chosen]), wanted.pilots, None, runner)
    coordinates, log_widths = _drawn_in_windows(prior, design, seed)
    drawn = np.flatnonzero(np.isfinite(log_widths))
    upright, members = run_through(coordinates[drawn], prior, target, runner)
    kept = drawn[upright]
    log_weights = (
        prior.log_density(prior.values(members.coordinates))
        + log_widths[kept]
        + real_log_likelihood(members, target)
        + np.log(counts[kept] / wanted.cars)
        - np.log(probability[chosen][kept])
    )
    return _Round(_known(design, prior), members, log_weights)


def _first_design(target: Target, prior: Prior, size: CarStage, seed: int, runner: Runner) -> Design:
    """Cars of the prior whose critical groups are searched without any surrogate."""
    middle = (FIRST_GROUP - prior.plausible.lowest_group.value) / prior.group_scale
    deviation = FIRST_DEVIATION / prior.group_scale
    low, high = np.clip([middle - deviation, middle + deviation], 0.0, 1.0)
    drawn, _ = prior.draw(64 * size.points, seed, window=lambda p: (np.full(len(p), low), np.full(len(p), high)))
    cars = drawn[np.unique(systematic_sample(_crude_likelihood(target, prior, drawn), size.points, seed))]
    guess = Edge.around(np.full(len(cars), middle), np.full(len(cars), deviation))
    below = np.full(len(cars), BELOW / prior.group_scale)
    return _known(critical_groups(target, prior, cars, (guess, below), size.pilots, size.step, runner), prior)


def _crude_likelihood(target: Target, prior: Prior, cars: FloatArray) -> FloatArray:
    """What the largest lateral acceleration says before any run (m): sliding tyres give friction x gravity."""
    if target.published is None:
        return np.ones(len(cars))
    name = "max_linear_acceleration_m_per_s2"
    figure = getattr(target.published.metrics, name)
    friction = prior.values(cars)[:, prior.leading_of_metrics[0]]
    z = (prior.base.environment.gravity * friction - figure) / (FOCUS * target.discrepancy[name].relative * figure)
    likelihood: FloatArray = np.exp(-0.5 * z**2)
    return likelihood


def _plausible_share(prior: Prior, points: FloatArray, window: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Mean prior density (m) of cars with their group within a window; 0 where none of them is plausible."""
    low, high = window
    found: FloatArray = np.mean(
        [np.exp(prior.log_density_at(points, low + level * (high - low))) for level in LEVELS], axis=0
    )
    return found


def _drawn_in_windows(prior: Prior, design: Design, seed: int) -> tuple[FloatArray, FloatArray]:
    """Cars with a group drawn in the plausible part of their windows; log width of that part, -inf for none."""
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
    """Only the cars whose critical groups are known: a surrogate learns nothing of use from the others."""
    return design.kept(np.all(design.deviations * prior.group_scale < KNOWN, axis=1))


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
    slow, fast = (fit(others, edge) for edge in design.edges.T)
    flip = FlipSurrogate(prior.leading, target.speeds, slow, fast, NARROWEST / prior.group_scale)
    if target.published is None or len(design.rows) < LEAST_RUNS:
        return flip, {}
    columns = {name: design.rows[name].to_numpy(float) for name in CALIBRATED_METRICS}
    return flip, {
        name: fit(design.upright, values, design.cars, prior.leading_of_metrics) for name, values in columns.items()
    }


def _surrogate_log_likelihood(
    coordinates: FloatArray, metrics: dict[str, Surrogate], target: Target, *, widened: bool = False
) -> FloatArray:
    """Log likelihood (m) by the surrogates; `widened` by their errors: a proposal is to be wider than its target."""
    if target.published is None or not metrics:
        return np.zeros(len(coordinates))
    predicted = {name: surrogate.predict(coordinates) for name, surrogate in metrics.items()}
    discrepancy = target.discrepancy
    if widened:
        discrepancy = {name: _wider(each, metrics[name], target, name) for name, each in discrepancy.items()}
    return log_likelihood(predicted, target.published, discrepancy)


def _wider(discrepancy: Discrepancy, surrogate: Surrogate, target: Target, name: str) -> Discrepancy:
    assert target.published is not None
    error = surrogate.error / abs(getattr(target.published.metrics, name))
    return discrepancy.model_copy(update={"relative": float(np.hypot(discrepancy.relative, error))})
