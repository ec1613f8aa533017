"""Swerves of a candidate on reduced cars."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerodima.optimisation.swerve.aims import find_aim
from aerodima.optimisation.swerve.candidate import SWERVE, Settings
from aerodima.optimisation.swerve.steering import (
    SearchEffort,
    limited_angle,
    limited_steering,
    search_steering,
)
from aerodima.optimisation.swerve.suite import FOLDED
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.swerves import (
    FeedbackSwerve,
    PlayedSwerve,
    SwerveRollout,
    drive_swerves,
)
from aerodima.workbench.car.swerve import Swerve
from aerodima.workbench.control.swing_library import swing_of_scenario
from aerodima.workbench.control.swing_player import RollTrajectory
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.scenario.swing_file import SwingFile


class ReducedSwerve:
    """The reduced car of a scenario of kind `levels`, driven with any steerings.

    Args:
        scenario: car at its speed on its floor, with its tail and law.

    Raises:
        UserError: what the reduced car does not know.
    """

    def __init__(self, scenario: Scenario) -> None:
        if not reduced_car_knows(scenario):
            raise SweepError(
                f"{scenario.name}: the reduced car knows no tail, the feedback law, or a swing "
                "that the steering releases"
            )
        self.scenario = scenario
        self._car = VehicleParams.from_scenarios([scenario])
        self._swing = swing_of_scenario(scenario)

    def drive(self, steering: FloatArray, law: Mapping[str, FloatArray] | None = None) -> Swerve:
        """Drives one car for each steering (`STEERING`, n), with other numbers (n) of the feedback
        law if asked.
        """
        n = steering.shape[1]
        cars = self._car.take(np.zeros(n, int))
        rollout: SwerveRollout
        if self._swing is None:
            gains = {name: value * np.ones(n) for name, value in self.scenario.feedback}
            gains |= law or {}
            rollout = FeedbackSwerve(cars, self.scenario, steering, SimpleNamespace(**gains))
        else:
            pitch = self._swing.knots.pitch_position_rad[0] * np.ones(n)
            rollout = PlayedSwerve(cars, self.scenario, steering, pitch, knots_of(self._swing, n))
        return drive_swerves(rollout, self.scenario)


def reduced_car_knows(scenario: Scenario) -> bool:
    """Returns whether the tail of a scenario has a law that reduced cars can follow."""
    swing = swing_of_scenario(scenario)
    if swing is None:
        return scenario.tail.mode == "none" or scenario.follows_state
    return swing.trigger.kind == "steering" and swing.trigger.delay_s == 0.0


def knots_of(swing: SwingFile, count: int) -> RollTrajectory:
    """Returns the roll of a swing file for so many cars, with the gains of its first phase."""
    one = np.ones(count)
    phase = swing.gains.phases[0]
    knots = [np.outer(swing.knots.time_s, one)]
    knots += [np.outer(values, one) for values in swing.knots.states("roll")]
    gains = [phase.roll.kp, phase.roll.kd, phase.pitch.kp, phase.pitch.kd]
    return RollTrajectory(*knots, *[gain * one for gain in gains])


def check_aims(names: Sequence[str]) -> None:
    """Tries aims on two cars that swerve with 1 m/s2, their tails folded back.

    Raises:
        UserError: no such aim; one that has no finite value for each of them.
    """
    car = ReducedSwerve(load_scenario(SWERVE, FOLDED.settings))
    swerve = car.drive(limited_steering(car.scenario, np.ones(2)))
    for name in names:
        values = find_aim(name)(swerve)
        if not np.isfinite(values).all():
            raise SweepError(f"aim {name}: is {values[0]} of an upright car; must be finite")


@dataclass(frozen=True)
class SteeringItem:
    """A search of a steering: small enough to send to a worker.

    Attributes:
        variants: settings of the car, of which the best is taken.
        aim: name.
        effort: of the search.
        limit: of the wheels, see `Candidate`.
    """

    variants: tuple[Settings, ...]
    aim: str
    effort: SearchEffort
    limit: float = math.inf


def best_steering(item: SteeringItem) -> dict[str, Any]:
    """Returns score and steering of a search, and the index of the best variant."""
    aim = find_aim(item.aim)
    results = []
    for settings in item.variants:
        car = ReducedSwerve(load_scenario(SWERVE, settings))
        angle = float(limited_angle(car.scenario, item.limit))
        results.append(search_steering(car.drive, aim, angle, item.effort))
    index = int(np.argmax([value for value, _ in results]))
    value, steering = results[index]
    return {"score": value, "steering": steering.tolist(), "variant": index}
