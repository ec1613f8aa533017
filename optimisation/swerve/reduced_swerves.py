"""Swerves of a candidate on reduced cars."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerodima.optimisation.studies.runs import code_content, scenario_content
from aerodima.optimisation.swerve.aims import find_aim, score
from aerodima.optimisation.swerve.candidate import SWERVE
from aerodima.optimisation.swerve.steering import (
    SearchEffort,
    constant_steering,
    search_steering,
)
from aerodima.optimisation.swerve.suite import FOLDED
from aerodima.workbench.batch.row_store import Row, content_key
from aerodima.workbench.car.reduced.parameters import VehicleParams, take
from aerodima.workbench.car.reduced.swerves import (
    FeedbackSwerve,
    LimitedSwerve,
    PlayedSwerve,
    SwerveRollout,
    drive_swerves,
)
from aerodima.workbench.car.swerve import Swerve
from aerodima.workbench.control.swing_library import swing_of_scenario
from aerodima.workbench.control.swing_player import RollTrajectory
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.core.key_errors import require_unique
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.scenario.swing_file import SwingFile

GENTLE = 0.01
"""Steering with which an aim is tried, rad; the car stays upright."""


class ReducedSwerve:
    """The reduced car of a scenario of kind `levels`, driven with any steerings.

    Args:
        scenario: scenario of the car at its speed on its floor, with its tail and law.

    Raises:
        UserError: the scenario holds something that the reduced car does not know.
    """

    def __init__(self, scenario: Scenario) -> None:
        if not reduced_car_knows(scenario):
            raise SweepError(
                f"{scenario.name}: the reduced car knows no tail, the feedback law, or a swing to "
                "the left that the steering releases; rollover control with the first two"
            )
        self.scenario = scenario
        self._car = VehicleParams.from_scenarios([scenario])
        self._swing = swing_of_scenario(scenario)

    def drive(
        self, steering: FloatArray, numbers: Mapping[str, FloatArray] | None = None
    ) -> Swerve:
        """Drives one car for each steering (`STEERING`, n). `numbers` (n) replace those of the
        feedback law and the rollover control, by their keys, such as `feedback.kp`.
        """
        n = steering.shape[1]
        cars = take(self._car, np.zeros(n, int))
        rollout: SwerveRollout
        if self._swing is None:
            others = numbers or {}
            gains = _numbers("feedback", self.scenario.feedback, others, n)
            control = _numbers("rollover_control", self.scenario.rollover_control, others, n)
            if np.any(control.gain):
                rollout = LimitedSwerve(cars, self.scenario, steering, gains, control)
            else:
                rollout = FeedbackSwerve(cars, self.scenario, steering, gains)
        else:
            pitch = self._swing.knots.pitch_position_rad[0] * np.ones(n)
            rollout = PlayedSwerve(cars, self.scenario, steering, pitch, knots_of(self._swing, n))
        return drive_swerves(rollout, self.scenario)


def _numbers(
    section: str, parameters: Any, others: Mapping[str, FloatArray], count: int
) -> SimpleNamespace:
    """Returns the numbers of a section as arrays (count); those in `others` take their place."""
    return SimpleNamespace(
        **{
            name: others.get(f"{section}.{name}", value) * np.ones(count)
            for name, value in parameters
        }
    )


def reduced_car_knows(scenario: Scenario) -> bool:
    """Returns whether a scenario has no tail, or one with a law that reduced cars can follow."""
    swing = swing_of_scenario(scenario)
    if swing is None:
        return not scenario.has_tail or scenario.follows_state
    if scenario.rollover_control.gain:
        return False
    is_released = swing.trigger.kind == "steering" and swing.trigger.delay_s == 0.0
    return is_released and swing.direction == "left"


def knots_of(swing: SwingFile, count: int) -> RollTrajectory:
    """Returns the roll of a swing file for `count` cars, with the gains of its first phase."""
    one = np.ones(count)
    phase = swing.gains.phases[0]
    knots = [np.outer(swing.knots.time_s, one)]
    knots += [np.outer(values, one) for values in swing.knots.states("roll")]
    gains = [phase.roll.kp, phase.roll.kd, phase.pitch.kp, phase.pitch.kd]
    return RollTrajectory(*knots, *[gain * one for gain in gains])


def check_aims(names: Sequence[str]) -> None:
    """Tries aims on two cars that swerve gently, their tails folded back.

    Raises:
        UserError: no such aim, or one named twice; an aim without a finite value for each car.
    """
    require_unique(names, "aim", SweepError)
    car = ReducedSwerve(load_scenario(SWERVE, FOLDED.settings))
    swerve = car.drive(constant_steering(GENTLE, 2))
    for name in names:
        values = find_aim(name)(swerve)
        if not np.isfinite(values).all():
            raise SweepError(f"aim {name}: is {values[0]} of an upright car; must be finite")


@dataclass(frozen=True)
class SteeringItem:
    """A search of a steering, small enough to send to a worker.

    Attributes:
        variants: alternative settings of the car; the best of them are taken.
        aim: name of the aim, or function of a file, `mine.py:my_aim`.
        effort: budget of the search; None for a driver at full lock.
    """

    variants: tuple[Settings, ...]
    aim: str
    effort: SearchEffort | None

    @property
    def key(self) -> str:
        """Key of the cached result, with the content of the files of scenarios and aim."""
        scenarios = [scenario_content(SWERVE, settings) for settings in self.variants]
        return content_key("steering", repr(self), scenarios, code_content(self.aim))


def best_steering(item: SteeringItem) -> Row:
    """Returns the best score and steering of a search, and the index of their variant."""
    aim = find_aim(item.aim)
    results = []
    for settings in item.variants:
        car = ReducedSwerve(load_scenario(SWERVE, settings))
        limit = car.scenario.servo.limit
        if item.effort is None:
            steering = constant_steering(limit, 1)
            (value,) = score(car.drive(steering), aim)
            results.append((float(value), steering[:, 0]))
        else:
            results.append(search_steering(car.drive, aim, limit, item.effort))
    index = int(np.argmax([value for value, _ in results]))
    value, steering = results[index]
    return {"score": value, "steering": steering.tolist(), "variant": index}
