"""A changed swing on the full car: what it is compared with, and what it is worth among others.

Candidates are ranked by feasibility first: leaves its limits, rolls over at the common friction, turns too little,
rolls over at the target friction (the earlier the worse), touches the ground there, and then by the car's peak roll
there and by what it turns too much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from optimisation.errors import SwingError
from optimisation.swing.full_car import LEAST_HEADING, critical_friction, drive, outcome, varied
from workbench.scenario import Scenario, default_values, scenario_from_dict
from workbench.swing_file import SwingFile

HEADING_MARGIN = 0.005
"""What a candidate must have on top, so that another step of the plant does not undo it."""
LOST = 0.6
"""Roll at which a car that rolls over counts as lost, rad; the later, the better its rank."""
LOWEST, HIGHEST = 0.3, 1.2
"""Frictions between which the reference's highest one is searched."""


@dataclass(frozen=True)
class Reference:
    """The published swing in a turn: highest friction that it survives clean, and its heading change there, rad."""

    friction: float
    heading: float

    @classmethod
    def of(cls, scenario: Scenario) -> Reference:
        """Of the turn of a scenario, on a grid of `FRICTION_STEP`.

        Raises:
            SwingError: the published swing does not survive the turn at the lowest friction.
        """
        found = critical_friction(cls.turn(scenario), None, LOWEST, HIGHEST)
        if found.value == 0.0:
            raise SwingError(
                f"the published swing does not survive {scenario.manoeuvre.speed:g} m/s at friction {LOWEST:g}, so "
                "there is no turn to compare with; allowed: a slower turn"
            )
        return cls(found.value, dict(found.runs)[found.value].heading)

    @staticmethod
    def turn(scenario: Scenario) -> Scenario:
        """The turn of a scenario with the published swing."""
        return varied(scenario, tail={"mode": "swing"}, controller=default_values()["controller"])


@dataclass(frozen=True)
class Score:
    """What a candidate is worth.

    Attributes:
        cost: rank among the candidates of a generation, lower is better.
        heading: share of the reference's heading change; NaN when the common friction is not survived.
        clean: at the target friction.
        peak_roll: there, rad.
    """

    cost: float
    heading: float = math.nan
    clean: bool = False
    peak_roll: float = math.nan


@dataclass(frozen=True)
class Candidate:
    """A changed swing (None: it leaves its limits) with the turn it is tried in, small enough to send anywhere.

    `heading` is its share of the reference's heading change if that is known already; else it is driven for.
    """

    swing: SwingFile | None
    scenario: dict[str, Any]
    reference: Reference
    target: float
    heading: float | None = None


def score(candidate: Candidate) -> Score:
    """Drives the full car with a candidate, once or twice."""
    if candidate.swing is None:
        return Score(6.0)
    scenario = scenario_from_dict(candidate.scenario)
    heading = candidate.heading
    if heading is None:
        common = outcome(drive(scenario, candidate.swing, candidate.reference.friction))
        if not common.clean:
            return Score(5.0 + common.peak_roll / math.pi)
        heading = common.heading / candidate.reference.heading
    if heading < LEAST_HEADING + HEADING_MARGIN:
        return Score(4.0 + LEAST_HEADING + HEADING_MARGIN - heading, heading)
    trial = drive(scenario, candidate.swing, candidate.target)
    found = outcome(trial)
    # The more a car turns, the more it rolls: what it turns too much is friction that it gave away.
    more = heading - LEAST_HEADING - HEADING_MARGIN
    if found.clean:
        return Score(found.peak_roll + more, heading, True, found.peak_roll)
    if found.survived:
        return Score(1.0 + found.peak_roll / math.pi + more, heading, False, found.peak_roll)
    beyond = trial.run_log.time[np.abs(trial.run_log.signal("roll_truth_rad")) > LOST]
    upright = (float(beyond[0]) - scenario.manoeuvre.turn_start) if len(beyond) else scenario.manoeuvre.duration
    return Score(3.0 - min(upright / scenario.manoeuvre.duration, 1.0) + more, heading, False, found.peak_roll)
