"""A scenario: everything that is needed to repeat a run, typed, with its seed.

A scenario file holds only what differs from `models/parameters`; `load_scenario` resolves it.
"""

from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from workbench.errors import ScenarioError
from workbench.parameters import (
    CarParameters,
    ControllerParameters,
    DriveParameters,
    EnvironmentParameters,
    FrictionParameters,
    GpsParameters,
    ImuParameters,
    ManoeuvreParameters,
    SailEncoderParameters,
    ServoParameters,
    SimulationParameters,
    TailMotorParameters,
    TailParameters,
)
from workbench.quantity import explain, nearest, unit_of
from workbench.resources import model_path, models_dir

SCENARIO_SCHEMA = "aerodima/scenario/1"
PARAMETER_SCHEMA = "aerodima/parameters/1"


class Scenario(BaseModel):
    """Resolved scenario, frozen. Lengths in m, angles in rad, times in s, speeds in m/s."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)

    schema_: Literal["aerodima/scenario/1"] = Field("aerodima/scenario/1", alias="schema")
    name: str = Field("turn", description="what the run is called in reports", min_length=1, max_length=80)
    seed: int = Field(1, description="seed of every random number of the run", ge=0, le=2**63 - 1)
    car: CarParameters
    tail: TailParameters
    tail_motor: TailMotorParameters
    friction: FrictionParameters
    servo: ServoParameters
    drive: DriveParameters
    imu: ImuParameters
    gps: GpsParameters
    sail_encoder: SailEncoderParameters
    environment: EnvironmentParameters
    controller: ControllerParameters
    manoeuvre: ManoeuvreParameters
    simulation: SimulationParameters

    @model_validator(mode="after")
    def _rates_fit_the_step(self) -> "Scenario":
        step = self.simulation.step
        rates = {
            "imu.rate": self.imu.rate,
            "gps.rate": self.gps.rate,
            "sail_encoder.rate": self.sail_encoder.rate,
            "controller.rate": self.controller.rate,
            "simulation.log_rate": self.simulation.log_rate,
        }
        for key, rate in rates.items():
            if rate * step > 1.0 + 1e-9:
                raise ValueError(
                    f"{key}: {rate:g} Hz is above 1/step; allowed with step {step:g} s: <= {1 / step:g} Hz"
                )
        return self

    @model_validator(mode="after")
    def _geometry_is_possible(self) -> "Scenario":
        if self.tail.sail_length > self.tail.length:
            raise ValueError(
                f"tail.sail_length: {self.tail.sail_length:g} m; allowed: <= tail.length {self.tail.length:g} m"
            )
        if self.manoeuvre.steer_angle > self.servo.limit + 1e-9:
            steer, limit = self.manoeuvre.steer_angle, self.servo.limit
            raise ValueError(f"manoeuvre.steer_angle: {steer:g} rad; allowed: <= servo.limit {limit:g} rad")
        ramp, start = self.manoeuvre.speed_ramp, self.manoeuvre.turn_start
        if self.manoeuvre.kind == "turn" and ramp > start:
            raise ValueError(f"manoeuvre.speed_ramp: {ramp:g} s; allowed: <= turn_start {start:g} s")
        return self

    def resolved(self) -> dict[str, Any]:
        """The scenario as plain data (JSON-able), every value written out."""
        return self.model_dump(mode="json", by_alias=True)


SECTIONS: dict[str, type[BaseModel]] = {
    name: field.annotation
    for name, field in Scenario.model_fields.items()
    if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
}
"""Section name -> model; one file of `models/parameters` each."""


class ParameterEntry(BaseModel):
    """One number of `models/parameters`: value, unit, source, and for assumed ones the prior range and the reason."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

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


def load_parameter_entries(section: str) -> dict[str, ParameterEntry]:
    """Reads `models/parameters/<section>.yaml`, checks unit and source of every number and that none is missing."""
    path = model_path(f"parameters/{section}.yaml")
    model = SECTIONS[section]
    data = read_yaml(path)
    if data.pop("schema", None) != PARAMETER_SCHEMA:
        raise ScenarioError(f"{path}: schema: allowed is {PARAMETER_SCHEMA!r}")
    entries = {}
    for key, raw in data.items():
        if key not in model.model_fields:
            raise ScenarioError(f"{path}: {key}: unknown key; {nearest(key, list(model.model_fields))}")
        try:
            entries[key] = ParameterEntry.model_validate(raw)
        except ValidationError as error:
            raise explain(error, f"{path}: {key}", ParameterEntry) from None
        if entries[key].unit != unit_of(model, key):
            raise ScenarioError(f"{path}: {key}: unit {entries[key].unit!r}; allowed is {unit_of(model, key)!r}")
    missing = set(model.model_fields) - set(entries)
    if missing:
        raise ScenarioError(f"{path}: missing: {', '.join(sorted(missing))}")
    return entries


def default_values() -> dict[str, dict[str, Any]]:
    """Section -> key -> value of `models/parameters`."""
    return {name: {key: entry.value for key, entry in load_parameter_entries(name).items()} for name in SECTIONS}


def scenario_from_dict(overrides: dict[str, Any], where: str = "scenario") -> Scenario:
    """Resolves overrides (section -> key -> value) on top of `models/parameters`.

    Args:
        overrides: nested plain data; a resolved scenario is accepted too.
        where: file or flag named in error messages.

    Raises:
        ScenarioError: unknown key, wrong unit, value out of range, NaN; names the place, the value and what is allowed.
    """
    merged: dict[str, Any] = default_values()
    for key, value in overrides.items():
        if key in SECTIONS:
            if not isinstance(value, dict):
                raise ScenarioError(f"{where}: {key}: {value!r} is not allowed; it takes keys with values")
            merged[key] |= value
        else:
            merged[key] = value
    if merged.get("schema", SCENARIO_SCHEMA) != SCENARIO_SCHEMA:
        raise ScenarioError(
            f"{where}: schema: {merged['schema']!r} is not read by this version; allowed is {SCENARIO_SCHEMA!r}"
        )
    try:
        return Scenario.model_validate(_floats(merged, Scenario))
    except ValidationError as error:
        raise explain(error, where, Scenario) from None


def load_scenario(name_or_path: str | Path, settings: list[str] | None = None) -> Scenario:
    """Loads a scenario by path, or by name from `models/scenarios`, with overrides such as `car.com_height=0.21`."""
    path = Path(name_or_path)
    if not path.suffix:
        path = model_path(f"scenarios/{name_or_path}.yaml")
    data = read_yaml(path)
    for setting in settings or []:
        _apply_setting(data, setting)
    return scenario_from_dict(data, f"{path} with --set {' '.join(settings)}" if settings else str(path))


def scenario_names() -> list[str]:
    """Names of the scenarios that ship in `models/scenarios`."""
    return sorted(path.stem for path in (models_dir() / "scenarios").glob("*.yaml"))


def read_yaml(path: Path) -> dict[str, Any]:
    """Reads a YAML mapping. Raises `ScenarioError` for a missing file, bad syntax or another kind of content."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ScenarioError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from None
    except yaml.YAMLError as error:
        raise ScenarioError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: holds a {type(data).__name__}; allowed is a mapping of sections")
    return data


def _apply_setting(data: dict[str, Any], setting: str) -> None:
    path, separator, text = setting.partition("=")
    parts = path.strip().split(".")
    if not separator or not all(parts) or len(parts) > 2:
        raise ScenarioError(f"--set {setting}: allowed is section.key=value, such as car.com_height=0.21")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise ScenarioError(f"--set {setting}: {text!r} is not a value") from None
    if len(parts) == 1:
        data[parts[0]] = value
        return
    section = data.setdefault(parts[0], {})
    if not isinstance(section, dict) or parts[0] not in SECTIONS:
        raise ScenarioError(f"--set {setting}: {parts[0]!r} is no section; {nearest(parts[0], list(SECTIONS))}")
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
