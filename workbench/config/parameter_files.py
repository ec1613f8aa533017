"""Parameter and scenario files, shared by the car's scenario and the rig's: reading, checking, overriding.

A parameter file holds the numbers of one section, each with unit and source (design section 3). A scenario file holds
only what differs from the parameters.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, Field, model_validator

from aerodima.workbench.config.checked_files import ModelT, StrictModel, checked, read_yaml
from aerodima.workbench.config.quantity import nearest, unit_of
from aerodima.workbench.errors import ScenarioError

PARAMETER_SCHEMA = "aerodima/parameters/1"


class ParameterEntry(StrictModel):
    """One number of `models/parameters`: value, unit, source, and for assumed ones the prior range and the reason."""

    value: float | int | bool | str
    unit: str
    source: str = Field(pattern=r"^(published: .+|datasheet: .+|assumed|calibrated: .+|chosen)$")
    prior: tuple[float, float] | None = None
    reason: str | None = None

    @model_validator(mode="after")
    def _reasons_are_given(self) -> "ParameterEntry":
        if self.source in ("assumed", "chosen") and not self.reason:
            raise ValueError(f"source {self.source!r} needs a reason")
        if self.source == "assumed" and self.prior is None:
            raise ValueError("source 'assumed' needs a prior range [low, high]")
        if self.prior is not None and not (
            isinstance(self.value, float | int) and self.prior[0] <= self.value <= self.prior[1]
        ):
            raise ValueError(f"value {self.value!r} lies outside its prior {list(self.prior)}")
        return self


def sections_of(scenario: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Section name -> model of a scenario class."""
    return {
        name: field.annotation
        for name, field in scenario.model_fields.items()
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
    }


def load_parameter_file(path: Path, model: type[BaseModel]) -> dict[str, ParameterEntry]:
    """Reads a parameter file, checks unit and source of every number and that none is missing.

    Raises:
        ScenarioError: names file, key and what is allowed.
    """
    entries = {}
    for key, raw in _raw_entries(path).items():
        if key not in model.model_fields:
            raise ScenarioError(f"{path}: {key}: unknown key; {nearest(str(key), list(model.model_fields))}")
        entries[key] = _entry(path, key, raw)
        if entries[key].unit != unit_of(model, key):
            raise ScenarioError(f"{path}: {key}: unit {entries[key].unit!r}; allowed is {unit_of(model, key)!r}")
    missing = set(model.model_fields) - set(entries)
    if missing:
        raise ScenarioError(f"{path}: missing: {', '.join(sorted(missing))}")
    return entries


def load_section(path: Path, model: type[ModelT], changes: Mapping[str, Any] | None = None) -> ModelT:
    """Reads a parameter file into its model.

    Args:
        path: the file.
        model: of its numbers, with their units and ranges.
        changes: values on top of those of the file.

    Raises:
        ScenarioError: as `load_parameter_file`; or a value is out of range.
    """
    values = {key: entry.value for key, entry in load_parameter_file(path, model).items()}
    return checked(model, {**values, **(changes or {})}, str(path))


def load_entries_without_model(path: Path) -> dict[str, ParameterEntry]:
    """Reads a parameter file whose section another package describes: value, unit and source of every number."""
    return {key: _entry(path, key, raw) for key, raw in _raw_entries(path).items()}


def _raw_entries(path: Path) -> dict[str, Any]:
    data = read_yaml(path)
    if data.pop("schema", None) != PARAMETER_SCHEMA:
        raise ScenarioError(f"{path}: schema: allowed is {PARAMETER_SCHEMA!r}")
    return data


def _entry(path: Path, key: str, raw: Any) -> ParameterEntry:
    return checked(ParameterEntry, raw, f"{path}: {key}")


def resolve(
    scenario: type[ModelT],
    schema: str,
    defaults: Mapping[str, Mapping[str, Any]],
    overrides: dict[str, Any],
    where: str,
) -> ModelT:
    """A scenario of overrides (section -> key -> value) on top of the parameters.

    Args:
        scenario: class of the scenario.
        schema: that its files carry.
        defaults: section -> key -> value of the parameters.
        overrides: nested plain data; a resolved scenario is accepted too.
        where: file or flag named in error messages.

    Raises:
        ScenarioError: unknown key, wrong unit, value out of range, NaN; names the place, the value and what is allowed.
    """
    merged: dict[str, Any] = {name: dict(values) for name, values in defaults.items()}
    for key, value in overrides.items():
        if key in defaults:
            if not isinstance(value, dict):
                raise ScenarioError(f"{where}: {key}: {value!r} is not allowed; it takes keys with values")
            merged[key] |= value
        else:
            merged[key] = value
    return checked(scenario, {"schema": schema} | _floats(merged, scenario), where, schema=schema)


def apply_setting(data: dict[str, Any], setting: str, sections: Mapping[str, type[BaseModel]], example: str) -> None:
    """Puts one override such as `car.com_height=0.21` into the content of a scenario file.

    Args:
        data: content of a scenario file; changed in place.
        setting: `section.key=value`, or `key=value` for a key of the scenario itself.
        sections: that exist.
        example: shown in the message about a malformed setting.
    """
    path, separator, text = setting.partition("=")
    parts = path.strip().split(".")
    if not separator or not all(parts) or len(parts) > 2:
        raise ScenarioError(f"--set {setting}: allowed is section.key=value, such as {example}")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise ScenarioError(f"--set {setting}: {text!r} is not a value") from None
    if len(parts) == 1:
        data[parts[0]] = value
        return
    section = data.setdefault(parts[0], {})
    if not isinstance(section, dict) or parts[0] not in sections:
        raise ScenarioError(f"--set {setting}: {parts[0]!r} is no section; {nearest(parts[0], list(sections))}")
    section[parts[1]] = value


def _floats(data: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """Whole numbers written for float fields become floats; everything else is left for strict validation."""
    result = {}
    for key, value in data.items():
        field = model.model_fields.get(key)
        annotation = None if field is None else field.annotation
        if isinstance(value, dict) and isinstance(annotation, type) and issubclass(annotation, BaseModel):
            value = _floats(value, annotation)
        elif annotation is float and type(value) is int:
            value = float(value)
        result[key] = value
    return result
