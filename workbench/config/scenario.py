"""Scenarios of car and rig: everything that is needed to repeat a run or an experiment, typed, with its seed.

A scenario file holds only what differs from `models/parameters` (the rig's own sections: `models/parameters/rig`);
`load_scenario` and `load_rig_scenario` resolve it. The robot's tail, its motor and friction, gravity and air are the
same on car and rig.
"""

import math
from collections.abc import Sequence
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
    retired: ClassVar = {"tail": {"sail_centre_of_pressure"}, "controller": {"tracking"}}

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
    def _car_is_possible(self) -> "Scenario":
        tail, turn, steering, cage = self.tail, self.manoeuvre, self.servo.limit, 2 * self.car.tyre_friction
        roll, pitch, tailless = tail.roll_limit + 1e-9, tail.pitch_limit + 1e-9, tail.mode == "none"
        hold, held_pitch = self.controller.hold_angle, abs(self.controller.pitch_angle)
        ramped = turn.kind != "turn" or turn.speed_ramp <= turn.turn_start
        rules = (
            (tail.sail_length <= tail.length, "tail.sail_length", f"<= tail.length {tail.length:g} m"),
            (turn.steer_angle <= steering + 1e-9, "manoeuvre.steer_angle", f"<= servo.limit {steering:.9g} rad"),
            (turn.first_angle <= steering + 1e-9, "manoeuvre.first_angle", f"<= servo.limit {steering:.9g} rad"),
            (turn.first_hold <= turn.turn_hold, "manoeuvre.first_hold", f"<= turn_hold {turn.turn_hold:g} s"),
            (ramped, "manoeuvre.speed_ramp", f"<= turn_start {turn.turn_start:g} s"),
            (tailless or hold <= roll, "controller.hold_angle", f"<= tail.roll_limit {roll:.9g} rad"),
            (tailless or held_pitch <= pitch, "controller.pitch_angle", f"within tail.pitch_limit, +-{pitch:.9g} rad"),
            # Drake's 2 mu1 mu2 / (mu1 + mu2) stays below 2 mu1, and the ground carries the tyre friction.
            (self.car.cage_friction < cage, "car.cage_friction", f"< twice car.tyre_friction, {cage:g}"),
        )
        self._require(rules)
        return self


SECTIONS = Scenario.sections()
load_parameter_entries = Scenario.parameters
default_values = Scenario.defaults
scenario_from_dict = Scenario.from_dict


def load_scenario(name_or_path: str | Path, settings: Sequence[str] = ()) -> Scenario:
    """Loads a scenario of the car; arguments and errors are those of `ScenarioFile.load`."""
    return Scenario.load(name_or_path, settings)


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

    renamed: ClassVar = {"tunnel": {"kilter": "misalignment"}}
    retired: ClassVar = {"robot_tail": Scenario.retired["tail"]}

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
        done, limit, misalignment = self.experiment, self.mount.angle_limit, self.tunnel.misalignment
        is_static, is_bar = done.kind == "static", done.kind == "bar_swing"
        within = f"within mount.angle_limit, +-{limit:g} rad ({math.degrees(limit):.0f} degrees)"
        shorter = f"< duration {done.duration:g} s"
        still = f"0 s in a {done.kind} (a swing rests in the wind: experiment.rest)"
        rules = (
            (abs(done.angle) <= limit + 1e-9, "experiment.angle", within),
            (abs(done.target) <= limit + 1e-9, "experiment.target", within),
            (not is_bar or done.wind_speed == 0.0, "experiment.wind_speed", "0 m/s in a bar_swing"),
            (
                self.aero.added_mass == 0.0 or misalignment == 0.0,
                "aero.added_mass",
                f"0 kg with tunnel.misalignment {misalignment:g} rad",
            ),
            (is_static or done.rest < done.duration, "experiment.rest", shorter),
            (not is_static or done.wind_off < done.duration, "experiment.wind_off", shorter),
            (is_static or done.wind_off == 0.0, "experiment.wind_off", still),
        )
        self._require(rules)
        if self.robot_tail.has_own_geometry:
            raise ValueError(f"robot_tail.geometry: {self.robot_tail.geometry!r}; allowed: none, on a rig")
        if self.robot_tail.sail_shape != "built":
            raise ValueError(f"robot_tail.sail_shape: {self.robot_tail.sail_shape!r}; allowed: built, on a rig")
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


def load_rig_scenario(name_or_path: str | Path, settings: Sequence[str] = ()) -> RigScenario:
    """Loads a scenario of a rig; arguments and errors are those of `ScenarioFile.load`."""
    return RigScenario.load(name_or_path, settings)
