"""Ensembles: the cars that a calibration leaves possible, each weighted by its probability.

A file of `models/calibration` (schema `aerodima/ensemble/1`) holds the members as parameters that
differ from `models/parameters`, the best of them, and how they were made. A study that runs over an
ensemble states what the published data leave open, not only what one plausible car does.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass as pydantic_dataclass

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import EnsembleError, ScenarioError
from aerodima.workbench.core.file_reading import Json, Settings
from aerodima.workbench.core.key_errors import nearest, require_unique
from aerodima.workbench.core.yaml_files import StrictModel, checked, find_file, read_yaml
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

ENSEMBLE_SCHEMA = "aerodima/ensemble/1"

Value = float | int | bool | str

BUILT = "built"
"""Value of `tail.name` in the parameter files."""
_MOUNT = ("tail.mount_x", "tail.mount_height")
"""Keys of the tail that belong to the car, whatever tail it carries."""


@pydantic_dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Member:
    """One car of an ensemble.

    Attributes:
        name: name of the member within its ensemble.
        weight: share of the probability; a file's weights are divided by their sum.
        values: value of each parameter `section.key`, in its unit.
    """

    name: Annotated[str, Field(min_length=1, max_length=80)]
    weight: Annotated[float, Field(gt=0)]
    values: dict[str, Value]

    @model_validator(mode="after")
    def _keys_exist(self) -> Self:
        """Refuse unknown keys; whether values go together is checked when a scenario is made."""
        for key in self.values:
            try:
                Scenario.require_key(key)
            except ScenarioError as error:
                raise ValueError(f"member {self.name!r}: {error}") from None
        return self

    def settings_on(self, scenario: str | Path) -> Settings:
        """List overrides for a scenario of that name or path, such as `car.com_height=0.25`.

        A tail other than the built one keeps its own size and mass.
        """
        is_built = load_scenario(scenario).tail.name == BUILT
        return tuple(
            f"{key}={value}"
            for key, value in self.values.items()
            if is_built or not key.startswith("tail.") or key in _MOUNT
        )


class Split(NamedTuple):
    """Cars on which laws are chosen, cars on which they are judged, and cars held out for a
    benchmark; no car is in two parts.
    """

    training: tuple[Member, ...]
    test: tuple[Member, ...]
    holdout: tuple[Member, ...]


@dataclass(frozen=True)
class Ensemble:
    """Weighted members and where they come from.

    Attributes:
        name: name of the ensemble.
        members: members in the order of the file.
        best: member nearest to the middle. `models/parameters` hold that of `simulated`, the
            scenario `field` holds that of `physical`.
        provenance: how the file was made (method, seed, targets, versions), as plain data.
        path: path of the ensemble file.
    """

    name: str
    members: tuple[Member, ...]
    best: Member
    provenance: Json
    path: Path

    @property
    def weights(self) -> FloatArray:
        """Collect the weights of the members (n); they sum to 1."""
        return np.array([member.weight for member in self.members])

    @property
    def effective_size(self) -> float:
        """Compute the effective sample size 1 / sum(w^2)."""
        return float(1.0 / np.sum(self.weights**2))

    def resample(self, number: int) -> tuple[Member, ...]:
        """Draw `number` members by weight to stand for all, by systematic resampling in the order
        of the file.

        A member that is drawn k times has the weight k / number. All members are returned, with
        their own weights, if there are no more than `number`.
        """
        if number < 1:
            raise EnsembleError(
                f"{number} members of {self.path}: must be 1 to {len(self.members)}"
            )
        if number >= len(self.members):
            return self.members
        middles = (np.arange(number) + 0.5) / number
        indices = np.searchsorted(np.cumsum(self.weights), middles)
        indices = np.minimum(indices, len(self.members) - 1)
        draws = Counter(indices.tolist())
        return tuple(
            replace(self.members[index], weight=count / number) for index, count in draws.items()
        )

    def split(self, seed: int) -> Split:
        """Split the members except the best, which is the nominal car, into three parts.

        They are drawn by weight without replacement and assigned round-robin: the first cars of a
        part, however many, stand for the ensemble with equal weights.
        """
        others = [member for member in self.members if member.name != self.best.name]
        weights = np.array([member.weight for member in others])
        # The order of arrival of exponential times with these rates is that of draws by weight
        # without replacement.
        times = np.random.default_rng(seed).exponential(size=weights.size) / weights
        cars = tuple(others[index] for index in np.argsort(times))
        return Split(cars[0::3], cars[1::3], cars[2::3])

    def scenario(
        self, member: Member, scenario: str | Path, settings: Sequence[str] = ()
    ) -> Scenario:
        """Load a scenario with the car of a member; `settings` override the member.

        Raises:
            EnsembleError: the member's values do not go together; names file, member, value and
                what is allowed.
        """
        try:
            return load_scenario(scenario, [*member.settings_on(scenario), *settings])
        except ScenarioError as error:
            raise EnsembleError(f"{self.path}: member {member.name!r}: {error}") from None


def load_ensemble(name_or_path: str | Path = "physical") -> Ensemble:
    """Load an ensemble by path, or by name from `models/calibration`.

    Raises:
        EnsembleError: missing file, another schema, unknown parameter, value out of range, invalid
            weights; names the file, the member, the value and what is allowed.
    """
    path = find_file(name_or_path, "calibration", "ensemble", EnsembleError)
    data = read_yaml(path, EnsembleError)
    content = checked(_EnsembleFile, data, str(path), EnsembleError, schema=ENSEMBLE_SCHEMA)
    total = math.fsum(member.weight for member in content.members)
    members = {m.name: replace(m, weight=m.weight / total) for m in content.members}
    if content.best not in members:
        raise EnsembleError(
            f"{path}: best: {content.best!r} is no member; {nearest(content.best, members)}"
        )
    best = members[content.best]
    return Ensemble(content.name, tuple(members.values()), best, content.provenance, path)


class _EnsembleFile(StrictModel):
    schema_: str = Field(alias="schema")
    name: str = Field(min_length=1, max_length=80)
    provenance: Json
    best: str
    members: tuple[Member, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        require_unique([member.name for member in self.members], "members: name")
        return self
