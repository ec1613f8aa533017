"""The whole calibration: cars with tails, weighed by the fitted figures of the plan, and a check at a fine step.

Figures and outcomes that the plan holds out take no part: they are the test
(`aerodima.optimisation.calibration.validation`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.optimisation.calibration.bracket_design import Runner, Target, run_cars
from aerodima.optimisation.calibration.calibration_plan import CalibrationPlan
from aerodima.optimisation.calibration.calibration_runs import Datum, RunStore, car_values, fitted, plan_data
from aerodima.optimisation.calibration.car_prior import Prior, normalised, systematic_sample
from aerodima.optimisation.calibration.member_draw import Draw, draw_cars
from aerodima.optimisation.calibration.tail_draw import TailSampling, run_tails
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import ProgressLine, silent
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Value
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.published_values import flip_bracket

BASE_SCENARIO = "turn_swing"
SHIPPED_DIGITS = 3
"""Of the car of an ensemble that `models/parameters` holds."""


@dataclass(frozen=True)
class FineCheck:
    """Members simulated again at the fine step.

    Attributes:
        step: s.
        places: of the members (m).
        counts: how often each was drawn for the check, by its weight (m).
        meet: which of them meet the tailless bracket there (m).
    """

    step: float
    places: NDArray[np.int64]
    counts: NDArray[np.int64]
    meet: NDArray[np.bool_]

    @property
    def share(self) -> float:
        """Share of the weight that meets the tailless bracket."""
        return float(np.average(self.meet, weights=self.counts))


@dataclass(frozen=True)
class Calibration:
    """Outcome of a calibration.

    Attributes:
        plan: that was carried out.
        draw: its members, each with its tail, and their weights are the ensemble.
        check: at the fine step.
        best: place of the most central member that meets the tailless bracket at both steps.
        runs: how many runs it took.
    """

    plan: CalibrationPlan
    draw: Draw
    check: FineCheck
    best: int
    runs: int

    @property
    def kept(self) -> NDArray[np.int64]:
        """Places of the members with weight."""
        return np.flatnonzero(self.draw.weights)

    @property
    def values(self) -> list[dict[str, Value]]:
        """Cars of the members, with the digits that were run."""
        return car_values(self.draw.prior.keys, self.draw.prior.values(self.draw.coordinates))


def calibrate(
    plan: CalibrationPlan,
    store: RunStore,
    engine: Engine,
    progress: ProgressLine = silent,
    data: Sequence[Datum] | None = None,
) -> Calibration:
    """Carries out a plan; what the store holds already is not run again. `write_calibration` writes the ensemble.

    With other numbers of BLAS threads the last digits differ, so that other cars are drawn: `OMP_NUM_THREADS=1`.

    Args:
        plan: to be carried out.
        store: of its runs, `RunStore.for_plan`.
        engine: that runs them.
        progress: told how it goes.
        data: figures instead of the published ones.

    Raises:
        UserError: no plausible car meets the tailless bracket, or too few do for an ensemble.
    """
    base, runner = load_scenario(BASE_SCENARIO), Runner(store, engine, progress)
    used = fitted(plan_data(plan) if data is None else data)
    slow = Target(flip_bracket("tailless"), ()).turns[0]
    target = Target(flip_bracket("tailless"), tuple(datum for datum in used if datum.turn == slow))
    both = Prior((*plan.car, *plan.tail), plan.plausible, base)
    sampling = TailSampling(both, tuple(datum for datum in used if datum.turn != slow), plan.size.tails)
    cars = Prior(plan.car, plan.plausible, base)
    draw = draw_cars(target, cars, sampling, plan.size, plan.seed, runner)
    progress(
        f"{np.count_nonzero(draw.weights)} of {draw.drawn} cars meet the tailless bracket, effective sample size "
        f"{draw.effective_size:.0f}"
    )
    if draw.effective_size < plan.size.enough:
        raise UserError(
            f"the cars that meet the target have an effective sample size of {draw.effective_size:.0f}; needed is "
            f"{plan.size.enough:g}: more cars in the rounds of the plan, or another seed"
        )
    check = _fine_check(plan, draw, runner)
    best = _best(draw, runner, plan.check.step)
    return Calibration(plan, draw, check, best, len(store))


def _fine_check(plan: CalibrationPlan, draw: Draw, runner: Runner) -> FineCheck:
    """Runs the members with weight at the fine step; all of them, or as many as the plan allows, drawn by weight."""
    drawn = systematic_sample(draw.weights, plan.check.members, plan.seed)
    places, counts = np.unique(drawn, return_counts=True)
    found = run_cars(draw.coordinates[places], draw.prior, draw.target, runner, plan.check.step)
    check = FineCheck(plan.check.step, places, counts, found.meet)
    runner.progress(f"at {check.step:g} s the tailless bracket holds in {check.share:.0%} of the weight")
    return check


def _best(draw: Draw, runner: Runner, step: float) -> int:
    """The most central member that holds at both steps even when its car is rounded, as the parameter files have it.

    Central: it is near the mean member, in the standard deviations of the ensemble. Not the likeliest: the largest
    density of some thirty parameters that the data hardly determine lies in a corner of the prior (a car of 7.97 kg
    of at most 8.0 kg, its tail mounted at the lowest height), where few members are.
    """
    values = draw.prior.values(draw.coordinates)
    mean = draw.weights @ values
    deviations = np.sqrt(draw.weights @ (values - mean) ** 2)
    distance = np.sum(((values - mean) / deviations) ** 2, axis=1)
    for place in sorted(np.flatnonzero(draw.weights).tolist(), key=lambda member: float(distance[member])):
        rounded = np.array([[float(f"{value:.{SHIPPED_DIGITS}g}") for value in values[place]]])
        coordinates = draw.prior.coordinates(rounded)
        if all(run_cars(coordinates, draw.prior, draw.target, runner, each).meet[0] for each in (None, step)):
            return int(place)
    raise UserError(f"no member meets the tailless bracket at {step:g} s with {SHIPPED_DIGITS} digits")


def log_posterior(draw: Draw, coordinates: FloatArray, runner: Runner) -> FloatArray:
    """Log posterior density of cars with tails (m, n) in coordinates, from their own runs, up to a constant (m)."""
    runs = run_cars(coordinates, draw.prior, draw.target, runner)
    _, tailed = run_tails(draw.sampling, coordinates, runner)
    return runs.log_likelihood(draw.target) + tailed + draw.prior.log_density(draw.prior.values(coordinates))


def member_frame(calibration: Calibration) -> pd.DataFrame:
    """Members with weight as a table: name, weight, and the value of each parameter."""
    places = calibration.kept
    columns = {
        "member": [member_name(place) for place in places],
        "weight": normalised(np.log(calibration.draw.weights[places])),
    }
    cars = calibration.values
    return pd.concat([pd.DataFrame(columns), pd.DataFrame([cars[place] for place in places])], axis=1)


def member_name(place: int) -> str:
    """Name of a member by its place in the draw."""
    return f"car{place:03d}"
