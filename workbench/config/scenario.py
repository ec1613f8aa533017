"""A scenario: everything that is needed to repeat a run, typed, with its seed.

A scenario file holds only what differs from `models/parameters`; `load_scenario` resolves it.
"""

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
