"""Plans of the turns of many reduced cars: fields of their schedules and laws as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerodima.workbench.car.reduced.rollout import delay_ticks
from aerodima.workbench.control.manoeuvre import TurnSchedule, make_schedule
from aerodima.workbench.control.swing_law import SwingSettings
from aerodima.workbench.control.swing_library import NO_SWING
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import Scenario

PULSE = ("start", "steer_angle", "hold", "first_angle", "first_hold")
"""Fields of `TurnSchedule` that describe the steering."""
TRIGGERS = ("steering", "yaw_rate")
"""Known triggers of a swing."""


@dataclass(frozen=True)
class TurnPlans:
    """Steering and swings of n cars in a turn to the left; the last axis of every array is the car.

    Attributes:
        pulse: fields `PULSE` of each car's schedule.
        ramp: fields `duration` and `time_constant` of each car's speed ramp, s.
        law: numbers of each car's `SwingSettings`, and two more: `threshold` of the trigger,
            infinite where the tail is held, and `by_steering`, 1 where the trigger is the steering,
            0 where it is the yaw rate.
        servo_rate: rate of the servo, rad/s.
        imu_delay: age of the yaw rate that the law sees, ticks.
    """

    pulse: Any
    ramp: Any
    law: Any
    servo_rate: FloatArray
    imu_delay: FloatArray

    @classmethod
    def from_scenarios(cls, scenarios: Sequence[Scenario]) -> TurnPlans:
        """Makes the plans of scenarios whose tail follows the thesis' law, or is held.

        Raises:
            UserError: a manoeuvre, swing file or trigger that the model does not know, or scenarios
                that differ in the start of the turn, the rate or the delay of the IMU.
        """
        schedules = [_turn_schedule(scenario) for scenario in scenarios]
        ramps = [
            SimpleNamespace(duration=one.ramp.duration, time_constant=one.ramp.line.time_constant)
            for one in schedules
        ]
        laws = [_law_numbers(scenario) for scenario in scenarios]
        plans = cls(
            stack_fields(schedules, PULSE),
            stack_fields(ramps, vars(ramps[0])),
            stack_fields(laws, vars(laws[0])),
            np.array([scenario.servo.rate for scenario in scenarios], float),
            np.array([delay_ticks(scenario) for scenario in scenarios], float),
        )
        common = {
            "manoeuvre.turn_start, s": plans.pulse.start,
            "controller.rate, Hz": plans.law.rate,
            "imu.delay, ticks": plans.imu_delay,
        }
        for words, values in common.items():
            if np.ptp(values):
                raise UserError(
                    f"{words}: {values.min():g} and {values.max():g}; turns that are driven at "
                    "once have one"
                )
        return plans


def stack_fields(objects: Sequence[Any], names: Sequence[str] | Mapping[str, Any]) -> Any:
    """Returns an object with fields of these names that hold the objects' numbers as arrays (n)."""
    return SimpleNamespace(
        **{name: np.array([getattr(one, name) for one in objects], float) for name in names}
    )


def _turn_schedule(scenario: Scenario) -> TurnSchedule:
    """Makes the schedule of a turn; UserError for a manoeuvre of another kind."""
    schedule = make_schedule(scenario)
    if not isinstance(schedule, TurnSchedule):
        raise UserError(
            f"manoeuvre.kind: {scenario.manoeuvre.kind}; the reduced car drives turn and auto_turn"
        )
    return schedule


def _law_numbers(scenario: Scenario) -> Any:
    """Returns the numbers of the law of one scenario."""
    settings = SwingSettings.from_scenario(scenario)
    swing = scenario.controller.swing_file
    numbers = {name: value for name, value in settings if isinstance(value, int | float)}
    numbers |= {"by_steering": settings.trigger == "steering", "threshold": np.inf}
    if settings.mode != "swing":
        return SimpleNamespace(**numbers)
    if swing != NO_SWING:
        raise UserError(f"controller.swing_file: {swing}; the reduced car knows: {NO_SWING}")
    if settings.trigger not in TRIGGERS:
        raise UserError(
            f"controller.trigger: {settings.trigger}; the reduced car knows: {', '.join(TRIGGERS)}"
        )
    numbers["threshold"] = settings.threshold
    return SimpleNamespace(**numbers)
