"""Entry speeds of reduced cars: cars of a suite with their tails, swept over many speeds."""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerodima.optimisation.judge.candidate import Candidate
from aerodima.optimisation.judge.entry_speed import Manoeuvre
from aerodima.workbench.car.reduced.entry_runs import at_speeds, simulate_entries
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

BUILD_SPEED = 4.0
"""Speed at which the cars are built, m/s; each run has its own."""
BUILD_SETTINGS = (
    "manoeuvre.duration=4",
    f"manoeuvre.speed={BUILD_SPEED!r}",
    "manoeuvre.kind=turn",
    "manoeuvre.turns=1",
    "manoeuvre.rolling_start=false",
    "manoeuvre.turn_start=2",
)
"""Manoeuvre in which the cars are built."""


def sweep_speeds(
    cars: VehicleParams,
    speeds: FloatArray,
    drivers: Sequence[Scenario],
    gains: Any,
    steers_tail: FloatArray,
) -> tuple[BoolArray, FloatArray]:
    """Drives reduced cars through a manoeuvre at many speeds.

    The entry speed of a car is the last one of an unbroken row of completed speeds from below
    (`aerodima.optimisation.studies.limit_search.unbroken`).

    Args:
        cars: n of them.
        speeds: of each car, upwards (m, n), m/s.
        drivers: scenarios of the manoeuvre with one driver each; a speed is completed where one of
            them completes it.
        gains: fields of `FeedbackParameters` as arrays (n), see `gains_of`.
        steers_tail: 1 where the law rolls the tail, 0 where its roll is held in the middle (n).

    Returns:
        Whether each car completes the manoeuvre at each speed (m, n), and its mean lateral
        acceleration with the first driver (m, n), m/s2.
    """
    which = np.tile(np.arange(cars.count), len(speeds))
    swept = at_speeds(cars.take(which), speeds.ravel())
    own_gains = SimpleNamespace(**{name: values[which] for name, values in vars(gains).items()})
    entries = [simulate_entries(swept, driver, own_gains, steers_tail[which]) for driver in drivers]
    completed = np.logical_or.reduce([one.completed for one in entries])
    return completed.reshape(speeds.shape), entries[0].lateral_acceleration.reshape(speeds.shape)


def reduced_cars(
    manoeuvre: Manoeuvre, cars: Sequence[tuple[str, ...]], candidate: Candidate
) -> VehicleParams:
    """Makes cars by their settings with the tail of a manoeuvre and a candidate."""
    scenarios = []
    for car in cars:
        settings = (*car, *manoeuvre.settings)
        ballast: tuple[str, ...] = ()
        if candidate.ballast is not None:
            ballast = candidate.ballast(load_scenario(manoeuvre.scenario, settings))
        settings = (*settings, *candidate.settings, *ballast, *BUILD_SETTINGS)
        scenarios.append(load_scenario(manoeuvre.scenario, settings))
    return VehicleParams.from_scenarios(scenarios)


def gains_of(laws: Sequence[Mapping[str, float]], scenario: Scenario) -> Any:
    """Returns the fields of `FeedbackParameters` of laws as arrays (laws,); what a law does not
    name is the scenario's.
    """
    gains = {}
    for key, value in scenario.feedback:
        gains[key] = np.array([law.get(f"feedback.{key}", value) for law in laws], float)
    return SimpleNamespace(**gains)
