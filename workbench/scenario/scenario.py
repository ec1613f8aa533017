"""The scenario of a car: its sections, and the rules between them.

Numbers that a scenario file leaves out are those of `models/parameters` (design section 3).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from aerodima.workbench.scenario.car_parameters import (
    CarParameters,
    DriveParameters,
    ServoParameters,
)
from aerodima.workbench.scenario.law_parameters import (
    ControllerParameters,
    FeedbackParameters,
    RolloverControlParameters,
)
from aerodima.workbench.scenario.manoeuvre_parameters import (
    EnvironmentParameters,
    ManoeuvreParameters,
    SimulationParameters,
    WindParameters,
)
from aerodima.workbench.scenario.scenario_file import ScenarioFile
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


class Scenario(ScenarioFile):
    """Resolved scenario, frozen. Lengths in m, angles in rad, times in s, speeds in m/s."""

    folder = "scenarios"
    default_name = "turn"
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
    rollover_control: RolloverControlParameters
    manoeuvre: ManoeuvreParameters
    simulation: SimulationParameters

    @property
    def has_tail(self) -> bool:
        """Tell whether the car has a tail."""
        return self.tail.mode != "none"

    @property
    def follows_state(self) -> bool:
        """Tell whether the tail moves by the feedback law."""
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
        if self.follows_state:
            return 0.0
        inside = -1.0 if self.manoeuvre.direction == "left" else 1.0
        return inside * self.controller.hold_angle

    @model_validator(mode="after")
    def _car_is_possible(self) -> Self:
        self._require_at_most("tail.sail_length", "tail.length")
        self._require_at_most("tail.roll_limit", "tail.roll_stop")
        if self.has_tail:
            self._require_at_most("controller.hold_angle", "tail.roll_limit")
            self._require_at_most("feedback.most_roll", "tail.roll_limit")
            self._require_at_most("controller.pitch_angle", "tail.pitch_limit")
        if self.manoeuvre.kind == "auto_turn":
            one_level = self.manoeuvre.first_hold == 0.0
            self._require(one_level, "manoeuvre.first_hold", "0 in an auto_turn")
        if self.follows_state:
            self._require_at_most("feedback.pitch_angle", "tail.pitch_limit")
        # Drake's 2 mu1 mu2 / (mu1 + mu2) stays below 2 mu1, and the ground carries the tyre
        # friction.
        cage = 2 * self.car.tyre_friction
        self._require(
            self.car.cage_friction < cage,
            "car.cage_friction",
            f"< twice car.tyre_friction, {cage:g}",
        )
        return self

    @model_validator(mode="after")
    def _turn_is_possible(self) -> Self:
        turn = self.manoeuvre
        self._require_at_most("manoeuvre.first_hold", "manoeuvre.turn_hold")
        for angle in ("steer_angle", "first_angle", "level_1", "level_2", "level_3", "trim_angle"):
            self._require_at_most(f"manoeuvre.{angle}", "servo.limit")
        if turn.kind in ("turn", "fishhook", "path") and not turn.rolling_start:
            self._require_at_most("manoeuvre.speed_ramp", "manoeuvre.turn_start")
        if turn.kind == "path" and turn.path == "corner":
            inside = 0.5 * turn.corner_width
            self._require(
                turn.corner_radius > inside,
                "manoeuvre.corner_radius",
                f"> half of corner_width, {inside:g} m",
            )
        return self


default_values = Scenario.defaults
scenario_from_dict = Scenario.from_dict


def load_scenario(name_or_path: str | Path, settings: Sequence[str] = ()) -> Scenario:
    """Load a scenario of the car; arguments and errors are those of `ScenarioFile.load`."""
    return Scenario.load(name_or_path, settings)
