"""The whole calibration: the car on the tailless bracket and Table 7.1, tails beside the tailed bracket, a fine check.

The metrics of Tables 7.2 to 7.4 take no part: they are the validation (`optimisation.calibration.validation`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from optimisation.calibration.design import FloatArray, Runner, Target, run_cars
from optimisation.calibration.plan import CalibrationPlan
from optimisation.calibration.prior import Prior
from optimisation.calibration.runs import RunStore, car_values
from optimisation.calibration.stages import StageResult, real_log_likelihood, run_stage
from optimisation.calibration.tails import TailResult, add_tails
from optimisation.calibration.weights import normalised, systematic_sample
from optimisation.sweep.engine import Engine
from workbench.ensemble import Value
from workbench.errors import UserError
from workbench.published import flip_bracket, published_figures
from workbench.scenario import load_scenario

BASE_SCENARIO = "turn_none"
ENOUGH = 32
"""Effective sample size that an ensemble needs."""
SHIPPED_DIGITS = 3
"""Of the car of an ensemble that `models/parameters` holds."""


@dataclass(frozen=True)
class FineCheck:
    """Members simulated again at the fine step.

    Attributes:
        step: s.
        places: of the members (m).
        counts: how often each was drawn for the check, by its weight (m).
        in_tailless, in_tailed: which of them meet the tailless and the tailed bracket there (m); the latter None when
            the ensemble is not held to it.
    """

    step: float
    places: NDArray[np.int64]
    counts: NDArray[np.int64]
    in_tailless: NDArray[np.bool_]
    in_tailed: NDArray[np.bool_] | None

    @property
    def tailless_share(self) -> float:
        """Share of the weight that meets the tailless bracket."""
        return float(np.average(self.in_tailless, weights=self.counts))

    @property
    def tailed_share(self) -> float | None:
        """Share of the weight that meets the tailed bracket."""
        return None if self.in_tailed is None else float(np.average(self.in_tailed, weights=self.counts))


@dataclass(frozen=True)
class Calibration:
    """Outcome of a calibration.

    Attributes:
        plan: that was carried out.
        car: stage of the car without tail.
        tail: stage of car and tail; its members and weights are the ensemble.
        check: at the fine step.
        best: place of the most central member that meets what it is held to at both steps.
        runs: how many runs it took.
    """

    plan: CalibrationPlan
    car: StageResult
    tail: TailResult
    check: FineCheck
    best: int
    runs: int

    @property
    def kept(self) -> NDArray[np.int64]:
        """Places of the members with weight."""
        return np.flatnonzero(self.tail.weights)

    @property
    def values(self) -> list[dict[str, Value]]:
        """Cars of the members of the last stage, with the digits that were run."""
        return car_values(self.tail.prior.keys, self.tail.prior.values(self.tail.members.coordinates))


def calibrate(plan: CalibrationPlan, store: RunStore, engine: Engine, say: Callable[[str], None]) -> Calibration:
    """Carries out a plan; what the store holds already is not run again.

    Raises:
        UserError: no plausible car meets the tailless bracket, or too few do for an ensemble.
    """
    base = load_scenario(BASE_SCENARIO)
    table = next(row for row in published_figures() if (row.platform, row.configuration) == ("simulated", "tailless"))
    tailless = Target("none", flip_bracket("tailless"), table, plan.discrepancy)
    runner = Runner(store, engine, say)
    car = run_stage(tailless, Prior(plan.car, plan.plausible, base), plan.car_stage, plan.seed, runner, ENOUGH)
    say(
        f"car: {np.count_nonzero(car.weights)} of {car.drawn} cars meet the target, worth {car.effective_size:.0f} "
        "equally likely ones"
    )
    if car.effective_size < ENOUGH:
        raise UserError(
            f"the cars that meet the target are worth {car.effective_size:.0f} equally likely ones; needed are "
            f"{ENOUGH}: more cars in the rounds of the plan, or another seed"
        )
    both = Prior((*plan.car, *plan.tail), plan.plausible, base)
    tailed = Target("swing", flip_bracket("tailed"), None, {})
    tail = add_tails(
        tailed, both, car.members.coordinates, car.weights, plan.tail_stage.tails, ENOUGH, plan.seed + 1000, runner
    )
    say(
        f"tail: {tail.survive:.0%} of the weight survives {tailed.speeds[0]:g} m/s, {tail.flip:.0%} flips in the turn "
        f"at {tailed.speeds[1]:g} m/s, {tail.meet:.1%} does both"
    )
    check = _fine_check(plan, car, tail, runner)
    best = _best(car, tail, runner, plan.check.step)
    return Calibration(plan, car, tail, check, best, len(store))


def _fine_check(plan: CalibrationPlan, car: StageResult, tail: TailResult, runner: Runner) -> FineCheck:
    """Runs the members with weight at the fine step; all of them, or as many as the plan allows, drawn by weight."""
    drawn = systematic_sample(tail.weights, plan.check.members, plan.seed)
    places, counts = np.unique(drawn, return_counts=True)
    cars = tail.members.coordinates[places]
    none = run_cars(cars, tail.prior, car.target, runner, plan.check.step)
    swing = run_cars(cars, tail.prior, tail.target, runner, plan.check.step) if tail.is_met else None
    check = FineCheck(plan.check.step, places, counts, none.meet, None if swing is None else swing.meet)
    runner.say(f"at {check.step:g} s the tailless bracket holds in {check.tailless_share:.0%} of the weight")
    return check


def _best(car: StageResult, tail: TailResult, runner: Runner, step: float) -> int:
    """The most central member that holds at both steps even when its car is rounded, as the parameter files have it.

    Central: its car is near the mean car, in the standard deviations of the ensemble. Not the likeliest: the largest
    density of some twenty parameters that the targets hardly determine lies in a corner of the prior (a car of 7.97 kg
    of at most 8.0 kg, its tail mounted at the lowest height), where few members are.
    """
    keys, weights = len(car.prior.keys), tail.weights
    values = tail.prior.values(tail.members.coordinates)
    mean = weights @ values
    deviations = np.sqrt(weights @ (values - mean) ** 2)
    distance = np.sum(((values - mean) / deviations)[:, :keys] ** 2, axis=1)
    held = [(car.prior, car.target, keys), *([(tail.prior, tail.target, values.shape[1])] if tail.is_met else [])]
    for place in sorted(np.flatnonzero(weights).tolist(), key=lambda member: float(distance[member])):
        rounded = np.array([[float(f"{value:.{SHIPPED_DIGITS}g}") for value in values[place]]])
        if all(
            run_cars(prior.coordinates(rounded[:, :count]), prior, target, runner, each).meet[0]
            for each in (None, step)
            for prior, target, count in held
        ):
            return int(place)
    raise UserError(f"no member meets its brackets at {step:g} s with {SHIPPED_DIGITS} digits")


def log_posterior(car: StageResult, coordinates: FloatArray, runner: Runner) -> FloatArray:
    """Log posterior density of cars (m, n) in coordinates, from their own runs, up to a constant (m)."""
    own = coordinates[:, : len(car.prior.keys)]
    runs = run_cars(own, car.prior, car.target, runner)
    return real_log_likelihood(runs, car.target) + car.prior.log_density(car.prior.values(own))


def member_frame(calibration: Calibration) -> pd.DataFrame:
    """Members with weight as a table: name, weight, what each did with its tail, and the value of each parameter."""
    places = calibration.kept
    members = calibration.tail.members
    frame = pd.DataFrame([calibration.values[place] for place in places])
    slow, fast = calibration.tail.target.speeds
    columns = {
        "member": [member_name(place) for place in places],
        "weight": normalised(np.log(calibration.tail.weights[places])),
        f"tailed_{slow:g}_m_per_s": members.slow["outcome"].to_numpy()[places],
        f"tailed_{fast:g}_m_per_s": np.where(
            members.flip[places], "flipped in the turn", members.fast["outcome"].to_numpy()[places]
        ),
    }
    return pd.concat([pd.DataFrame(columns), frame], axis=1)


def member_name(place: int) -> str:
    """Name of a member by its place in the last stage."""
    return f"car{place:03d}"
