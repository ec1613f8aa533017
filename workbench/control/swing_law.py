"""The thesis' swing: its states and settings, and its steps as functions of numbers or arrays.

Hold inside, trigger, swing over the top, settle outside: Table 6.4 read with ERRATA E28 (130
degrees is travel, the swing speed points over the top); design section 8. A batch of cars and the
car itself (`swing_machine`) run the same lines. No Drake.

Signs: tail roll angle 0 = straight up, positive to the right; yaw rate positive to the left. For a
left turn the tail waits on the left (-90 degrees) and swings with positive roll rate.
"""

import math
from enum import IntEnum
from typing import Any, Literal, NamedTuple

from pydantic import Field, model_validator

from aerodima.workbench.control.tail_law import EPSILON
from aerodima.workbench.core.elementwise import where
from aerodima.workbench.core.yaml_files import checked
from aerodima.workbench.scenario.law_parameters import ControllerParameters


class SwingState(IntEnum):
    """States in the numbering of Table 6.4; OFF, RECOCK and FALLBACK are ours."""

    OFF = 0
    """No command is given: there is no tail, or its angle is not known yet."""
    HOLD = 1
    DELAY = 2
    SWING = 3
    SETTLE = 4
    RECOCK = 5
    """Slow return to the inside before the next turn to the same side."""
    FALLBACK = 6
    """A played swing was given up: this law finishes it (`swing_player`)."""


class SwingSettings(ControllerParameters):
    """Numbers of the law: those of a scenario's section `controller`, with its units and limits,
    and some of its own.

    Args:
        mode: mode of the law: "none" gives no command, "held" never swings, "swing" is the thesis'
            law.
        stall_factor: number of times travel / swing_speed after which the swing is given up for
            SETTLE, so that a blocked tail is not pushed for ever.
        ready_angle: largest angle of the tail from the inside at which it is held there at once,
            rad; from further away it is led there.
    """

    mode: Literal["none", "held", "swing"] = "swing"
    stall_factor: float = Field(3.0, ge=1)
    ready_angle: float = Field(0.35, ge=0, le=math.pi)

    @model_validator(mode="after")
    def _travels_over_the_top(self) -> "SwingSettings":
        if self.travel > 2.0 * self.hold_angle:
            raise ValueError(
                f"travel: {self.travel:g} rad; allowed: <= twice hold_angle, "
                f"{2.0 * self.hold_angle:g} rad"
            )
        return self

    @property
    def threshold(self) -> float:
        """Returns the threshold of the trigger: rad/s of yaw, rad of steering, or m/s2."""
        thresholds: dict[str, float] = {
            "yaw_rate": self.trigger_yaw_rate,
            "steering": self.trigger_steering_angle,
            "lateral_acceleration": self.trigger_lateral_acceleration,
        }
        return thresholds[self.trigger]

    @classmethod
    def from_scenario(cls, scenario: Any) -> "SwingSettings":
        """Reads the settings from `controller` and `tail.mode` of a scenario."""
        values = {**scenario.controller.model_dump(), "mode": scenario.tail.mode}
        return checked(cls, values, "controller")


class SwingPhase(NamedTuple):
    """Progress of a swing, numbers or arrays of cars (n).

    Attributes:
        state: a `SwingState`.
        since: time at which that state was entered, s.
        start: roll of the tail at that time, rad.
    """

    state: Any
    since: Any
    start: Any


class JointCommand(NamedTuple):
    """Command to a motor in rad, rad/s, N m/rad, N m s/rad; numbers or arrays of cars (n)."""

    position: Any
    velocity: Any
    kp: Any
    kd: Any


def next_phase(
    phase: SwingPhase, time: Any, roll: Any, released: Any, delay: Any, over: Any
) -> SwingPhase:
    """Returns the phase after one tick: HOLD, DELAY, SWING, SETTLE; others stay.

    Args:
        phase: phase before the tick.
        time: time of the tick, s.
        roll: roll of the tail, rad.
        released: whether a signal says that the turn has begun.
        delay: time from the release to the swing, s.
        over: whether the swing is at its end.
    """
    delayed = where(released & (phase.state == SwingState.HOLD), int(SwingState.DELAY), phase.state)
    waited = where(delayed == phase.state, time - phase.since, 0.0) + EPSILON
    starts = (delayed == SwingState.DELAY) & (waited >= delay)
    state = where(starts, int(SwingState.SWING), delayed)
    state = where((phase.state == SwingState.SWING) & over, int(SwingState.SETTLE), state)
    stays = state == phase.state
    return SwingPhase(state, where(stays, phase.since, time), where(stays, phase.start, roll))


def is_released(turn: Any, signal: Any, threshold: Any) -> Any:
    """Returns whether the signal that is the trigger passes its threshold into the turn.

    Args:
        turn: side of the turn, +1 left, -1 right.
        signal: signal of the trigger, see `SwingSettings.threshold`, numbers or arrays of cars (n);
            NaN releases nothing.
        threshold: threshold of the signal, in its unit.
    """
    return turn * signal > threshold


def is_over(settings: Any, travelled: Any, elapsed: Any) -> Any:
    """Returns whether a swing has travelled (rad) as far as it should, or has lasted too long with
    `elapsed` s; settings as for `roll_command`.
    """
    longest = settings.stall_factor * settings.travel / settings.swing_speed
    return (travelled >= settings.travel) | (elapsed >= longest)


def roll_command(settings: Any, state: Any, mirror: Any) -> JointCommand:
    """Returns the command to the roll motor in a state: inside, over the top or outside.

    Args:
        settings: any object with the fields of `SwingSettings`, numbers or arrays of cars (n).
        state: a `SwingState`.
        mirror: side of the turn, +1 left, -1 right.
    """
    swings = state == SwingState.SWING
    settles = state == SwingState.SETTLE
    outside = mirror * settings.hold_angle
    kp = where(settles, settings.settle_kp, settings.hold_kp)
    kd = where(settles, settings.settle_kd, settings.hold_kd)
    return JointCommand(
        where(swings, 0.0, where(settles, outside, -outside)),
        where(swings, mirror * settings.swing_speed, 0.0),
        where(swings, settings.swing_kp, kp),
        where(swings, settings.swing_kd, kd),
    )
