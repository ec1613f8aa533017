"""A scenario: everything that is needed to repeat a run, typed, with its seed.

A scenario file holds only what differs from `models/parameters`; `load_scenario` resolves it.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from aerodima.workbench.config.car_parameters import (
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
    WindParameters,
)
from aerodima.workbench.config.parameter_files import (
    ParameterEntry,
    apply_setting,
    load_parameter_file,
    read_yaml,
    resolve,
    sections_of,
)
from aerodima.workbench.resources import model_path, models_dir

SCENARIO_SCHEMA = "aerodima/scenario/1"


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
    wind: WindParameters
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
            "servo.frame_rate": self.servo.frame_rate,
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
            raise ValueError(f"manoeuvre.steer_angle: {steer:.9g} rad; allowed: <= servo.limit {limit:.9g} rad")
        ramp, start = self.manoeuvre.speed_ramp, self.manoeuvre.turn_start
        if self.manoeuvre.kind == "turn" and ramp > start:
            raise ValueError(f"manoeuvre.speed_ramp: {ramp:g} s; allowed: <= turn_start {start:g} s")
        return self

    @model_validator(mode="after")
    def _tail_rests_within_its_range(self) -> "Scenario":
        rests = (("hold_angle", "roll_limit"), ("pitch_angle", "pitch_limit"))
        for key, limit_key in rests if self.tail.mode != "none" else ():
            angle, limit = abs(getattr(self.controller, key)), getattr(self.tail, limit_key)
            if angle > limit + 1e-9:
                raise ValueError(f"controller.{key}: {angle:.9g} rad; allowed: <= tail.{limit_key} {limit:.9g} rad")
        return self

    @model_validator(mode="after")
    def _frictions_can_be_combined(self) -> "Scenario":
        # Drake's 2 mu1 mu2 / (mu1 + mu2) stays below 2 mu1, and the ground carries the tyre friction.
        cage, most = self.car.cage_friction, 2 * self.car.tyre_friction
        if cage >= most:
            raise ValueError(f"car.cage_friction: {cage:g}; allowed: < twice car.tyre_friction, {most:g}")
        return self

    def resolved(self) -> dict[str, Any]:
        """The scenario as plain data (JSON-able), every value written out."""
        return self.model_dump(mode="json", by_alias=True)


RETIRED = {"tail": {"sail_centre_of_pressure"}}
"""Section -> keys that resolved scenarios of earlier versions hold (logs, swing files) and no car needs any more."""

SECTIONS = sections_of(Scenario)
"""Section name -> model; one file of `models/parameters` each."""


def load_parameter_entries(section: str) -> dict[str, ParameterEntry]:
    """Reads `models/parameters/<section>.yaml`, checks unit and source of every number and that none is missing."""
    return load_parameter_file(model_path(f"parameters/{section}.yaml"), SECTIONS[section])


def default_values() -> dict[str, dict[str, Any]]:
    """Section -> key -> value of `models/parameters`."""
    values = {}
    for name in SECTIONS:
        path = model_path(f"parameters/{name}.yaml")
        values[name] = dict(_values_of(name, str(path), _stamp(path)))
    return values


@lru_cache(maxsize=4 * len(SECTIONS))
def _values_of(section: str, path: str, stamp: tuple[int, int] | None) -> dict[str, Any]:
    """Key -> value of one file; reading it takes longer than a twentieth of a run, so it is kept until it changes."""
    return {key: entry.value for key, entry in load_parameter_entries(section).items()}


def _stamp(path: Path) -> tuple[int, int] | None:
    """Changes when the file does; None without a file."""
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_mtime_ns, state.st_size


def scenario_from_dict(overrides: dict[str, Any], where: str = "scenario") -> Scenario:
    """Resolves overrides (section -> key -> value) on top of `models/parameters`.

    Args:
        overrides: nested plain data; a resolved scenario is accepted too.
        where: file or flag named in error messages.

    Raises:
        ScenarioError: unknown key, wrong unit, value out of range, NaN; names the place, the value and what is allowed.
    """
    return resolve(Scenario, SCENARIO_SCHEMA, default_values(), _without_retired(overrides), where)


def _without_retired(overrides: dict[str, Any]) -> dict[str, Any]:
    """A resolved scenario of an earlier version without the keys that are gone; other data as they are.

    Only a whole section can be of an earlier version: in a file that names single keys a retired one is an error.
    """
    result = dict(overrides)
    for section, keys in RETIRED.items():
        given = overrides.get(section)
        if isinstance(given, dict) and len(given) > len(SECTIONS[section].model_fields) // 2:
            result[section] = {key: value for key, value in given.items() if key not in keys}
    return result


def load_scenario(name_or_path: str | Path, settings: list[str] | None = None, *, said: str = "") -> Scenario:
    """Loads a scenario by path, or by name from `models/scenarios`, with overrides such as `car.com_height=0.21`.

    Args:
        name_or_path: a YAML file, or the name of a scenario that ships.
        settings: overrides, `section.key=value`.
        said: how the user wrote these, for error messages; `--set ...` by default.

    Raises:
        UserError: no such file or name; or as `scenario_from_dict`.
    """
    path = Path(name_or_path)
    if not path.suffix and path.name == str(name_or_path) and not path.exists():
        path = model_path(f"scenarios/{name_or_path}.yaml")
    data = read_yaml(path)
    for setting in settings or []:
        apply_setting(data, setting, SECTIONS, "car.com_height=0.21")
    said = said or f"--set {' '.join(settings or [])}"
    return scenario_from_dict(data, f"{path} with {said}" if settings else str(path))


def scenario_names() -> list[str]:
    """Names of the scenarios that ship in `models/scenarios`."""
    return sorted(path.stem for path in (models_dir() / "scenarios").glob("*.yaml"))
