"""Parameter files and scenario files, of the car and of the rig: read, checked and overridden.

A parameter file holds the numbers of one section, each with unit and source (design section 3); a
scenario file what differs from them.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, model_validator

from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.quantity import NO_UNIT, unit_of
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import (
    ModelT,
    StrictModel,
    checked,
    find_file,
    read_yaml,
    shipped_names,
)
from aerodima.workbench.scenario.car_parameters import (
    CarParameters,
    DriveParameters,
    ServoParameters,
)
from aerodima.workbench.scenario.law_parameters import ControllerParameters, FeedbackParameters
from aerodima.workbench.scenario.manoeuvre_parameters import (
    EnvironmentParameters,
    ManoeuvreParameters,
    SimulationParameters,
    WindParameters,
)
from aerodima.workbench.scenario.sensor_parameters import (
    GpsParameters,
    ImuParameters,
    SailEncoderParameters,
)
from aerodima.workbench.scenario.tail_parameters import (
    FrictionParameters,
    TailMotorParameters,
    TailParameters,
)

PARAMETER_SCHEMA = "aerodima/parameters/1"


class Sourced(StrictModel):
    """A number or range of a file with its unit, its source, and the reason of what was assumed or
    chosen.
    """

    unit: str
    source: str = Field(pattern=r"^(published: .+|datasheet: .+|assumed|calibrated: .+|chosen)$")
    reason: str | None = None

    @model_validator(mode="after")
    def _reason_is_given(self) -> Self:
        if self.source in ("assumed", "chosen") and not self.reason:
            raise ValueError(f"source {self.source!r} needs a reason")
        return self


class ParameterEntry(Sourced):
    """One number of `models/parameters`; an assumed one has a prior range."""

    value: float | int | bool | str
    prior: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _lies_in_its_prior(self) -> Self:
        if self.source == "assumed" and self.prior is None:
            raise ValueError("source 'assumed' needs a prior range [low, high]")
        if self.prior is not None and not (
            isinstance(self.value, float | int) and self.prior[0] <= self.value <= self.prior[1]
        ):
            raise ValueError(f"value {self.value!r} lies outside its prior {list(self.prior)}")
        return self


def load_parameter_file(
    path: Path, model: type[BaseModel] | None = None
) -> dict[str, ParameterEntry]:
    """Reads a parameter file: value, unit and source of every number.

    Args:
        path: the file.
        model: of its numbers, which must then all be there, in its units; None for a file that has
            none.

    Raises:
        ScenarioError: names file, key and what is allowed.
    """
    data = read_yaml(path)
    if data.pop("schema", None) != PARAMETER_SCHEMA:
        raise ScenarioError(f"{path}: schema: allowed is {PARAMETER_SCHEMA!r}")
    entries = {key: checked(ParameterEntry, raw, f"{path}: {key}") for key, raw in data.items()}
    known = model.model_fields if model else entries
    for key, entry in entries.items():
        if key not in known:
            raise ScenarioError(f"{path}: {key}: unknown key; {nearest(str(key), known)}")
        if model and entry.unit != unit_of(model, key):
            raise ScenarioError(
                f"{path}: {key}: unit {entry.unit!r}; allowed is {unit_of(model, key)!r}"
            )
    missing = set(known) - set(entries)
    if missing:
        raise ScenarioError(f"{path}: missing: {', '.join(sorted(missing))}")
    return entries


def load_section(
    path: Path, model: type[ModelT], changes: Mapping[str, Any] | None = None
) -> ModelT:
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


class ScenarioFile(StrictModel):
    """What the scenarios of car and rig share: reading, overriding, writing. SI units and radians.

    A subclass has one field per section, whose numbers stand in a parameter file of their own.
    """

    model_config = ConfigDict(strict=True)

    folder: ClassVar[str]
    """Folder of `models/` where the scenarios ship."""
    example: ClassVar[str]
    """A setting, for the message about a malformed one."""
    rates: ClassVar[tuple[str, ...]]
    """Keys of rates, Hz, that must not be above 1/step."""
    parameter_folder: ClassVar[str] = "parameters"
    """Folder of `models/` with one file per section."""
    shared_with_car: ClassVar[Mapping[str, str]] = {}
    """Section of another scenario -> section of the car, whose file it has."""
    retired: ClassVar[Mapping[str, set[str]]] = {}
    """Section -> keys that resolved scenarios of earlier versions hold (logs, swing files) and none
    needs any more."""
    renamed: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    """Section -> key of an earlier version -> its name now."""

    schema_: str = Field(alias="schema")
    name: str = Field(description="what the run is called in reports", min_length=1, max_length=80)
    seed: int = Field(1, description="seed of every random number of the run", ge=0, le=2**63 - 1)

    @model_validator(mode="after")
    def _rates_fit_the_step(self) -> Self:
        step: float = self.simulation.step  # type: ignore[attr-defined]
        for key in self.rates:
            rate = attrgetter(key)(self)
            if rate * step > 1.0 + 1e-9:
                raise ValueError(
                    f"{key}: {rate:g} Hz is above 1/step; allowed with step {step:g} s: <= "
                    f"{1 / step:g} Hz"
                )
        return self

    def _require(self, holds: bool, key: str, allowed: str) -> None:
        """Raises ValueError when the rule of a `section.key` does not hold."""
        if holds:
            return
        section, _, name = key.partition(".")
        values = getattr(self, section)
        unit = unit_of(type(values), name)
        shown = f"{getattr(values, name):.9g}"
        if unit != NO_UNIT:
            shown += f" {unit}"
        raise ValueError(f"{key}: {shown}; allowed: {allowed}")

    @classmethod
    def sections(cls) -> dict[str, type[BaseModel]]:
        """Section name -> model; one parameter file each."""
        return {
            name: field.annotation
            for name, field in cls.model_fields.items()
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
        }

    @classmethod
    def parameter_path(cls, section: str) -> Path:
        """File of `models/parameters` that holds a section."""
        shared = cls.shared_with_car.get(section)
        return model_path(
            f"parameters/{shared}.yaml" if shared else f"{cls.parameter_folder}/{section}.yaml"
        )

    @classmethod
    def parameters(cls, section: str) -> dict[str, ParameterEntry]:
        """Reads the file of a section, checks unit and source of every number and that none is
        missing.
        """
        return load_parameter_file(cls.parameter_path(section), cls.sections()[section])

    @classmethod
    def defaults(cls) -> dict[str, dict[str, Any]]:
        """Section -> key -> value of `models/parameters`."""
        paths = {section: cls.parameter_path(section) for section in cls.sections()}
        return {
            section: dict(_values_of(cls, section, path, path.stat().st_mtime_ns))
            for section, path in paths.items()
        }

    @classmethod
    def from_dict(cls, overrides: dict[str, Any], where: str = "scenario") -> Self:
        """Resolves overrides (section -> key -> value) on top of `models/parameters`.

        Args:
            overrides: nested plain data; a resolved scenario is accepted too.
            where: file or flag named in error messages.

        Raises:
            ScenarioError: unknown key, wrong unit, value out of range, NaN; names the place, the
                value and what is allowed.
        """
        return cls._resolve(cls.defaults(), cls._as_named_now(overrides), where)

    @classmethod
    def load(cls, name_or_path: str | Path, settings: Sequence[str] = ()) -> Self:
        """Loads a scenario by path, or by name from `models/scenarios`, with overrides such as
        `car.com_height=0.21`.

        Args:
            name_or_path: a YAML file, or the name of a scenario that ships.
            settings: overrides, `section.key=value`.

        Raises:
            ScenarioError: no such file or name; or as `from_dict`.
        """
        path = find_file(name_or_path, cls.folder, "scenario")
        data = read_yaml(path)
        for setting in settings:
            cls.apply_setting(data, setting)
        return cls.from_dict(
            data, f"{path} with --set {' '.join(settings)}" if settings else str(path)
        )

    @classmethod
    def names(cls) -> list[str]:
        """Names of the scenarios that ship."""
        return shipped_names(cls.folder)

    def varied(self, **changes: Any) -> Self:
        """Another scenario that differs in some keys, without reading a file.

        Example: `varied(car={"mass": 5.5}, seed=2)`.

        Raises:
            ScenarioError: unknown key, wrong unit or a value out of range.
        """
        own = {name: getattr(self, name).model_dump() for name in self.sections()}
        return self._resolve(
            own, {"name": self.name, "seed": self.seed, **changes}, f"scenario {self.name!r}"
        )

    def resolved(self) -> dict[str, Any]:
        """The scenario as plain data (JSON-able), every value written out."""
        return self.model_dump(mode="json", by_alias=True)

    @classmethod
    def apply_setting(cls, data: dict[str, Any], setting: str) -> None:
        """Puts one override such as `car.com_height=0.21` into the content of a scenario file.

        Args:
            data: content of a scenario file; changed in place.
            setting: `section.key=value`, or `key=value` for a key of the scenario itself.
        """
        path, separator, text = setting.partition("=")
        parts = path.strip().split(".")
        if not separator or not all(parts) or len(parts) > 2:
            raise ScenarioError(
                f"--set {setting}: allowed is section.key=value, such as {cls.example}"
            )
        try:
            value = yaml.load(text, Loader=yaml.CSafeLoader)
        except yaml.YAMLError:
            raise ScenarioError(f"--set {setting}: {text!r} is not a value") from None
        if len(parts) == 1:
            data[parts[0]] = value
            return
        section = data.setdefault(parts[0], {})
        if not isinstance(section, dict) or parts[0] not in cls.sections():
            raise ScenarioError(
                f"--set {setting}: {parts[0]!r} is no section; {nearest(parts[0], cls.sections())}"
            )
        section[parts[1]] = value

    @classmethod
    def _resolve(
        cls, below: Mapping[str, Mapping[str, Any]], overrides: dict[str, Any], where: str
    ) -> Self:
        merged: dict[str, Any] = {name: dict(values) for name, values in below.items()}
        for key, value in overrides.items():
            if key in below:
                if not isinstance(value, dict):
                    raise ScenarioError(
                        f"{where}: {key}: {value!r} is not allowed; it takes keys with values"
                    )
                merged[key] |= value
            else:
                merged[key] = value
        schema = cls.model_fields["schema_"].default
        return checked(cls, {"schema": schema} | merged, where, schema=schema)

    @classmethod
    def _as_named_now(cls, overrides: dict[str, Any]) -> dict[str, Any]:
        """The overrides with the keys of this version; other data as they are.

        Only a whole section can hold a retired key: in a file that names single keys it is an
        error.
        """
        result = dict(overrides)
        for section, model in cls.sections().items():
            given = overrides.get(section)
            names = cls.renamed.get(section, {})
            if isinstance(given, dict):
                if len(given) > len(model.model_fields) // 2:
                    gone = cls.retired.get(section, set())
                else:
                    gone = set()
                result[section] = {
                    names.get(key, key): value for key, value in given.items() if key not in gone
                }
        return result


@lru_cache(maxsize=128)
def _values_of(
    scenario: type[ScenarioFile], section: str, path: Path, _changed: int
) -> dict[str, Any]:
    """Key -> value of one file; reading it takes longer than a twentieth of a run, so it is kept
    until it changes.
    """
    return {
        key: entry.value
        for key, entry in load_parameter_file(path, scenario.sections()[section]).items()
    }


class Scenario(ScenarioFile):
    """Resolved scenario, frozen. Lengths in m, angles in rad, times in s, speeds in m/s."""

    folder = "scenarios"
    example = "car.com_height=0.21"
    rates = (
        "imu.rate",
        "gps.rate",
        "sail_encoder.rate",
        "controller.rate",
        "servo.frame_rate",
        "simulation.log_rate",
    )
    retired: ClassVar = {"tail": {"sail_centre_of_pressure"}, "controller": {"tracking"}}

    schema_: Literal["aerodima/scenario/1"] = Field("aerodima/scenario/1", alias="schema")
    name: str = Field(
        "turn", description="what the run is called in reports", min_length=1, max_length=80
    )
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
    feedback: FeedbackParameters
    manoeuvre: ManoeuvreParameters
    simulation: SimulationParameters

    @property
    def follows_state(self) -> bool:
        """Whether the tail moves by the feedback law."""
        return self.controller.law == "feedback" and self.tail.mode == "swing"

    @property
    def resting_pitch(self) -> float:
        """Tail pitch (rad) at which the law waits."""
        return self.feedback.pitch_angle if self.follows_state else self.controller.pitch_angle

    @property
    def resting_roll(self) -> float:
        """Tail roll (rad) before the turn: inside, left (negative) for a left turn; the middle for
        `feedback`.
        """
        inside = -1.0 if self.manoeuvre.direction == "left" else 1.0
        if self.follows_state:
            return 0.0
        return inside * self.controller.hold_angle

    @model_validator(mode="after")
    def _car_is_possible(self) -> "Scenario":
        tail = self.tail
        turn = self.manoeuvre
        steering = self.servo.limit
        cage = 2 * self.car.tyre_friction
        roll = tail.roll_limit + 1e-9
        pitch = tail.pitch_limit + 1e-9
        tailless = tail.mode == "none"
        hold = self.controller.hold_angle
        held_pitch = abs(self.controller.pitch_angle)
        ramped = (
            turn.rolling_start
            or turn.kind not in ("turn", "fishhook", "path")
            or turn.speed_ramp <= turn.turn_start
        )
        corner = turn.kind == "path" and turn.path == "corner"
        inside = 0.5 * turn.corner_width
        require = self._require
        require(
            tail.sail_length <= tail.length,
            "tail.sail_length",
            f"<= tail.length {tail.length:g} m",
        )
        within_servo = f"<= servo.limit {steering:.9g} rad"
        require(turn.steer_angle <= steering + 1e-9, "manoeuvre.steer_angle", within_servo)
        require(turn.first_angle <= steering + 1e-9, "manoeuvre.first_angle", within_servo)
        require(
            turn.first_hold <= turn.turn_hold,
            "manoeuvre.first_hold",
            f"<= turn_hold {turn.turn_hold:g} s",
        )
        require(
            not corner or turn.corner_radius > inside,
            "manoeuvre.corner_radius",
            f"> half of corner_width, {inside:g} m",
        )
        require(ramped, "manoeuvre.speed_ramp", f"<= turn_start {turn.turn_start:g} s")
        within_roll = f"<= tail.roll_limit {roll:.9g} rad"
        require(tailless or hold <= roll, "controller.hold_angle", within_roll)
        require(tailless or self.feedback.most_roll <= roll, "feedback.most_roll", within_roll)
        require(
            tail.roll_limit <= tail.roll_stop,
            "tail.roll_limit",
            f"<= tail.roll_stop {tail.roll_stop:.9g} rad",
        )
        require(
            tailless or held_pitch <= pitch,
            "controller.pitch_angle",
            f"within tail.pitch_limit, +-{pitch:.9g} rad",
        )
        # Drake's 2 mu1 mu2 / (mu1 + mu2) stays below 2 mu1, and the ground carries the tyre
        # friction.
        require(
            self.car.cage_friction < cage,
            "car.cage_friction",
            f"< twice car.tyre_friction, {cage:g}",
        )
        return self


SECTIONS = Scenario.sections()
load_parameter_entries = Scenario.parameters
default_values = Scenario.defaults
scenario_from_dict = Scenario.from_dict


def load_scenario(name_or_path: str | Path, settings: Sequence[str] = ()) -> Scenario:
    """Loads a scenario of the car; arguments and errors are those of `ScenarioFile.load`."""
    return Scenario.load(name_or_path, settings)
