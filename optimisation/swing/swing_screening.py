"""Candidate swings on reduced cars (`optimisation/screening`), all at once: the best tenth goes to the full car.

Ranked in the order in which `swing_ranking.score` ranks runs of the full car, headings over that of the published swing
on the same reduced car. A straight is driven once for all candidates, whose tails wait alike: one released before the
turn is taken for one that waits. What is claimed of a swing is the full car's alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import Turns, drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.swing.full_car import Car, Reference, played_turn, shares
from aerodima.optimisation.swing.swing_ranking import least_heading
from aerodima.workbench.batch.engine import ProgressLine
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.errors import UserError

DRAWN = 10
"""Candidates drawn for each one that the full car drives."""
STEP = 0.005
"""Longest of reduced cars, s, as in `optimisation/corner`; a tick of the controller is a whole number of them."""


@dataclass(frozen=True)
class SwingScreen:
    """Reduced cars that candidates of a refinement are tried on.

    Attributes:
        cars: on the full car, with their references.
        turns: of the cars, with a tail that plays a swing.
        vehicles: the reduced cars.
        headings: of the published swing on them at the friction of their reference, rad, (cars,).
    """

    cars: tuple[Car, ...]
    turns: tuple[Scenario, ...]
    vehicles: Vehicles
    headings: FloatArray

    @classmethod
    def of(cls, cars: Sequence[Car], swing: SwingFile, progress: ProgressLine) -> SwingScreen | None:
        """For swings like this one; None where the screening model does not know car or swing, which is said."""
        scenarios = [scenario_from_dict(car.scenario) for car in cars]
        turns = tuple(played_turn(scenario) for scenario in scenarios)
        try:
            vehicles = Vehicles.of(turns)
            TurnPlans.of(turns, [swing] * len(turns))
            published = TurnPlans.of([Reference.turn(scenario) for scenario in scenarios])
        except UserError as error:
            progress(f"refinement: without screening, every candidate is driven on the full car ({error})")
            return None
        there = vehicles.with_friction([car.reference.friction for car in cars])
        headings = drive_turns(there, published, duration=_duration(turns), length=_step(turns)).heading
        return cls(tuple(cars), turns, vehicles, headings)

    def costs(self, swings: Sequence[SwingFile], target: float) -> list[float]:
        """Rank of every swing, lower is better, when the first car's friction is to be `target`."""
        count, many = len(self.cars), len(swings)
        common = [car.reference.friction for car in self.cars]
        floors = self.vehicles.take(np.tile(np.arange(count), 2))
        floors = floors.with_friction(np.concatenate([common, shares(self.cars, target)]))
        turns = self.turns * 2
        latest = max(swings, key=lambda swing: swing.trigger.threshold_rad_per_s or 0.0)
        straight = drive_turns(
            floors, TurnPlans.of(turns, [latest] * len(turns)), duration=0.0, length=_step(turns)
        ).last
        driven = drive_turns(
            floors.take(np.tile(np.arange(2 * count), many)),
            TurnPlans.of(turns * many, [swing for swing in swings for _ in turns]),
            duration=_duration(self.turns),
            length=_step(turns),
            begun=np.tile(straight, many),
        )
        costs = self._costs(driven, many)
        return [float(cost) for cost in 0.5 * (costs.max(axis=1) + costs.mean(axis=1))]

    def _costs(self, driven: Turns, many: int) -> FloatArray:
        """Of every swing on every car, (swings, cars); each is driven at the common frictions, then at the targets."""
        shape = (many, 2, len(self.cars))
        clean, survived, rolled = (
            np.asarray(values).reshape(shape) for values in (driven.clean, driven.survived, driven.peak_roll)
        )
        heading = driven.heading.reshape(shape)[:, 0] / self.headings
        least = least_heading(len(self.cars))
        at_target = np.select([clean[:, 1], survived[:, 1]], [rolled[:, 1], 1.5 + rolled[:, 1] / np.pi], 3.0)
        short = np.maximum(least - heading, 0.0)
        costs: FloatArray = np.select(
            [~clean[:, 0], short > 0.0], [5.0 + rolled[:, 0] / np.pi, 4.0 + short], at_target + heading - least
        )
        return costs


def _step(turns: Sequence[Scenario]) -> float:
    rate = turns[0].controller.rate
    return 1.0 / (rate * math.ceil(1.0 / (rate * STEP) - 1e-9))


def _duration(turns: Sequence[Scenario]) -> float:
    manoeuvre = turns[0].manoeuvre
    return manoeuvre.duration - manoeuvre.turn_start
