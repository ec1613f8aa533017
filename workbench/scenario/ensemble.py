"""Ensembles: the cars that are left possible after a calibration, each with a weight that says how
likely it is.

A file of `models/calibration` (schema `aerodima/ensemble/1`) holds the members as parameters that
differ from `models/parameters`, the best of them, and how they were made. A study that runs over an
ensemble states what the published data leave open, not only what one plausible car does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import EnsembleError, ScenarioError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.yaml_files import StrictModel, checked, find_file, read_yaml
from aerodima.workbench.scenario.scenario import SECTIONS, Scenario, load_scenario

ENSEMBLE_SCHEMA = "aerodima/ensemble/1"

Value = float | int | bool | str

BUILT = "built"
"""`tail.name` of the tail of the parameter files."""
_MOUNT = ("tail.mount_x", "tail.mount_height")
"""Part of the car, whatever tail stands on it."""


@dataclass(frozen=True)
class Member:
    """One car of an ensemble.

    Attributes:
        name: within its ensemble.
        weight: share of the probability, all weights of an ensemble sum to 1.
        values: `section.key` -> value, in the unit of the parameter.
    """

    name: str
    weight: float
    values: dict[str, Value]

    def settings_on(self, scenario: str | Path) -> tuple[str, ...]:
        """Overrides for a scenario of that name or path, such as `car.com_height=0.25`.

        Another tail than the built one keeps its own size and mass.
        """
        is_built = load_scenario(scenario).tail.name == BUILT
        return tuple(
            f"{key}={value}"
            for key, value in self.values.items()
            if is_built or not key.startswith("tail.") or key in _MOUNT
        )


class Split(NamedTuple):
    """Cars that laws are chosen on, cars that they are judged on, and cars kept for a benchmark;
    none in two parts.
    """

    training: tuple[Member, ...]
    test: tuple[Member, ...]
    reserved: tuple[Member, ...]


@dataclass(frozen=True)
class Ensemble:
    """Weighted members and where they come from.

    Attributes:
        name: of the ensemble.
        members: in the order of the file.
        best: the member that the parameter files hold, rounded; its tail only if the members are
            held to one.
        provenance: how the file was made (method, seed, targets, versions), as plain data.
        path: the file.
    """

    name: str
    members: tuple[Member, ...]
    best: Member
    provenance: dict[str, Any]
    path: Path

    @property
    def weights(self) -> FloatArray:
        """Weights of the members (n), summing to 1."""
        return np.array([member.weight for member in self.members])

    @property
    def effective_size(self) -> float:
        """Effective sample size 1 / sum(w^2)."""
        return float(1.0 / np.sum(self.weights**2))

    def drawn(self, number: int) -> tuple[Member, ...]:
        """`number` members that stand for all: drawn by weight, evenly over the weights in the
        order of the file.

        A member that is drawn k times has the weight k / number (systematic resampling). All of
        them, with their own weights, if there are no more than `number`.
        """
        if number < 1:
            raise EnsembleError(
                f"{number} members of {self.path}: allowed: 1 to {len(self.members)}"
            )
        if number >= len(self.members):
            return self.members
        middles = (np.arange(number) + 0.5) / number
        places, counts = np.unique(
            np.searchsorted(np.cumsum(self.weights), middles), return_counts=True
        )
        chosen = [self.members[min(place, len(self.members) - 1)] for place in places]
        return tuple(
            Member(m.name, k / number, m.values)
            for m, k in zip(chosen, counts.tolist(), strict=True)
        )

    def split(self, seed: int) -> Split:
        """The members but the best, which is the nominal car, in three parts.

        They are drawn by weight, one after the other and none twice, and dealt to the parts in
        turn: the first cars of a part, however many, stand for the ensemble with equal weights.
        """
        others = [member for member in self.members if member.name != self.best.name]
        weights = np.array([member.weight for member in others])
        # The order of arrival of exponential times with these rates is that of draws by weight
        # without replacement.
        order = np.argsort(np.random.default_rng(seed).exponential(size=weights.size) / weights)
        training, test, reserved = (
            tuple(others[place] for place in order[part::3]) for part in range(3)
        )
        return Split(training, test, reserved)

    def scenario(
        self, member: Member, scenario: str | Path, settings: Sequence[str] = ()
    ) -> Scenario:
        """A scenario with the car of a member; `settings` override the member.

        Raises:
            EnsembleError: the member's values do not go together; names file, member, value and
                what is allowed.
        """
        try:
            return load_scenario(scenario, [*member.settings_on(scenario), *settings])
        except ScenarioError as error:
            raise EnsembleError(f"{self.path}: member {member.name!r}: {error}") from None


def load_ensemble(name_or_path: str | Path = "car") -> Ensemble:
    """Loads an ensemble by path, or by name from `models/calibration`.

    Raises:
        EnsembleError: missing, of another schema, unknown parameter, value out of range, weights
            that are no weights; names the file, the member, the value and what is allowed.
    """
    path = find_file(name_or_path, "calibration", "ensemble", EnsembleError)
    data = read_yaml(path, EnsembleError)
    content = checked(_EnsembleFile, data, str(path), EnsembleError, schema=ENSEMBLE_SCHEMA)
    total = math.fsum(member.weight for member in content.members)
    members = tuple(Member(m.name, m.weight / total, _checked(path, m)) for m in content.members)
    named = {member.name: member for member in members}
    if content.best not in named:
        raise EnsembleError(
            f"{path}: best: {content.best!r} is no member; {nearest(content.best, named)}"
        )
    return Ensemble(content.name, members, named[content.best], content.provenance, path)


class _MemberEntry(StrictModel):
    name: str = Field(min_length=1, max_length=80)
    weight: float = Field(gt=0)
    values: dict[str, Value]


class _EnsembleFile(StrictModel):
    schema_: str = Field(alias="schema")
    name: str = Field(min_length=1, max_length=80)
    provenance: dict[str, Any]
    best: str
    members: tuple[_MemberEntry, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _names_differ(self) -> "_EnsembleFile":
        names = [member.name for member in self.members]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"members: {twice[0]!r} stands there twice; allowed: one member per name"
            )
        return self


def _checked(path: Path, member: _MemberEntry) -> dict[str, Value]:
    """The values of a member after a look at each key; whether they go together is checked when a
    scenario is made.
    """
    for key in member.values:
        section, _, name = key.partition(".")
        where = f"{path}: member {member.name!r}: {key}"
        if section not in SECTIONS:
            raise EnsembleError(f"{where}: {section!r} is no section; {nearest(section, SECTIONS)}")
        if name not in SECTIONS[section].model_fields:
            raise EnsembleError(
                f"{where}: unknown key; {nearest(name, SECTIONS[section].model_fields)}"
            )
    return dict(member.values)
