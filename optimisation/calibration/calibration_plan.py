"""The plan of a calibration: what varies, what it is held to, what is implausible, and how many runs that takes.

Plans are files of `models/calibration/plans` (schema `aerodima/calibration-plan/2`). The prior of a parameter is its
range in `models/parameters`; the figures are those of the published tables; the plan says which of them make the
weights and which test them (it is the one place that does), and how far the model may be off.
"""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, Field, model_validator

from aerodima.workbench.config.checked_files import StrictModel, checked, find_file, nearest, read_yaml
from aerodima.workbench.config.scenario import SECTIONS, ParameterEntry, load_parameter_entries
from aerodima.workbench.errors import ScenarioError
from aerodima.workbench.metrics.published_values import TurnMetrics

OWN_METRICS = tuple(
    name for name in TurnMetrics.__dataclass_fields__ if name != "speed_m_per_s" and "kohut" not in name
)
"""Metrics that carry information of their own: the speed is commanded, Kohut is speed times yaw rate."""
SPEED_IN_TURN, LIFT = "speed_in_turn_m_per_s", "lift_yaw_rate_rad_per_s"

FIGURES = {
    "Table 7.1": (*OWN_METRICS, SPEED_IN_TURN),
    "Section 6.3.4": (LIFT,),
    "Table 7.2": OWN_METRICS,
    "Table 7.3": OWN_METRICS,
    "Table 7.4": OWN_METRICS,
}
"""What a plan must say of each place of the thesis."""


class ValueUse(StrictModel):
    """What the calibration does with one published value.

    Attributes:
        use: `fitted` figures make the weights, those that are `held out` test them.
        discrepancy: how far the model may be off: one standard deviation over the published figure.
        reason: for both.
    """

    use: Literal["fitted", "held out"]
    discrepancy: float = Field(gt=0, le=10)
    reason: str = Field(min_length=1)


class Outcomes(StrictModel):
    """What the calibration does with published outcomes; only the tailless bracket can be fitted."""

    tailless_bracket: Literal["fitted"]
    tailed_bracket: Literal["held out"]
    real_car_with_tail: Literal["held out"]


class Limit(StrictModel):
    """One bound of what is plausible."""

    value: float
    unit: str
    reason: str = Field(min_length=1)


class Plausible(StrictModel):
    """What a car cannot be, whatever it would explain.

    Attributes:
        lowest_chassis_com, highest_chassis_com: of the chassis without wheels and gearbox above the ground, m.
        lowest_mu_over_ssf, highest_mu_over_ssf: friction over the static stability factor, friction x height of the
            centre of mass / half track.
    """

    lowest_chassis_com: Limit
    highest_chassis_com: Limit
    lowest_mu_over_ssf: Limit = Field(validation_alias=AliasChoices("lowest_mu_over_ssf", "lowest_group"))
    highest_mu_over_ssf: Limit = Field(validation_alias=AliasChoices("highest_mu_over_ssf", "highest_group"))


Pilots = tuple[Annotated[int, Field(ge=1, le=12)], Annotated[int, Field(ge=1, le=12)]]


class Round(StrictModel):
    """Cars that are drawn for weights.

    Attributes:
        cars: how many.
        pilots: most runs of the search for the window of each, at the slow and at the fast speed.
    """

    cars: int = Field(ge=4, le=4096)
    pilots: Pilots


class Size(StrictModel):
    """How many runs a calibration may take.

    Attributes:
        points: cars of the design.
        pilots: most runs of the search for the flip of each car of the design, at the slow and at the fast speed.
        step: of the plant in the design, s; members have the default step.
        rounds: of cars, as many of them as are needed; the surrogates of a round learn from those before.
        tails: that each car which meets the tailless bracket is run with.
        enough: effective sample size that ends the rounds, and that an ensemble needs.
    """

    points: int = Field(ge=4, le=4096)
    pilots: Pilots
    step: float = Field(gt=0, le=0.005)
    rounds: tuple[Round, ...] = Field(min_length=1, max_length=12)
    tails: int = Field(ge=1, le=64)
    enough: float = Field(ge=2, le=4096)


class CheckSize(StrictModel):
    """The check at a fine step: how many members, and the step (s)."""

    members: int = Field(ge=1, le=4096)
    step: float = Field(gt=0, le=0.002)


class CalibrationPlan(StrictModel):
    """A plan as its file has it."""

    schema_: Literal["aerodima/calibration-plan/2"] = Field(alias="schema")
    name: str = Field(min_length=1, max_length=80)
    seed: int = Field(ge=0)
    car: tuple[str, ...] = Field(min_length=1)
    tail: tuple[str, ...] = Field(min_length=1)
    figures: dict[str, dict[str, ValueUse]]
    outcomes: Outcomes
    plausible: Plausible
    size: Size
    check: CheckSize

    @model_validator(mode="after")
    def _names_are_known(self) -> "CalibrationPlan":
        if set(self.figures) != set(FIGURES):
            raise ValueError(f"figures: {sorted(self.figures)}; allowed: {', '.join(FIGURES)}")
        for source, metrics in FIGURES.items():
            if set(self.figures[source]) != set(metrics):
                raise ValueError(f"figures: {source}: {sorted(self.figures[source])}; allowed: {', '.join(metrics)}")
        needed = {"car.com_height", "car.tyre_friction", "car.track"}
        if not needed <= set(self.car):
            raise ValueError(f"car: {', '.join(sorted(needed - set(self.car)))} missing; the flip depends on it first")
        names = [*self.car, *self.tail]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"car, tail: {twice[0]!r} stands there twice; allowed: once")
        return self


def load_plan(name_or_path: str | Path = "car") -> CalibrationPlan:
    """Loads a plan by path, or by name from `models/calibration/plans`.

    Raises:
        ScenarioError: names the file, the key and what is allowed.
    """
    path = find_file(name_or_path, "calibration/plans", "calibration plan")
    plan = checked(CalibrationPlan, read_yaml(path), str(path))
    prior_ranges((*plan.car, *plan.tail), str(path))
    return plan


def prior_ranges(keys: tuple[str, ...], where: str = "prior") -> NDArray[np.float64]:
    """Lowest and highest value (n, 2) of each `section.key` in `models/parameters`.

    Raises:
        ScenarioError: there is no such parameter, or it has no prior.
    """
    entries: dict[str, dict[str, ParameterEntry]] = {}
    ranges = []
    for key in keys:
        section, _, name = key.partition(".")
        if section not in SECTIONS:
            raise ScenarioError(f"{where}: {key}: {section!r} is no section; {nearest(section, list(SECTIONS))}")
        if section not in entries:
            entries[section] = load_parameter_entries(section)
        if name not in entries[section]:
            raise ScenarioError(f"{where}: {key}: unknown key; {nearest(name, list(entries[section]))}")
        prior = entries[section][name].prior
        if prior is None:
            others = sorted(
                f"{section}.{other}" for other, entry in entries[section].items() if entry.prior is not None
            )
            raise ScenarioError(f"{where}: {key}: has no prior range; allowed in {section}: {', '.join(others)}")
        ranges.append(prior)
    return np.array(ranges)


def fitted_names(plan: CalibrationPlan) -> list[str]:
    """What a plan's weights rest on, as plain words: what agrees with it is no evidence."""
    outcomes = [name.replace("_", " ") for name, use in plan.outcomes if use == "fitted"]
    return outcomes + [
        f"{source} {name}" for source in FIGURES for name, f in plan.figures[source].items() if f.use == "fitted"
    ]


def assumed_elsewhere(plan: CalibrationPlan) -> list[str]:
    """Parameters with a prior that the plan leaves at their value, as `section.key`."""
    varied = {*plan.car, *plan.tail}

    def open_entries(section: str) -> list[tuple[str, ParameterEntry]]:
        return [(key, entry) for key, entry in load_parameter_entries(section).items() if entry.prior is not None]

    return [f"{s}.{key}" for s in SECTIONS for key, _ in open_entries(s) if f"{s}.{key}" not in varied]
