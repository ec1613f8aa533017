"""Scenario of the car: everything that is needed to repeat a run, typed, with its seed.

A scenario file holds only what differs from `models/parameters`; `load_scenario` resolves it.
"""

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
