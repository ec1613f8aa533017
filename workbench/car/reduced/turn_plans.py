"""Plans of the turns of many reduced cars: what each driver steers, and the law of each tail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from aerodima.workbench.control.law_of_scenario import NO_SWING
from aerodima.workbench.control.manoeuvre import TICK_TOLERANCE
from aerodima.workbench.control.swing_law import SwingSettings
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.swing_file import cubic

COMMON = {
    "start": "manoeuvre.turn_start, s",
    "rate": "controller.rate, Hz",
    "late": "imu.delay, ticks",
}
"""Of `TurnPlans`: the same for all turns that are driven at once, with the words of a complaint."""


@dataclass(frozen=True)
class PlayedRoll:
    """Knots of n tails in a turn to the left; the last axis of every field is the car.

    Attributes:
        plays: 1 where a tail follows its knots, 0 where the law is another one.
        time: since the release (knots, n), s, strictly increasing, the first 0; before and after
            them the tail rests.
        roll, rate: of the tail at the knots (knots, n), rad and rad/s.
        kp, kd: of the roll motor; `pitch_kp`, `pitch_kd` of the pitch motor; N m/rad, N m s/rad.
    """

    plays: FloatArray
    time: FloatArray
    roll: FloatArray
    rate: FloatArray
    kp: FloatArray
    kd: FloatArray
    pitch_kp: FloatArray
    pitch_kd: FloatArray

    @classmethod
    def none(cls, number: int) -> PlayedRoll:
        """Of so many tails that follow another law."""
        time = np.array([[0.0], [1.0]]) * np.ones(number)
        still = np.zeros((2, number))
        no_gain = np.zeros(number)
        return cls(no_gain, time, still, still, *[no_gain] * 4)

    def take(self, places: Any) -> PlayedRoll:
        """Tails at these places, again and again if asked."""
        return PlayedRoll(*(getattr(self, field.name)[..., places] for field in fields(self)))

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Roll (n), rad, and its rate at times (n) since the releases, s."""
        ends = [
            values[side]
            for values in (self.time, self.roll, self.rate)
            for side in (slice(-1), slice(1, None))
        ]
        pieces = np.stack(ends, axis=1)  # (knots - 1, 6, n)
        piece = pieces[0]
        for number in range(1, len(pieces)):
            piece = np.where(self.time[number] <= time, pieces[number], piece)
        begin, end, roll, next_roll, rate, next_rate = piece
        share = np.clip((time - begin) / (end - begin), 0.0, 1.0)
        value, slope = cubic(share, end - begin, (roll, next_roll), (rate, next_rate))
        rests = (time < 0.0) | (time > self.time[-1])
        return value, np.where(rests, 0.0, slope)


@dataclass(frozen=True)
class TurnPlans:
    """What n cars do in their turn; the last axis of every field is the car.

    Attributes:
        ramp, start: the car gathers speed for so long and goes straight until then, s.
        lead: s by which a drive without governor is asked for its speed ahead of the ramp
            (`SpeedRamp`).
        steer_angle: rad; `hold` s, length of the steering step; `steer_rate` of the servo, rad/s.
        first_angle, first_hold: another angle at the beginning of the step, rad, and how much of
            it, s.
        rate: of the controller, Hz; `late` how many of its ticks a yaw rate is old.
        trigger_steering: steering command that releases the swing, rad; infinite where a yaw rate
            does.
        swings: 1 where the tail swings; all others as `SwingSettings`, rad, s, rad/s, N m/rad, N m
            s/rad.
        played: the tails that follow knots.
    """

    ramp: FloatArray
    start: FloatArray
    lead: FloatArray
    steer_angle: FloatArray
    hold: FloatArray
    first_angle: FloatArray
    first_hold: FloatArray
    steer_rate: FloatArray
    rate: FloatArray
    late: FloatArray
    trigger_steering: FloatArray
    swings: FloatArray
    trigger_yaw_rate: FloatArray
    delay: FloatArray
    hold_angle: FloatArray
    hold_kp: FloatArray
    hold_kd: FloatArray
    pitch_angle: FloatArray
    swing_speed: FloatArray
    swing_kp: FloatArray
    swing_kd: FloatArray
    travel: FloatArray
    stall_factor: FloatArray
    settle_kp: FloatArray
    settle_kd: FloatArray
    played: PlayedRoll

    @classmethod
    def of(cls, scenarios: Sequence[Scenario]) -> TurnPlans:
        """The plans of scenarios whose tail follows the thesis' law, or is held.

        Raises:
            UserError: a swing file or a trigger that the model does not know, or scenarios that
                differ in `COMMON`.
        """
        rows = [_row(scenario) for scenario in scenarios]
        names = [field.name for field in fields(cls) if field.name != "played"]
        numbers = np.array([[row[name] for name in names] for row in rows], float).T
        plans = cls(**dict(zip(names, numbers, strict=True)), played=PlayedRoll.none(len(rows)))
        for name, words in COMMON.items():
            values = np.unique(getattr(plans, name))
            if len(values) > 1:
                raise UserError(
                    f"{words}: {values[0]:g} and {values[-1]:g}; turns that are driven at once "
                    "have one"
                )
        return plans

    def take(self, places: Any) -> TurnPlans:
        """Plans at these places, again and again if asked."""
        numbers = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name != "played"
        }
        taken = {name: values[..., places] for name, values in numbers.items()}
        return TurnPlans(**taken, played=self.played.take(places))

    def commanded(self, time: Any) -> FloatArray:
        """Steering command (n) of the drivers at a time since the start of the turn, or at times
        (n), rad.
        """
        now = time + TICK_TOLERANCE
        level = np.where(now < self.first_hold, self.first_angle, self.steer_angle)
        steers = (now >= 0.0) & (now < self.hold)
        return np.where(steers, level, 0.0)

    def steering(self, time: Any) -> FloatArray:
        """Angle (n) to which the servos have turned the wheels at a time since the start of the
        turn, rad.

        Args:
            time: s; several in (times, 1) give angles (times, n).
        """
        rate = self.steer_rate
        begun = np.maximum(rate * np.minimum(time, self.first_hold), 0.0)
        first = np.minimum(begun, self.first_angle)
        moved = rate * np.maximum(0.0, np.minimum(time, self.hold) - self.first_hold)
        angle = first + np.clip(self.steer_angle - first, -moved, moved)
        return np.maximum(angle - rate * np.maximum(0.0, time - self.hold), 0.0)

    @property
    def straight(self) -> FloatArray:
        """When the wheels are straight again (n), s since the start of the turn; see
        `angle_to_straighten`.
        """
        first = self.first_angle - self.steer_rate * (self.hold - self.first_hold)
        larger = np.maximum(self.steer_angle, first)
        last = np.where(self.first_hold > 0.0, larger, self.steer_angle)
        return self.hold + last / self.steer_rate


def _row(scenario: Scenario) -> dict[str, float]:
    """Fields of `TurnPlans` for one turn."""
    settings = SwingSettings.from_scenario(scenario)
    turn = scenario.manoeuvre
    imu = scenario.imu
    swings = settings.mode == "swing"
    row: dict[str, Any] = {name: getattr(settings, name) for name in SwingSettings.model_fields}
    row |= {
        "ramp": turn.speed_ramp,
        "start": turn.turn_start,
        "lead": 0.0 if scenario.drive.governor else scenario.drive.time_constant,
        "steer_angle": turn.steer_angle,
        "hold": turn.turn_hold,
        "first_angle": turn.first_angle,
        "first_hold": turn.first_hold,
        "steer_rate": scenario.servo.rate,
        "late": np.ceil(imu.delay * settings.rate - 1e-9),
        "trigger_steering": np.inf,
        "swings": float(swings),
    }
    name = scenario.controller.swing_file
    if swings and name != NO_SWING:
        raise UserError(f"controller.swing_file: {name}; the screening model knows: {NO_SWING}")
    if swings and settings.trigger == "lateral_acceleration":
        raise UserError(
            f"controller.trigger: {settings.trigger}; the screening model knows: steering, yaw_rate"
        )
    if settings.trigger == "steering":
        row |= {"trigger_yaw_rate": np.inf, "trigger_steering": settings.trigger_steering_angle}
    return row
