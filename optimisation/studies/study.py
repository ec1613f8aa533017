"""A study: which runs are to be made, as a YAML file of scenarios with grids and samples of their
numbers.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import Field, field_validator, model_validator
from scipy.stats import norm, qmc

from aerodima.optimisation.studies.runs import RunTask, load_any_scenario
from aerodima.workbench.core.errors import ScenarioError, SweepError
from aerodima.workbench.core.file_reading import Json, Settings
from aerodima.workbench.core.yaml_files import StrictModel, checked, find_file, read_yaml
from aerodima.workbench.scenario.ensemble import Member, load_ensemble
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.scenario_file import ScenarioFile

STUDY_SCHEMA = "aerodima/study/1"
MAX_RUNS = 100_000
"""Upper bound against typos: a day and a half on two cores."""

Value = float | int | bool | str


class Range(StrictModel):
    """Evenly spaced values, both ends included."""

    first: float
    last: float
    number: int = Field(description="number of values", ge=1, le=10_000)

    def values(self) -> list[Value]:
        """Returns the values as the plain decimals that a reader expects, without rounding errors
        of a division.
        """
        return [float(f"{value:.12g}") for value in np.linspace(self.first, self.last, self.number)]


class Uniform(StrictModel):
    """Uniform distribution between two values."""

    low: float
    high: float

    @model_validator(mode="after")
    def _ordered(self) -> "Uniform":
        if self.high <= self.low:
            raise ValueError(f"high: {self.high:g}; must be above low, {self.low:g}")
        return self

    def at(self, share: np.ndarray) -> np.ndarray:
        """Returns the values (n) at quantiles (n)."""
        return self.low + (self.high - self.low) * share


class Normal(StrictModel):
    """Normal distribution."""

    mean: float
    deviation: float = Field(gt=0)

    def at(self, share: np.ndarray) -> np.ndarray:
        """Returns the values (n) at quantiles (n)."""
        return norm.ppf(np.clip(share, 1e-9, 1.0 - 1e-9), self.mean, self.deviation)


class Sample(StrictModel):
    """Scattered values of several factors at once (scipy.stats.qmc), the same for the same seed."""

    method: Literal["sobol", "lhs"] = "sobol"
    number: int = Field(
        description="number of samples; a power of 2 balances Sobol's", ge=1, le=MAX_RUNS
    )
    anew: bool = Field(
        default=False, description="true: each combination of the grid has samples of its own"
    )
    seed: int = Field(default=1, description="seed of the scattering", ge=0)
    factors: dict[str, Uniform | Normal] = Field(min_length=1)
    new_seeds: bool = Field(
        default=False, description="true: each sample has its own seed, so its own sensor noise"
    )

    def rows(self, times: int = 1) -> list[dict[str, Value]]:
        """Draws one dict of values by factor per sample, `times` times the number of samples."""
        dimensions = len(self.factors)
        number = times * self.number
        generator = np.random.default_rng(self.seed)
        if self.method == "sobol":
            power = int(np.ceil(np.log2(number)))
            shares = qmc.Sobol(dimensions, rng=generator).random_base2(power)[:number]
        else:
            shares = qmc.LatinHypercube(dimensions, rng=generator).random(number)
        rows: list[dict[str, Value]] = [{} for _ in range(number)]
        for (name, distribution), share in zip(self.factors.items(), shares.T, strict=True):
            for row, value in zip(rows, distribution.at(share), strict=True):
                row[name] = float(f"{value:.12g}")
        if self.new_seeds:
            for index, row in enumerate(rows):
                row["seed"] = 1 + index
        return rows


class Block(StrictModel):
    """One scenario of the car or a rig with factors: every combination of the grid, with every
    sample.

    The two values of a factor in both are added.
    """

    name: str = Field(default="", description="name of the block within the study", max_length=40)
    scenario: str = Field(description="name or path of the scenario")
    settings: Settings = Field(
        default=(), description="overrides of every run, such as car.mass=5.5"
    )
    grid: dict[str, list[Value] | Range] = Field(default={})
    sample: Sample | None = None

    @field_validator("grid", mode="before")
    @classmethod
    def _refuse_empty_factors(cls, grid: Any) -> Any:
        """Raises one sentence for the mistake that the schema would answer with one per kind of
        factor.
        """
        for name, values in grid.items() if isinstance(grid, dict) else ():
            if values in ([], {}, None):
                raise ValueError(f"{name}: {values!r} is no value; must have at least one")
        return grid

    def points(self) -> Iterator[dict[str, Value]]:
        """Yields the values of each run, by factor."""
        cells = list(product(*self._axes))
        samples: list[dict[str, Value]] = [{}] * len(cells)
        if self.sample is not None:
            if self.sample.anew:
                samples = self.sample.rows(len(cells))
            else:
                samples = self.sample.rows() * len(cells)
        for index, sampled in enumerate(samples):
            point = dict(zip(self.grid, cells[index // self._samples], strict=True))
            for name, value in sampled.items():
                # Both are numbers (`check_factors`); seeds, which are integers, stay so.
                point[name] = point.get(name, 0) + value  # type: ignore[operator]
            yield point

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(map(len, self._axes)) * self._samples

    @property
    def _samples(self) -> int:
        return 1 if self.sample is None else self.sample.number

    @property
    def _axes(self) -> list[list[Value]]:
        return [axis.values() if isinstance(axis, Range) else axis for axis in self.grid.values()]

    @property
    def factors(self) -> list[str]:
        """Keys that differ from run to run."""
        factors = list(self.grid)
        if self.sample is not None:
            factors += self.sample.factors
            if self.sample.new_seeds:
                factors.append("seed")
        return factors


class Study(StrictModel):
    """Everything that is to be run. A file with one block may write its keys at the top level."""

    schema_: Literal["aerodima/study/1"] = Field(default="aerodima/study/1", alias="schema")
    name: str = Field(description="name of the study on its page", min_length=1, max_length=80)
    signals: Literal["all", "outcome"] = Field(
        default="outcome",
        description="signals of a run; all: those of the outcome and the impulses of the tail",
    )
    logs: bool = Field(
        default=False, description="true: the log of each run is kept in the folder `logs`"
    )
    ensemble: str | None = Field(
        default=None, description="name or path of an ensemble; every run for every member of it"
    )
    members: int | None = Field(
        default=None, description="number of members if not all, drawn by weight", ge=1
    )
    blocks: tuple[Block, ...] = Field(min_length=1)


@dataclass(frozen=True)
class PlannedRun:
    """A task, and the columns of its row that say where it stands in the study.

    Attributes:
        task: task that is run.
        place: `block`, `member`, `weight`, one entry per factor, and the `log` within the folder of
            the study.
    """

    task: RunTask
    place: dict[str, Value | None]


def load_study(path: str | Path) -> Study:
    """Reads a study by path, or by name from `models/studies`.

    Raises:
        SweepError: no such file or name, wrong key, value or factor; names the place, the value and
            what is allowed.
    """
    path = find_file(path, "studies", "study", SweepError)
    data = {"schema": STUDY_SCHEMA, "name": path.stem} | read_yaml(path, SweepError)
    study = checked(Study, _in_blocks(data), str(path), SweepError, schema=STUDY_SCHEMA)
    check_factors(study, str(path))
    return study


def check_factors(study: Study, where: str) -> None:
    """Raises SweepError for a factor that no scenario has, and for a scenario that is not there."""
    for block in study.blocks:
        label = f"{where}: block {block.name!r}" if block.name else where
        try:
            scenario = load_any_scenario(block.scenario, block.settings)
        except ScenarioError as error:
            raise SweepError(f"{label}: {error}") from None
        for factor in block.factors:
            _check_factor(factor, type(scenario), label)
        for name in block.factors[len(block.grid) :]:
            values = block.grid.get(name)
            if isinstance(values, list) and any(isinstance(value, str | bool) for value in values):
                raise SweepError(
                    f"{label}: {name}: is in the grid and in the sample; must be numbers, which "
                    "are added"
                )
        if study.ensemble is not None and not isinstance(scenario, Scenario):
            raise SweepError(
                f"{label}: ensemble: {study.ensemble}; must be none, with a scenario of a rig"
            )


def plan_runs(study: Study) -> list[PlannedRun]:
    """Plans every run of a study, in the order of its table.

    Raises:
        SweepError: more than `MAX_RUNS`.
        EnsembleError: the ensemble cannot be read.
    """
    members: Sequence[Member | None] = [None]
    if study.ensemble is not None:
        ensemble = load_ensemble(study.ensemble)
        members = ensemble.members
        if study.members is not None:
            members = ensemble.resample(study.members)
    number = sum(block.size for block in study.blocks) * len(members)
    if number > MAX_RUNS:
        raise SweepError(f"{study.name}: {number} runs; must be at most {MAX_RUNS}")
    factors = dict.fromkeys(factor for block in study.blocks for factor in block.factors)
    runs: list[PlannedRun] = []
    for index, block in enumerate(study.blocks):
        for point in block.points():
            for member in members:
                place: dict[str, Value | None] = {"block": block.name or str(index)}
                settings: list[str] = []
                if member is not None:
                    place |= {"member": member.name, "weight": member.weight}
                    settings += member.settings_on(block.scenario)
                settings += block.settings
                settings += [f"{name}={_text(value)}" for name, value in point.items()]
                place |= {name: point.get(name) for name in factors}
                name = f"{len(runs):06d}"
                if study.logs:
                    place["log"] = f"logs/{name}.parquet"
                task = RunTask(name, block.scenario, tuple(settings), study.signals)
                runs.append(PlannedRun(task, place))
    return runs


def _text(value: Value) -> str:
    """Returns the text that YAML reads back: floats in full precision (`1e-05` would be text,
    `1.0e-05` is a number).
    """
    if isinstance(value, str):
        return value
    return yaml.safe_dump(value).splitlines()[0]


def _in_blocks(data: Json) -> Json:
    own = [key for key in Block.model_fields if key in data and key != "name"]
    if "blocks" in data or not own:
        return data
    rest = {key: value for key, value in data.items() if key not in own}
    return rest | {"blocks": [{key: data[key] for key in own}]}


def _check_factor(factor: str, scenario: type[ScenarioFile], where: str) -> None:
    if factor in ("name", "seed"):
        return
    if "." not in factor:
        raise SweepError(
            f"{where}: factor {factor!r}: must be section.key, such as car.tyre_friction, or seed"
        )
    try:
        scenario.require_key(factor)
    except ScenarioError as error:
        raise SweepError(f"{where}: factor {error}") from None
