"""A rig scenario: everything that is needed to repeat a wind-tunnel experiment, typed, with its seed.

The rig's own sections stand in `models/parameters/rig`; the robot's tail, its motor and friction, gravity and air are
those of the car. Schema `aerodima/rig-scenario/1`.
"""

import math
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from aerodima.workbench.config.car_parameters import (
    EnvironmentParameters,
    FrictionParameters,
    TailMotorParameters,
    TailParameters,
)
from aerodima.workbench.config.parameter_files import (
    ParameterEntry,
    apply_setting,
    load_parameter_file,
    read_yaml,
    resolve,
    sections_of,
)
from aerodima.workbench.config.rig_parameters import (
    BarParameters,
    CheetahTailParameters,
    ExperimentParameters,
    ForceSensorParameters,
    MaxonParameters,
    MountParameters,
    RigAeroParameters,
    RigEncoderParameters,
    RigSimulationParameters,
    RigUncertaintyParameters,
    RobotRigParameters,
    TunnelParameters,
)
from aerodima.workbench.resources import model_path, models_dir

RIG_SCENARIO_SCHEMA = "aerodima/rig-scenario/1"
SHARED_WITH_CAR = {
    "robot_tail": "tail",
    "robot_motor": "tail_motor",
    "robot_friction": "friction",
    "environment": "environment",
}
"""Section of the rig -> file of `models/parameters` that it shares with the car."""


class RigScenario(BaseModel):
    """Resolved rig scenario, frozen. SI units and radians."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)

    schema_: Literal["aerodima/rig-scenario/1"] = Field("aerodima/rig-scenario/1", alias="schema")
    name: str = Field("rig", description="what the experiment is called in reports", min_length=1, max_length=80)
    seed: int = Field(1, description="seed of every random number of the experiment", ge=0, le=2**63 - 1)
    experiment: ExperimentParameters
    mount: MountParameters
    bar: BarParameters
    tail_1: CheetahTailParameters
    tail_2: CheetahTailParameters
    tail_3: CheetahTailParameters
    maxon: MaxonParameters
    encoder: RigEncoderParameters
    friction: FrictionParameters
    tunnel: TunnelParameters
    force_sensor: ForceSensorParameters
    uncertainty: RigUncertaintyParameters
    aero: RigAeroParameters
    robot: RobotRigParameters
    robot_tail: TailParameters
    robot_motor: TailMotorParameters
    robot_friction: FrictionParameters
    environment: EnvironmentParameters
    simulation: RigSimulationParameters

    @model_validator(mode="after")
    def _rates_fit_the_step(self) -> "RigScenario":
        step = self.simulation.step
        rates = {
            "force_sensor.rate": self.force_sensor.rate,
            "encoder.rate": self.encoder.rate,
            "robot.command_rate": self.robot.command_rate,
            "simulation.log_rate": self.simulation.log_rate,
        }
        for key, rate in rates.items():
            if rate * step > 1.0 + 1e-9:
                raise ValueError(
                    f"{key}: {rate:g} Hz is above 1/step; allowed with step {step:g} s: <= {1 / step:g} Hz"
                )
        return self

    @model_validator(mode="after")
    def _experiment_is_possible(self) -> "RigScenario":
        for key in ("angle", "target"):
            angle, limit = getattr(self.experiment, key), self.mount.angle_limit
            if abs(angle) > limit + 1e-9:
                raise ValueError(
                    f"experiment.{key}: {angle:g} rad; allowed: within mount.angle_limit, +-{limit:g} rad "
                    f"({math.degrees(limit):.0f} degrees)"
                )
        if self.experiment.kind == "bar_swing" and self.experiment.wind_speed > 0.0:
            raise ValueError(
                f"experiment.wind_speed: {self.experiment.wind_speed:g} m/s; "
                "allowed in a bar_swing: 0 m/s (bare bar in still air)"
            )
        if self.aero.added_mass != 0.0 and self.tunnel.kilter != 0.0:
            raise ValueError(
                f"aero.added_mass: {self.aero.added_mass:g} kg; "
                f"allowed with tunnel.kilter {self.tunnel.kilter:g} rad: 0 kg"
            )
        if self.experiment.kind != "static" and self.experiment.rest >= self.experiment.duration:
            raise ValueError(
                f"experiment.rest: {self.experiment.rest:g} s; allowed: < duration {self.experiment.duration:g} s"
            )
        if self.experiment.kind == "static" and self.experiment.wind_off >= self.experiment.duration:
            raise ValueError(
                f"experiment.wind_off: {self.experiment.wind_off:g} s; "
                f"allowed: < duration {self.experiment.duration:g} s"
            )
        if self.experiment.kind != "static" and self.experiment.wind_off > 0.0:
            raise ValueError(
                f"experiment.wind_off: {self.experiment.wind_off:g} s; "
                f"allowed in a {self.experiment.kind}: 0 s (a swing rests in the wind: experiment.rest)"
            )
        return self

    @property
    def has_cheetah_tail(self) -> bool:
        """Whether a cheetah tail is mounted: not on the bare bar, not on the robot's rig."""
        return self.experiment.kind in ("static", "swing")

    @property
    def is_robot(self) -> bool:
        """Whether the robot's tail and motor are on the rig."""
        return self.experiment.kind == "robot_swing"

    @property
    def cheetah_tail(self) -> CheetahTailParameters:
        """The tail of the experiment."""
        return (self.tail_1, self.tail_2, self.tail_3)[self.experiment.tail - 1]

    @property
    def tail_name(self) -> str:
        """What stands in a log's metadata: `1`, `2`, `3`, `none` or `robot`."""
        if self.is_robot:
            return "robot"
        return str(self.experiment.tail) if self.has_cheetah_tail else "none"

    def varied(self, **sections: Any) -> "RigScenario":
        """Another scenario that differs in some keys, without reading a file: `varied(experiment={"angle": 0.5})`.

        Raises:
            ScenarioError: unknown key, wrong unit or a value out of range.
        """
        return resolve(
            RigScenario,
            RIG_SCENARIO_SCHEMA,
            self._values(),
            {"name": self.name, "seed": self.seed, **sections},
            f"rig scenario {self.name!r}",
        )

    def _values(self) -> dict[str, Any]:
        return {name: getattr(self, name).model_dump() for name in RIG_SECTIONS}

    def resolved(self) -> dict[str, Any]:
        """The scenario as plain data (JSON-able), every value written out."""
        return self.model_dump(mode="json", by_alias=True)


RIG_SECTIONS = sections_of(RigScenario)
"""Section name -> model."""


def rig_parameter_path(section: str) -> Path:
    """File of `models/parameters` that holds a section."""
    shared = SHARED_WITH_CAR.get(section)
    return model_path(f"parameters/{shared}.yaml" if shared else f"parameters/rig/{section}.yaml")


def load_rig_parameter_entries(section: str) -> dict[str, ParameterEntry]:
    """Reads the file of a section, checks unit and source of every number and that none is missing."""
    return load_parameter_file(rig_parameter_path(section), RIG_SECTIONS[section])


def default_rig_values() -> dict[str, dict[str, Any]]:
    """Section -> key -> value of the parameters."""
    return {
        name: {key: entry.value for key, entry in load_rig_parameter_entries(name).items()} for name in RIG_SECTIONS
    }


def rig_scenario_from_dict(overrides: dict[str, Any], where: str = "rig scenario") -> RigScenario:
    """Resolves overrides (section -> key -> value) on top of the parameters.

    Raises:
        ScenarioError: unknown key, wrong unit, value out of range, NaN; names the place, the value and what is allowed.
    """
    return resolve(RigScenario, RIG_SCENARIO_SCHEMA, default_rig_values(), overrides, where)


def load_rig_scenario(name_or_path: str | Path, settings: list[str] | None = None) -> RigScenario:
    """Loads a rig scenario by path, or by name from `models/scenarios/rig`, with overrides like `experiment.tail=2`."""
    path = Path(name_or_path)
    if not path.suffix:
        path = model_path(f"scenarios/rig/{name_or_path}.yaml")
    data = read_yaml(path)
    for setting in settings or []:
        apply_setting(data, setting, RIG_SECTIONS, "experiment.wind_speed=20")
    return rig_scenario_from_dict(data, f"{path} with --set {' '.join(settings)}" if settings else str(path))


def rig_scenario_names() -> list[str]:
    """Names of the rig scenarios that ship in `models/scenarios/rig`."""
    return sorted(path.stem for path in (models_dir() / "scenarios" / "rig").glob("*.yaml"))
