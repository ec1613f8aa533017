"""Tails of many cars that follow the knots of a swing file, each its own; what the player of such a file commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SwingFile, cubic
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
