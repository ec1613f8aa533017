"""Parameter files: the numbers of one section, each with unit and source (design section 3)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
