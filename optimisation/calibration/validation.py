"""Every published figure and outcome beside the ensemble, and where the car of `models/parameters` lies in it.

Each row is compared with metrics from the signals that the thesis took for it
(`aerodima.workbench.metrics.published_values.SIGNALS`). The turns are those of the simulation at the speed of the row,
not the car's AUTO sequence: the thesis gives throttle, not speed, for those.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.calibration.bracket_design import Runner
from aerodima.optimisation.calibration.calibration import Calibration, log_posterior
from aerodima.optimisation.calibration.calibration_plan import CalibrationPlan
from aerodima.optimisation.calibration.calibration_runs import (
    Datum,
    RunStore,
    Turn,
    Use,
    flips_in_the_turn,
    plan_data,
    survives,
)
from aerodima.optimisation.calibration.car_prior import Prior
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Member, weighted_quantiles
from aerodima.workbench.metrics.published_values import flip_bracket, published_values


@dataclass(frozen=True)
class Validated:
    """One published metric beside the ensemble.

    Attributes:
        source: its table or section.
        use: what the calibration did with it.
        metric: name with unit.
        published: figure.
        low, median, high: quantiles of the ensemble at `BAND`.
        z: (published - mean) / standard deviation of the ensemble.
        z_with_discrepancy: the same with the model discrepancy of the plan added to the variance.
        survived: share of the weight that survived these runs; only these have figures here.
    """

    source: str
    use: Use
    metric: str
    published: float
    low: float
    median: float
    high: float
    z: float
    z_with_discrepancy: float
    survived: float

    @property
    def is_test(self) -> bool:
        """Whether agreement is evidence."""
        return self.use == "held out"


@dataclass(frozen=True)
class ValidatedOutcome:
    """One published outcome beside the ensemble.

    Attributes:
        claim: in words.
        use: what the calibration did with it.
        share: of the weight that shows it.
        tipped: share of the weight that tipped over before its turn, which says nothing about the claim.
    """

    claim: str
    use: Use
    share: float
    tipped: float


def validate(
    members: Sequence[Member], plan: CalibrationPlan, store: RunStore, engine: Engine
) -> tuple[list[Validated], list[ValidatedOutcome]]:
    """Runs the members as each figure was made and compares all of them."""
    weights = np.array([member.weight for member in members])

    @cache
    def run(turn: Turn) -> pd.DataFrame:
        return store.run([turn.wanted(member.values) for member in members], engine)

    figures = [compare(datum, run(datum.turn), weights) for datum in plan_data(plan)]
    none, swing = flip_bracket("tailless"), flip_bracket("tailed")
    real = next(r for r in published_values() if (r.platform, r.configuration) == ("physical", "tailed"))
    fastest = real.metrics.speed_m_per_s
    outcomes = []
    claims: tuple[tuple[str, str, float, Use], ...] = (
        ("survives", "none", none.survived, plan.outcomes.tailless_bracket),
        ("flips", "none", none.flipped, plan.outcomes.tailless_bracket),
        ("survives", "swing", swing.survived, plan.outcomes.tailed_bracket),
        ("flips", "swing", swing.flipped, plan.outcomes.tailed_bracket),
        ("survives", "swing", fastest, plan.outcomes.real_car_with_tail),
    )
    for verb, mode, speed, use in claims:
        rows = run(Turn(mode, speed))
        shown = survives(rows) if verb == "survives" else flips_in_the_turn(rows)
        tipped = ~survives(rows) & ~flips_in_the_turn(rows)
        claim = f"{'no tail' if mode == 'none' else 'tail'}: {verb} {speed:g} m/s"
        outcomes.append(ValidatedOutcome(claim, use, float(weights @ shown), float(weights @ tipped)))
    return figures, outcomes


def compare(datum: Datum, rows: pd.DataFrame, weights: FloatArray) -> Validated:
    """A figure beside runs, one row per member; a run that was not survived loses its weight."""
    upright = survives(rows)
    values = np.where(upright, datum.values(rows), np.nan)
    there = np.isfinite(values)
    shares = weights[there] / weights[there].sum()
    mean = float(shares @ values[there]) if np.any(there) else np.nan
    variance = float(shares @ (values[there] - mean) ** 2)
    low, median, high = weighted_quantiles(values, weights)
    return Validated(
        source=datum.source,
        use=datum.use,
        metric=datum.metric,
        published=datum.figure,
        low=float(low),
        median=float(median),
        high=float(high),
        z=_ratio(datum.figure - mean, variance),
        z_with_discrepancy=_ratio(datum.figure - mean, variance + datum.discrepancy**2),
        survived=float(weights[upright].sum()),
    )


def as_table(found: Sequence[Any]) -> pd.DataFrame:
    """Figures or outcomes, a row each."""
    return pd.DataFrame([asdict(each) for each in found])


def _ratio(difference: float, variance: float) -> float:
    if variance > 0.0:
        return difference / float(np.sqrt(variance))
    return math.copysign(math.inf, difference) if math.isfinite(difference) else math.nan


@dataclass(frozen=True)
class Shipped:
    """The shipped car with its tail.

    Attributes:
        values: of its parameters (n), in the order of the keys of car and tail.
        z: (value - mean of the ensemble) / standard deviation of the ensemble (n).
        relative_density: posterior density over that of the best member; 0 when it misses the tailless bracket.
    """

    values: FloatArray
    z: FloatArray
    relative_density: float


def shipped_car(result: Calibration, runner: Runner) -> Shipped:
    """Runs the shipped car as each member was run and compares it with the ensemble."""
    prior, weights = result.draw.prior, result.draw.weights
    members = prior.values(result.draw.coordinates)
    mean = weights @ members
    deviation = np.sqrt(weights @ (members - mean) ** 2)
    own = _values(prior)
    cars = np.vstack([prior.coordinates(own[None])[0], result.draw.coordinates[result.best]])
    shipped, best = log_posterior(result.draw, cars, runner)
    return Shipped(own, (own - mean) / deviation, float(np.exp(shipped - best)))


def _values(prior: Prior) -> FloatArray:
    sections = (key.split(".") for key in prior.keys)
    return np.array([float(getattr(getattr(prior.base, section), name)) for section, name in sections])
