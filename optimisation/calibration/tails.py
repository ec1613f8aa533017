"""The stage of the tail: each car of the ensemble with tails of the prior, run at the speeds of the tailed bracket.

Tails that meet the bracket would carry the weight. Where too few do, the bracket is a target that this model misses:
the tails stay as likely as the prior has them, and what they did is reported.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimisation.calibration.design import Evaluated, FloatArray, Runner, Target, run_cars
from optimisation.calibration.prior import Prior
from optimisation.calibration.weights import effective_size
from workbench.errors import UserError

TRIALS = 16
"""Tails that are drawn for each that is needed; a few have a sail longer than the tail."""


@dataclass(frozen=True)
class TailResult:
    """Outcome of the stage.

    Attributes:
        target: the tailed bracket.
        prior: over car and tail.
        members: cars with tails that were run.
        cars: place of each member's car among the cars of the stage before (m).
        weights: of the members (m), summing to 1.
        is_met: whether the members were held to the bracket; otherwise too few meet it, and none is.
        survive, flip, meet: share of the weight of the cars, with tails of the prior, that survives the slow speed,
            flips in the turn at the fast one, does both.
    """

    target: Target
    prior: Prior
    members: Evaluated
    cars: NDArray[np.int64]
    weights: FloatArray
    is_met: bool
    survive: float
    flip: float
    meet: float


def add_tails(
    target: Target,
    prior: Prior,
    cars: FloatArray,
    weights: FloatArray,
    tails: int,
    enough: float,
    seed: int,
    runner: Runner,
) -> TailResult:
    """Gives each car with weight `tails` tails of the prior and runs them.

    Args:
        target: the tailed bracket.
        prior: over car and tail; the coordinates of the car come first.
        cars: coordinates of the cars (m, k).
        weights: of the cars (m), summing to 1.
        tails: for each car.
        enough: effective number of cars that must meet the bracket for the tails to be held to it.
        seed: of the draw.
        runner: that runs them.

    Raises:
        UserError: a car has no plausible tail.
    """
    kept = np.flatnonzero(weights)
    order = np.random.default_rng(seed).permutation(np.repeat(kept, tails * TRIALS))
    drawn = prior.points(len(order), seed)
    drawn[:, : cars.shape[1]] = cars[order]
    plausible = prior.are_plausible(prior.values(drawn))
    chosen = []
    for car in kept:
        own = np.flatnonzero((order == car) & plausible)[:tails]
        if len(own) < tails:
            raise UserError(f"a car of the ensemble has {len(own)} plausible tails among {tails * TRIALS} drawn")
        chosen.append(own)
    places = np.concatenate(chosen)
    whose = order[places]
    members = run_cars(drawn[places], prior, target, runner)
    before = weights[whose] / tails
    held = np.where(members.meet, before, 0.0)
    by_car = np.bincount(whose, held, len(weights))
    is_met = effective_size(by_car) >= enough
    shares = (float(before @ which) for which in (members.survive, members.flip, members.meet))
    return TailResult(target, prior, members, whose, held / held.sum() if is_met else before, is_met, *shares)
