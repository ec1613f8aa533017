"""Plans of the turns of many reduced cars: what each driver steers, and the law of each tail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SwingFile, cubic
from aerodima.workbench.controllers.law_of_scenario import swing_of_scenario
from aerodima.workbench.controllers.manoeuvre import TICK_TOLERANCE
from aerodima.workbench.controllers.swing_law import SwingSettings
from aerodima.workbench.errors import UserError

STILL = np.array([[0.0], [1.0]])
"""Times of the knots of a tail that follows none, s."""


@dataclass(frozen=True)
class PlayedRoll:
    """Knots of n tails in a turn to the left; the last axis of every field is the car, and complex steps pass through.

    Attributes:
        plays: 1 where a tail follows its knots, 0 where the law is another one.
        time: since the release (knots, n), s, strictly increasing, the first 0; before and after them the tail rests.
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
    def of(cls, swings: Sequence[SwingFile | None]) -> PlayedRoll:
        """Of swing files; None is a tail that follows none."""
        count = max((len(swing.knots.time_s) for swing in swings if swing is not None), default=len(STILL))
        rows = [_still() if swing is None else _played(swing) for swing in swings]
        longer = [[_lengthened(row[0], count, 1.0), *(_lengthened(v, count, 0.0) for v in row[1:3])] for row in rows]
        knots = [np.stack(each, axis=-1) for each in zip(*longer, strict=True)]
        gains = np.array([row[3] for row in rows]).T
        return cls(np.array([float(swing is not None) for swing in swings]), *knots, *gains)

    def take(self, places: Any) -> PlayedRoll:
        """Tails at these places, again and again if asked."""
        return PlayedRoll(*(getattr(self, field.name)[..., places] for field in fields(self)))

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Roll (n), rad, and its rate at times (n) since the releases, s."""
        number = np.clip(np.sum(self.time.real <= time, axis=0) - 1, 0, len(self.time) - 2)[None]
        begin, end, roll, next_roll, rate, next_rate = (
            np.take_along_axis(values, number + ahead, axis=0)[0]
            for values in (self.time, self.roll, self.rate)
            for ahead in (0, 1)
        )
        share = np.clip((time - begin) / (end - begin), 0.0, 1.0)
        value, slope = cubic(share, end - begin, (roll, next_roll), (rate, next_rate))
        return value, np.where((time < 0.0) | (time > self.time[-1].real), 0.0, slope)


def refuse_unknown(swing: SwingFile, scenario: Scenario) -> None:
    """Raises UserError when the screening model would misread a swing: says what it knows."""
    knots, name = swing.knots, f"swing {swing.name}"
    if knots.roll_torque_n_m is not None and any((*knots.roll_torque_n_m, *(knots.pitch_torque_n_m or ()))):
        raise UserError(f"{name}: knots.roll_torque_n_m; the screening model knows: no torques")
    if len(set(knots.pitch_position_rad)) > 1 or any(knots.pitch_velocity_rad_per_s):
        raise UserError(f"{name}: knots.pitch_position_rad changes; the screening model knows: one pitch")
    if len(swing.gains.phases) > 1:
        raise UserError(f"{name}: gains.phases: {len(swing.gains.phases)}; the screening model knows: 1")
    if swing.trigger.kind == "time":
        raise UserError(f"{name}: trigger.kind: time; the screening model knows: steering, yaw_rate")
    held = scenario.controller.hold_angle
    if abs(abs(knots.roll_position_rad[0]) - held) > 1e-6:
        raise UserError(
            f"{name}: knots.roll_position_rad.0: {knots.roll_position_rad[0]:g}; the screening model knows a swing "
            f"that begins where the tail stands, at controller.hold_angle {held:g} rad"
        )


def _still() -> list[Any]:
    return [STILL[:, 0], np.zeros(2), np.zeros(2), (0.0,) * 4]


def _played(swing: SwingFile) -> list[Any]:
    side = 1.0 if swing.direction == "left" else -1.0
    roll, rate = swing.knots.states("roll")
    phase = swing.gains.phases[0]
    gains = (phase.roll.kp, phase.roll.kd, phase.pitch.kp, phase.pitch.kd)
    return [np.array(swing.knots.time_s), side * roll, side * rate, gains]


def _lengthened(values: FloatArray, count: int, stride: float) -> FloatArray:
    """With the last value repeated, a stride further each time."""
    return np.concatenate([values, values[-1] + stride * np.arange(1.0, count - len(values) + 1.0)])


COMMON = {"start": "manoeuvre.turn_start, s", "rate": "controller.rate, Hz", "late": "imu.delay, ticks"}
"""Of `TurnPlans`: the same for all turns that are driven at once, with the words of a complaint."""


@dataclass(frozen=True)
class TurnPlans:
    """What n cars do in their turn; the last axis of every field is the car.

    Attributes:
        ramp, start: the car gathers speed for so long and goes straight until then, s.
        steer_angle: rad; `hold` s, length of the steering step; `steer_rate` of the servo, rad/s.
        first_angle, first_hold: another angle at the beginning of the step, rad, and how much of it, s.
        rate: of the controller, Hz; `late` how many of its ticks a yaw rate is old.
        trigger_steering: steering command that releases the swing, rad; infinite where a yaw rate does.
        swings: 1 where the tail swings; all others as `SwingSettings`, rad, s, rad/s, N m/rad, N m s/rad.
        played: the tails that follow a swing file.
    """

    ramp: FloatArray
    start: FloatArray
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
    def of(cls, scenarios: Sequence[Scenario], swings: Sequence[SwingFile | None] | None = None) -> TurnPlans:
        """The plans of scenarios whose tail follows the thesis' law or the knots of a swing file, or is held.

        Args:
            scenarios: turns.
            swings: played by their tails; by default those that the scenarios name.

        Raises:
            UserError: a swing or a trigger that the model does not know, or scenarios that differ in `COMMON`.
        """
        files = [swing_of_scenario(scenario) for scenario in scenarios] if swings is None else list(swings)
        rows = [_row(scenario, swing) for scenario, swing in zip(scenarios, files, strict=True)]
        names = [field.name for field in fields(cls) if field.name != "played"]
        numbers = np.array([[row[name] for name in names] for row in rows], float).T
        plans = cls(**dict(zip(names, numbers, strict=True)), played=PlayedRoll.of(files))
        for name, words in COMMON.items():
            if len(found := np.unique(getattr(plans, name))) > 1:
                raise UserError(f"{words}: {found[0]:g} and {found[-1]:g}; turns that are driven at once have one")
        return plans

    def take(self, places: Any) -> TurnPlans:
        """Plans at these places, again and again if asked."""
        numbers = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "played"}
        taken = {name: values[..., places] for name, values in numbers.items()}
        return TurnPlans(**taken, played=self.played.take(places))

    def commanded(self, time: float) -> FloatArray:
        """Steering command (n) of the drivers at a time since the start of the turn, rad."""
        level = np.where(time + TICK_TOLERANCE < self.first_hold, self.first_angle, self.steer_angle)
        return np.where((time + TICK_TOLERANCE >= 0.0) & (time + TICK_TOLERANCE < self.hold), level, 0.0)

    def steering(self, time: Any) -> FloatArray:
        """Angle (n) to which the servos have turned the wheels at a time since the start of the turn, rad.

        Args:
            time: s; several in (times, 1) give angles (times, n).
        """
        rate = self.steer_rate
        first = np.minimum(np.maximum(rate * np.minimum(time, self.first_hold), 0.0), self.first_angle)
        moved = rate * np.maximum(0.0, np.minimum(time, self.hold) - self.first_hold)
        angle = first + np.clip(self.steer_angle - first, -moved, moved)
        return np.maximum(angle - rate * np.maximum(0.0, time - self.hold), 0.0)

    @property
    def straight(self) -> FloatArray:
        """When the wheels are straight again (n), s since the start of the turn; see `angle_to_straighten`."""
        first = self.first_angle - self.steer_rate * (self.hold - self.first_hold)
        last = np.where(self.first_hold > 0.0, np.maximum(self.steer_angle, first), self.steer_angle)
        return self.hold + last / self.steer_rate


def _row(scenario: Scenario, swing: SwingFile | None) -> dict[str, float]:
    """Fields of `TurnPlans` for one turn."""
    settings, turn, imu = SwingSettings.from_scenario(scenario), scenario.manoeuvre, scenario.imu
    row: dict[str, Any] = {name: getattr(settings, name) for name in SwingSettings.model_fields}
    row |= {
        "ramp": turn.speed_ramp,
        "start": turn.turn_start,
        "steer_angle": turn.steer_angle,
        "hold": turn.turn_hold,
        "first_angle": turn.first_angle,
        "first_hold": turn.first_hold,
        "steer_rate": scenario.servo.rate,
        "late": np.ceil(imu.delay * settings.rate - 1e-9),
        "trigger_steering": np.inf,
        "swings": float(settings.mode == "swing"),
    }
    if swing is not None:
        refuse_unknown(swing, scenario)
        steering, yaw_rate = swing.trigger.threshold_rad, swing.trigger.threshold_rad_per_s
        return row | {
            "trigger_yaw_rate": np.inf if yaw_rate is None else yaw_rate,
            "trigger_steering": np.inf if steering is None else steering,
            "delay": swing.trigger.delay_s + settings.delay,
            "hold_kp": swing.gains.hold.kp,
            "hold_kd": swing.gains.hold.kd,
            "pitch_angle": swing.knots.pitch_position_rad[0],
        }
    if settings.mode == "swing" and settings.trigger == "lateral_acceleration":
        raise UserError(f"controller.trigger: {settings.trigger}; the screening model knows: steering, yaw_rate")
    if settings.trigger == "steering":
        row |= {"trigger_yaw_rate": np.inf, "trigger_steering": settings.trigger_steering_angle}
    return row
