"""The plan of a calibration: what varies, what it is held to, what is implausible, and how many runs that takes.

Plans are files of `models/calibration/plans` (schema `aerodima/calibration-plan/1`). The prior of a parameter is its
range in `models/parameters`; the targets are the published tables; the plan adds how far the model may be off.
"""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from workbench.errors import ScenarioError
from workbench.parameter_files import ParameterEntry, read_yaml
from workbench.published import TurnMetrics
from workbench.quantity import explain, nearest
from workbench.resources import model_path, models_dir
from workbench.scenario import SECTIONS, load_parameter_entries

PLAN_SCHEMA = "aerodima/calibration-plan/1"

CALIBRATED_METRICS = tuple(
    name for name in TurnMetrics.__dataclass_fields__ if name != "speed_m_per_s" and "kohut" not in name
)
"""Metrics that carry information of their own: the speed is commanded, Kohut is speed times yaw rate."""


class Discrepancy(BaseModel):
    """How far the model may be off from one published metric: one standard deviation over the published figure."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    relative: float = Field(gt=0, le=10)
    reason: str = Field(min_length=1)


class Limit(BaseModel):
    """One bound of what is plausible."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    value: float
    unit: str
    reason: str = Field(min_length=1)


class Plausible(BaseModel):
    """What a car cannot be, whatever it would explain.

    Attributes:
        lowest_chassis_com, highest_chassis_com: of the chassis without wheels and gearbox above the ground, m.
        lowest_group, highest_group: friction x height of the centre of mass / half track.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    lowest_chassis_com: Limit
    highest_chassis_com: Limit
    lowest_group: Limit
    highest_group: Limit


Pilots = tuple[Annotated[int, Field(ge=1, le=12)], Annotated[int, Field(ge=1, le=12)]]


class Round(BaseModel):
    """Cars that are drawn for weights.

    Attributes:
        cars: how many.
        pilots: most runs of the search for the window of each, at the slow and at the fast speed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    cars: int = Field(ge=4, le=4096)
    pilots: Pilots


class CarStage(BaseModel):
    """Runs of the stage of the car.

    Attributes:
        points: cars of the design.
        pilots: most runs of the search for the flip of each car of the design, at the slow and at the fast speed.
        step: of the plant in the design, s; members have the default step.
        rounds: of cars, as many of them as are needed; the surrogates of a round learn from those before.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    points: int = Field(ge=4, le=4096)
    pilots: Pilots
    step: float = Field(gt=0, le=0.005)
    rounds: tuple[Round, ...] = Field(min_length=1, max_length=8)


class TailStage(BaseModel):
    """Runs of the stage of the tail: how many tails each car of the ensemble gets."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    tails: int = Field(ge=1, le=256)


class CheckSize(BaseModel):
    """The check at a fine step: how many members, and the step (s)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    members: int = Field(ge=1, le=4096)
    step: float = Field(gt=0, le=0.002)


class CalibrationPlan(BaseModel):
    """A plan as its file has it."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_: Literal["aerodima/calibration-plan/1"] = Field(alias="schema")
    name: str = Field(min_length=1, max_length=80)
    seed: int = Field(ge=0)
    car: tuple[str, ...] = Field(min_length=1)
    tail: tuple[str, ...] = Field(min_length=1)
    discrepancy: dict[str, Discrepancy]
    plausible: Plausible
    car_stage: CarStage
    tail_stage: TailStage
    check: CheckSize

    @model_validator(mode="after")
    def _names_are_known(self) -> "CalibrationPlan":
        if set(self.discrepancy) != set(CALIBRATED_METRICS):
            raise ValueError(f"discrepancy: {sorted(self.discrepancy)}; allowed: {', '.join(CALIBRATED_METRICS)}")
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
    path = Path(name_or_path)
    if not path.suffix and path.name == str(name_or_path) and not path.exists():
        names = sorted(found.stem for found in (models_dir() / "calibration/plans").glob("*.yaml"))
        if path.name not in names:
            raise ScenarioError(f"calibration plan {path.name!r}: there is no such plan; {nearest(path.name, names)}")
        path = model_path(f"calibration/plans/{path.name}.yaml")
    data = read_yaml(path)
    try:
        plan = CalibrationPlan.model_validate(data)
    except ValidationError as error:
        raise explain(error, str(path), CalibrationPlan) from None
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


def assumed_elsewhere(plan: CalibrationPlan) -> list[str]:
    """Parameters with a prior that the plan leaves at their value, as `section.key`."""
    varied = {*plan.car, *plan.tail}

    def open_entries(section: str) -> list[tuple[str, ParameterEntry]]:
        return [(key, entry) for key, entry in load_parameter_entries(section).items() if entry.prior is not None]

    return [f"{s}.{key}" for s in SECTIONS for key, _ in open_entries(s) if f"{s}.{key}" not in varied]
