"""Parameter and scenario files of car and rig: read, overridden and checked.

A parameter file holds the numbers of one section, each with unit and source (design section 3); a
scenario file holds what differs from them.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, model_validator

from aerodima.workbench.core.array_types import Pair, Texts
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.file_reading import Facts, Json
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.quantity import angle_hint, check_rate, unit_of
from aerodima.workbench.core.ranges import NO_UNIT
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import (
    ModelT,
    StrictModel,
    checked,
    find_file,
    parse_yaml,
    read_yaml,
    require_mapping,
    shipped_names,
)

PARAMETER_SCHEMA = "aerodima/parameters/1"


class ParameterEntry(StrictModel):
    """One value of `models/parameters` with its unit, its source, and a reason if it was assumed or
    chosen; an assumed value has a prior range.
    """

    value: float | int | bool | str
    unit: str
    source: str = Field(pattern=r"^(published: .+|datasheet: .+|assumed|calibrated: .+|chosen)$")
    reason: str | None = None
    prior: Pair | None = None

    @model_validator(mode="after")
    def _is_accounted_for(self) -> Self:
        if self.source in ("assumed", "chosen") and not self.reason:
            raise ValueError(f"source {self.source!r} needs a reason")
        if self.prior is None:
            if self.source == "assumed":
                raise ValueError("source 'assumed' needs a prior range [low, high]")
            return self
        low, high = self.prior
        if isinstance(self.value, str) or not low <= self.value <= high:
            raise ValueError(f"value {self.value!r} lies outside its prior {list(self.prior)}")
        return self


def load_parameter_file(
    path: Path, model: type[BaseModel] | None = None
) -> dict[str, ParameterEntry]:
    """Read a parameter file: value, unit and source of every number.

    Args:
        path: path of the parameter file.
        model: model of the section, all of whose keys the file must hold in the model's units; None
            for a file without a model.

    Raises:
        ScenarioError: the file is wrong; names file, key and what is allowed.
    """
    data = read_yaml(path)
    if data.pop("schema", None) != PARAMETER_SCHEMA:
        raise ScenarioError(f"{path}: schema: must be {PARAMETER_SCHEMA!r}")
    entries = {key: checked(ParameterEntry, raw, f"{path}: {key}") for key, raw in data.items()}
    if model is None:
        return entries
    known = model.model_fields
    for key, entry in entries.items():
        if key not in known:
            raise ScenarioError(f"{path}: {key}: unknown key; {nearest(str(key), known)}")
        if entry.unit != unit_of(model, key):
            raise ScenarioError(f"{path}: {key}: {entry.unit!r} must be {unit_of(model, key)!r}")
    missing = known.keys() - entries.keys()
    if missing:
        raise ScenarioError(f"{path}: missing: {', '.join(sorted(missing))}")
    return entries


def load_section(path: Path, model: type[ModelT]) -> ModelT:
    """Read a parameter file into its model.

    Args:
        path: path of the parameter file.
        model: model of the section, with units and ranges of its numbers.

    Raises:
        ScenarioError: as `load_parameter_file`; or a value is out of range.
    """
    values = {key: entry.value for key, entry in load_parameter_file(path, model).items()}
    return checked(model, values, str(path))


class ScenarioFile(StrictModel):
    """Base of the scenarios of car and rig: reading, overriding, writing. SI units and radians.

    A subclass has one field per section, whose numbers stand in a parameter file of their own.
    """

    model_config = ConfigDict(strict=True)

    folder: ClassVar[str]
    """Folder of `models/` where the scenarios ship."""
    default_name: ClassVar[str]
    """Name of a run whose scenario gives none."""
    example: ClassVar[str]
    """Example of a setting, for the message about a malformed one."""
    rates: ClassVar[Texts]
    """Keys of rates, Hz, that must not be above 1/step."""
    parameter_folder: ClassVar[str] = "parameters"
    """Folder of `models/` with one file per section."""
    shared_with_car: ClassVar[Mapping[str, str]] = {}
    """Section of the car whose parameter file a section uses, by the name of the latter."""
    retired: ClassVar[Mapping[str, set[str]]] = {}
    """Keys, by section, that resolved scenarios of earlier versions hold (logs, swing files) and
    that are no longer needed."""
    renamed: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    """Present names of keys of earlier versions, by section and old name."""

    schema_: str = Field(alias="schema")
    name: str = Field(description="name of the run in reports", min_length=1, max_length=80)
    seed: int = Field(1, description="seed of every random number of the run", ge=0, le=2**63 - 1)

    @model_validator(mode="after")
    def _rates_fit_the_step(self) -> Self:
        step: float = self.simulation.step  # type: ignore[attr-defined]
        for key in self.rates:
            check_rate(attrgetter(key)(self), step, key)
        return self

    def _require_at_most(self, key: str, limit: str) -> None:
        """Raise ValueError if the magnitude of a key is above that of another key, its limit."""
        value, largest = attrgetter(key, limit)(self)
        self._require(abs(value) <= largest + 1e-9, key, f"<= {limit}, {largest:.9g}")

    def _require(self, holds: bool, key: str, rule: str) -> None:
        """Raise ValueError if the rule of a key does not hold."""
        if holds:
            return
        section, _, name = key.partition(".")
        values = getattr(self, section)
        number = getattr(values, name)
        unit = unit_of(type(values), name)
        value = repr(number) if isinstance(number, str | bool) else f"{number:.9g}"
        if unit != NO_UNIT:
            value += f" {unit}"
        raise ValueError(f"{key}: {value} must be {rule}{angle_hint(unit)}")

    @classmethod
    def sections(cls) -> dict[str, type[BaseModel]]:
        """Return the model of each section by its name; each section has a parameter file."""
        return {
            name: field.annotation
            for name, field in cls.model_fields.items()
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
        }

    @classmethod
    def require_section(cls, section: str, where: str) -> None:
        """Raise ScenarioError unless there is this section; names the nearest."""
        sections = cls.sections()
        if section not in sections:
            near = nearest(section, sections)
            raise ScenarioError(f"{where}: {section!r} is no section; {near}")

    @classmethod
    def require_key(cls, key: str) -> None:
        """Raise ScenarioError unless there is this key, `section.name`; names the nearest."""
        section, _, name = key.partition(".")
        cls.require_section(section, key)
        names = cls.sections()[section].model_fields
        if name not in names:
            near = nearest(key, [f"{section}.{known}" for known in names])
            raise ScenarioError(f"{key}: unknown key; {near}")

    @classmethod
    def parameter_path(cls, section: str) -> Path:
        """Find the file of `models/parameters` that holds a section."""
        shared = cls.shared_with_car.get(section)
        return model_path(
            f"parameters/{shared}.yaml" if shared else f"{cls.parameter_folder}/{section}.yaml"
        )

    @classmethod
    def parameters(cls, section: str) -> dict[str, ParameterEntry]:
        """Read the file of a section; check unit and source of every number, and that none is
        missing.
        """
        return load_parameter_file(cls.parameter_path(section), cls.sections()[section])

    @classmethod
    def defaults(cls) -> dict[str, Json]:
        """Read the values of `models/parameters` by section and key."""
        defaults = {}
        for section, model in cls.sections().items():
            path = cls.parameter_path(section)
            defaults[section] = dict(_read_values(path, model, path.stat().st_mtime_ns))
        return defaults

    @classmethod
    def from_dict(
        cls, overrides: Facts, where: str = "scenario", settings: Sequence[str] = ()
    ) -> Self:
        """Resolve overrides (section -> key -> value) on top of `models/parameters`.

        Args:
            overrides: nested plain data; a resolved scenario is accepted too.
            where: file or flag named in error messages.
            settings: settings `section.key=value`, which replace values of the overrides.

        Raises:
            ScenarioError: unknown key, wrong unit, value out of range, NaN; names the place, the
                value and what is allowed.
        """
        data = deepcopy(dict(overrides))
        for setting in settings:
            cls.apply_setting(data, setting)
        return cls._resolve(cls.defaults(), cls._with_new_keys(data), where)

    @classmethod
    def load(cls, name_or_path: str | Path, settings: Sequence[str] = ()) -> Self:
        """Load a scenario by path, or by name from `models/scenarios`, with overrides such as
        `car.com_height=0.21`.

        A file may name a scenario as its `base`, by a name or by a path from its own folder; it
        then holds only what differs from that scenario.

        Args:
            name_or_path: path of a YAML file, or name of a scenario that ships.
            settings: overrides of the form `section.key=value`.

        Raises:
            ScenarioError: no such file or name; or as `from_dict`.
        """
        path = find_file(name_or_path, cls.folder, "scenario")
        data = cls.with_base(read_yaml(path), path.parent)
        where = str(path)
        if settings:
            where += f" with --set {' '.join(settings)}"
        return cls.from_dict(data, where, settings)

    @classmethod
    def with_base(cls, data: Json, folder: Path) -> Json:
        """Join the content of a file in a folder with that of the scenario that it names as
        `base`.
        """
        base = data.pop("base", None)
        if base is None:
            return data
        path = find_file(str(base), cls.folder, "base", start=folder)
        below = read_yaml(path)
        if "base" in below:
            raise ScenarioError(f"{path}: base: a scenario that is a base must not have one")
        return merged(below, data)

    @classmethod
    def names(cls) -> list[str]:
        """List the scenarios that ship."""
        return shipped_names(cls.folder)

    def varied(self, **changes: Any) -> Self:
        """Make a scenario that differs in some keys, without reading a file.

        Example: `varied(car={"mass": 5.5}, seed=2)`.

        Raises:
            ScenarioError: unknown key, wrong unit or a value out of range.
        """
        sections = {name: getattr(self, name).model_dump() for name in self.sections()}
        overrides = {"name": self.name, "seed": self.seed, **changes}
        return self._resolve(sections, overrides, f"scenario {self.name!r}")

    def resolved(self) -> Json:
        """Write the scenario as plain data (JSON-able), every value written out."""
        return self.model_dump(mode="json", by_alias=True)

    @classmethod
    def apply_setting(cls, data: Json, setting: str) -> None:
        """Put an override such as `car.com_height=0.21` into the content of a scenario file.

        Args:
            data: content of a scenario file; changed in place.
            setting: text `section.key=value`, or `key=value` for a key of the scenario itself.
        """
        path, separator, text = setting.partition("=")
        *sections, key = path.strip().split(".")
        if not (separator and key and all(sections) and len(sections) < 2):
            raise ScenarioError(
                f"--set {setting}: must be section.key=value, such as {cls.example}"
            )
        try:
            value = parse_yaml(text)
        except yaml.YAMLError:
            raise ScenarioError(f"--set {setting}: {text!r} is not a value") from None
        for section in sections:
            cls.require_section(section, f"--set {setting}")
            data = require_mapping(data.setdefault(section, {}), section, ScenarioError)
        data[key] = value

    @classmethod
    def _resolve(cls, below: Facts, overrides: Json, where: str) -> Self:
        schema = cls.model_fields["schema_"].default
        unnamed = {"schema": schema, "name": cls.default_name, **below}
        return checked(cls, merged(unnamed, overrides), where, schema=schema)

    @classmethod
    def _with_new_keys(cls, overrides: Json) -> Json:
        """Rename the keys of earlier versions, and drop retired keys; other data stay.

        Only a whole section can hold a retired key: in a file that names single keys it is an
        error.
        """
        result = dict(overrides)
        for section, model in cls.sections().items():
            values = overrides.get(section)
            if not isinstance(values, dict):
                continue
            retired = cls.retired.get(section, set())
            if len(values) <= len(model.model_fields) // 2:
                retired = set()
            names = cls.renamed.get(section, {})
            result[section] = {
                names.get(key, key): value for key, value in values.items() if key not in retired
            }
        return result


def merged(below: Facts, above: Facts) -> Json:
    """Join two scenarios section by section; where both have a value, that of `above` holds."""
    merged = dict(below)
    for key, value in above.items():
        section = below.get(key)
        if isinstance(section, dict) and isinstance(value, dict):
            merged[key] = section | value
        else:
            merged[key] = value
    return merged


@lru_cache(maxsize=128)
def _read_values(path: Path, model: type[BaseModel], _changed: int) -> Json:
    """Read the values of a parameter file, again only if it changes: that costs 5 % of a run."""
    return {key: entry.value for key, entry in load_parameter_file(path, model).items()}
