"""Scenarios of car and rig: everything that is needed to repeat a run or an experiment, typed, with its seed.

A scenario file holds only what differs from `models/parameters` (the rig's own sections: `models/parameters/rig`);
`load_scenario` and `load_rig_scenario` resolve it. The robot's tail, its motor and friction, gravity and air are the
same on car and rig.
"""

import math
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field, model_validator

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
from aerodima.workbench.config.scenario_file import ScenarioFile


class Scenario(ScenarioFile):
    """Resolved scenario, frozen. Lengths in m, angles in rad, times in s, speeds in m/s."""

    folder = "scenarios"
    example = "car.com_height=0.21"
    rates = ("imu.rate", "gps.rate", "sail_encoder.rate", "controller.rate", "servo.frame_rate", "simulation.log_rate")
    retired: ClassVar = {"tail": {"sail_centre_of_pressure"}}

    schema_: Literal["aerodima/scenario/1"] = Field("aerodima/scenario/1", alias="schema")
    name: str = Field("turn", description="what the run is called in reports", min_length=1, max_length=80)
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


SECTIONS = Scenario.sections()
load_parameter_entries = Scenario.parameters
default_values = Scenario.defaults
scenario_from_dict = Scenario.from_dict
scenario_names = Scenario.names


def load_scenario(name_or_path: str | Path, settings: list[str] | None = None, *, said: str = "") -> Scenario:
    """Loads a scenario of the car; arguments and errors are those of `ScenarioFile.load`."""
    return Scenario.load(name_or_path, settings, said=said)


class RigScenario(ScenarioFile):
    """Resolved rig scenario, frozen. SI units and radians."""

    folder = "scenarios/rig"
    example = "experiment.wind_speed=20"
    rates = ("force_sensor.rate", "encoder.rate", "robot.command_rate", "simulation.log_rate")
    parameter_folder = "parameters/rig"
    shared_with_car: ClassVar = {
        "robot_tail": "tail",
        "robot_motor": "tail_motor",
        "robot_friction": "friction",
        "environment": "environment",
    }

    schema_: Literal["aerodima/rig-scenario/1"] = Field("aerodima/rig-scenario/1", alias="schema")
    name: str = Field("rig", description="what the experiment is called in reports", min_length=1, max_length=80)
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


RIG_SECTIONS = RigScenario.sections()
rig_scenario_from_dict = RigScenario.from_dict


def load_rig_scenario(name_or_path: str | Path, settings: list[str] | None = None, *, said: str = "") -> RigScenario:
    """Loads a scenario of a rig; arguments and errors are those of `ScenarioFile.load`."""
    return RigScenario.load(name_or_path, settings, said=said)
