"""The whole calibration: the car on the tailless bracket and Table 7.1, its tail on the tailed bracket, a fine check.

The metrics of Tables 7.2 to 7.4 take no part: they are the validation (`optimisation.calibration.validation`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from optimisation.calibration.plan import CalibrationPlan
from optimisation.calibration.prior import Prior, Window
from optimisation.calibration.runs import RunStore, car_values
from optimisation.calibration.stages import StageResult, Target, real_log_likelihood, run_cars, run_stage
from optimisation.calibration.weights import effective_size, normalised, systematic_sample
from optimisation.sweep.engine import Engine
from workbench.ensemble import Value
from workbench.errors import UserError
from workbench.published import flip_bracket, published_figures
from workbench.scenario import load_scenario

FloatArray = NDArray[np.float64]

BASE_SCENARIO = "turn_none"
ENOUGH = 32
"""Effective sample size that an ensemble needs."""


@dataclass(frozen=True)
class FineCheck:
    """Members simulated again at the fine step.

    Attributes:
        step: s.
        places: of the members in the last stage (m).
        none_in_bracket, swing_in_bracket: which of them meet the tailless and the tailed bracket there (m).
        shares: share of their weight that does: (tailless, tailed).
    """

    step: float
    places: NDArray[np.int64]
    none_in_bracket: NDArray[np.bool_]
    swing_in_bracket: NDArray[np.bool_]
    shares: tuple[float, float]


@dataclass(frozen=True)
class Calibration:
    """Outcome of a calibration.

    Attributes:
        plan: that was carried out.
        car: stage of the car without tail.
        tail: stage of car and tail; its members and weights are the ensemble.
        check: at the fine step.
        best: place of the best member: the likeliest of those that meet all brackets at both steps.
        runs: how many runs it took.
    """

    plan: CalibrationPlan
    car: StageResult
    tail: StageResult
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
        UserError: no plausible car meets a bracket, or too few do for an ensemble.
    """
    base = load_scenario(BASE_SCENARIO)
    car_prior = Prior(plan.car, plan.plausible, base)
    table = next(row for row in published_figures() if (row.platform, row.configuration) == ("simulated", "tailless"))
    tailless = Target("none", flip_bracket("tailless"), table, plan.discrepancy)

    def draw_car(number: int, seed: int, window: Window | None) -> tuple[FloatArray, FloatArray]:
        return car_prior.draw(number, seed, window=window)

    car = run_stage(tailless, car_prior, plan.car_stage, plan.seed, draw_car, store, engine, _named(say, "car"))
    say(_in_words("car", car))
    _require_enough("car", car)
    both = Prior((*plan.car, *plan.tail), plan.plausible, base)
    tailed = Target("swing", flip_bracket("tailed"), None, {})

    def draw_tail(number: int, seed: int, window: Window | None) -> tuple[FloatArray, FloatArray]:
        """Cars of the first stage with tails of the prior; their group is settled, so it needs no window."""
        cars = car.members.coordinates[systematic_sample(car.weights, number, seed)]
        cars = np.random.default_rng(seed).permutation(cars)
        coordinates, _ = both.draw(number, seed, cars)
        return coordinates, np.zeros(len(coordinates))

    tail = run_stage(tailed, both, plan.tail_stage, plan.seed + 1000, draw_tail, store, engine, _named(say, "tail"))
    say(_in_words("tail", tail))
    _require_enough("tail", tail)
    check = _fine_check(plan, tail, store, engine, say)
    best = _best(plan, car, tail, check, store, engine)
    return Calibration(plan, car, tail, check, best, len(store))


def _require_enough(stage: str, result: StageResult) -> None:
    """Both stages count: many tails on few cars are few cars."""
    if result.effective_size < ENOUGH:
        raise UserError(
            f"the members of the {stage} stage are worth {result.effective_size:.0f}; needed are {ENOUGH}: more points "
            "or members in the plan, or another seed"
        )


def _fine_check(
    plan: CalibrationPlan, tail: StageResult, store: RunStore, engine: Engine, say: Callable[[str], None]
) -> FineCheck:
    """Runs the members with weight at the fine step; all of them, or as many as the plan allows, drawn by weight."""
    kept = np.flatnonzero(tail.weights)
    if len(kept) > plan.check.members:
        kept = np.unique(systematic_sample(tail.weights, plan.check.members, plan.seed))
    inside = []
    tailless = Target("none", flip_bracket("tailless"), None, {})
    for target in (tailless, tail.target):
        runs = run_cars(tail.members.coordinates[kept], tail.prior, target, store, engine, plan.check.step, say)
        inside.append(runs.meets(target))
    weights = tail.weights[kept] / np.sum(tail.weights[kept])
    shares = (float(weights @ inside[0]), float(weights @ inside[1]))
    say(
        f"at {plan.check.step:g} s the tailless bracket holds in {shares[0]:.0%} of the weight, what the tail is held "
        f"to in {shares[1]:.0%}"
    )
    return FineCheck(plan.check.step, kept, inside[0], inside[1], shares)


def _best(
    plan: CalibrationPlan, car: StageResult, tail: StageResult, check: FineCheck, store: RunStore, engine: Engine
) -> int:
    """The member with the largest posterior density among those that meet both brackets at both steps."""
    good = check.places[check.none_in_bracket & check.swing_in_bracket]
    if not len(good):
        good = check.places[check.none_in_bracket]
    if not len(good):
        raise UserError(f"no member meets the tailless bracket at {plan.check.step:g} s")
    runs = run_cars(tail.members.coordinates[good], tail.prior, car.target, store, engine, None, lambda line: None)
    density = real_log_likelihood(runs, car.target) + car.prior.log_density(
        car.prior.values(runs.coordinates[:, : len(car.prior.keys)])
    )
    return int(good[int(np.argmax(density))])


def member_frame(calibration: Calibration) -> pd.DataFrame:
    """Members with weight as a table: name, weight, and the value of each parameter."""
    places = calibration.kept
    weights = normalised(np.log(calibration.tail.weights[places]))
    frame = pd.DataFrame([calibration.values[place] for place in places])
    frame.insert(0, "weight", weights)
    frame.insert(0, "member", [member_name(place) for place in places])
    return frame


def member_name(place: int) -> str:
    """Name of a member by its place in the last stage."""
    return f"car{place:03d}"


def _named(say: Callable[[str], None], stage: str) -> Callable[[str], None]:
    return lambda line: say(f"{stage}: {line}")


def _in_words(stage: str, result: StageResult) -> str:
    inside = int(np.count_nonzero(result.members.meets(result.target)))
    return (
        f"{stage}: {inside} of {len(result.weights)} members meet the target, worth {result.effective_size:.0f}; their "
        f"pool is worth {effective_size(result.pool_posterior):.0f}"
    )
