"""A changed swing on the full car: what it is compared with, and what it is worth among others.

Candidates are ranked by feasibility first: leaves its limits, rolls over at the common friction, turns too little,
rolls over at the target friction (the earlier the worse), touches the ground there, does so at a friction between the
common one and the target or rolls beyond the margin, and then by the car's peak roll and by what it turns too much.
Where several cars must survive, each at as many times what it survives with the published swing, a candidate must turn
far enough with all of them before any is driven at its target; its rank is halfway between their worst and their mean.


The last choice among refined swings: the fine step, and an unbroken row of frictions.

On two wheels a car balances, and another step of the plant can tip it or lay its tail on the ground at a friction where
the search saw nothing, also below the highest one survived. So the claim of a swing is the highest friction of a row
without a gap, from the highest that the published swing survives upwards, at `FINE_STEP`; and its heading change is
compared there at the lowest friction of that row. Of several cars each has its row; the least gain counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Search
from aerodima.optimisation.sweep.study_engine import RunEngine, SerialRunEngine
from aerodima.optimisation.swing.full_car import (
    FINE_STEP,
    FRICTION_STEP,
    Car,
    Reference,
    clean_critical_friction,
    drive,
    outcome,
    shares,
    varied,
)
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.plants.clearance import ground_clearance

HEADING_MARGIN, HEADING_MARGIN_OF_MANY = 0.005, 0.02
"""What a candidate must have on top, so that another step of the plant does not undo it; the second with several cars,
since the swing is meant for others as well."""
LOST = 0.6
"""Roll at which a car that rolls over counts as lost, rad; the later, the better its rank."""
ROLL_MARGIN = 0.8
"""A candidate may roll up to this share of `most_roll`, so that another step of the plant does not undo it."""
SPACING = 2 * FRICTION_STEP
"""Largest distance of the frictions below the target at which a candidate that is clean there must be clean too."""


def most_roll(scenario: Scenario) -> float:
    """Roll (rad) at which the car tips by its own weight, or before that a tail lying outside touches the ground."""
    car = scenario.car
    leans = np.linspace(0.0, math.atan(car.outer_half_track / car.com_height), 201)
    free = ground_clearance(scenario, 0.0, scenario.controller.hold_angle, leans) > 0.0
    return float(leans[-1] if np.all(free) else leans[int(np.argmin(free))])


def least_heading(cars: int) -> float:
    """Share of the reference's heading change that a candidate must reach when it is tried on so many cars."""
    return LEAST_HEADING + (HEADING_MARGIN if cars == 1 else HEADING_MARGIN_OF_MANY)


@dataclass(frozen=True)
class Score:
    """What a candidate is worth.

    Attributes:
        cost: rank among the candidates of a generation, lower is better.
        heading: share of the reference's heading change, the least of all cars; NaN when a common friction is not
            survived.
        clean: at the target friction and below it, within the margin of the roll, with all cars.
        peak_roll: the largest there, rad.
        headings: of each car, once all of them turn far enough.
    """

    cost: float
    heading: float = math.nan
    clean: bool = False
    peak_roll: float = math.nan
    headings: tuple[float, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """A changed swing (None: it leaves its limits) with the cars that it is tried on.

    `target` is the friction aimed at of the first car, see `shares` for the others. `headings` are the shares of the
    references' heading changes if they are known already; else they are driven for.
    """

    swing: SwingFile | None
    cars: tuple[Car, ...]
    target: float
    headings: tuple[float, ...] = ()


def score(candidate: Candidate) -> Score:
    """Drives the cars with a candidate: at the common friction, at the target and, if clean there, between them."""
    swing = candidate.swing
    if swing is None:
        return Score(6.0)
    least = least_heading(len(candidate.cars))
    headings = candidate.headings
    if not headings:
        first = [_turning(car, swing, least) for car in candidate.cars]
        headings = tuple(one.heading for one in first)
        if any(one.cost > _TURNS for one in first):
            return Score(_joint([one.cost for one in first]), min(headings))
    targets = shares(candidate.cars, candidate.target)
    found = [
        _surviving(car, swing, target, heading, heading - least)
        for car, target, heading in zip(candidate.cars, targets, headings, strict=True)
    ]
    return Score(
        _joint([one.cost for one in found]),
        min(headings),
        all(one.clean for one in found),
        max(one.peak_roll for one in found),
        headings,
    )


_TURNS = 4.0
"""Cost of a car that turns far enough, before more is known."""


def _joint(costs: Sequence[float]) -> float:
    return 0.5 * (max(costs) + sum(costs) / len(costs))


def _turning(car: Car, swing: SwingFile, least: float) -> Score:
    """At the common friction: whether the car survives and turns at least that share of the reference."""
    common = outcome(drive(scenario_from_dict(car.scenario), swing, car.reference.friction, rolling=True))
    if not common.clean:
        return Score(5.0 + common.peak_roll / math.pi)
    heading = common.heading / car.reference.heading
    return Score(_TURNS + max(least - heading, 0.0), heading)


def _surviving(car: Car, swing: SwingFile, target: float, heading: float, more: float) -> Score:
    """At the target and below; the more a car turns, the more it rolls, so `more` is friction that it gave away."""
    scenario = scenario_from_dict(car.scenario)
    run = drive(scenario, swing, target, rolling=True)
    found = outcome(run)
    if not found.survived:
        beyond = run.time[np.abs(run.signal("roll_truth_rad")) > LOST]
        duration = scenario.manoeuvre.duration
        upright = (float(beyond[0]) - scenario.manoeuvre.turn_start) if len(beyond) else duration
        return Score(3.0 - min(upright / duration, 1.0) + more, heading, False, found.peak_roll)
    if not found.clean:
        return Score(1.5 + found.peak_roll / math.pi + more, heading, False, found.peak_roll)
    rolled = found.peak_roll
    for friction in between(car.reference.friction, target):
        below = outcome(drive(scenario, swing, friction, rolling=True))
        rolled = max(rolled, below.peak_roll)
        if not below.clean:
            return Score(1.0 + rolled / math.pi + more, heading, False, rolled)
    within = rolled <= ROLL_MARGIN * most_roll(scenario)
    return Score(rolled + more + (0.0 if within else 0.5), heading, within, rolled)


def between(common: float, target: float) -> list[float]:
    """Frictions between the common one and the target, at most `SPACING` apart, from above."""
    return [
        float(value) for value in np.linspace(target, common, max(1, math.ceil((target - common) / SPACING)) + 1)[1:-1]
    ]


FINALISTS = 2
"""Swings that are driven at the fine step, the most promising first."""


@dataclass(frozen=True)
class DrivenFriction:
    """What a swing keeps on one car at the fine step.

    Attributes:
        friction: highest of the unbroken row that is survived clean; 0 if the first is lost.
        heading: share of the published swing's at the lowest friction of the row.
        peak_roll: the largest in the row up to `friction`, rad.
    """

    friction: float
    heading: float
    peak_roll: float


@dataclass(frozen=True)
class Claim:
    """What the best swing keeps at the fine step.

    Attributes:
        place: of the swing among those given.
        rows: of each car.
        references: the published swing on each car at the same step.
    """

    place: int
    rows: tuple[DrivenFriction, ...]
    references: tuple[Reference, ...]

    @property
    def gains(self) -> tuple[float, ...]:
        """Friction of each car over what it survives with the published swing."""
        return tuple(row.friction / one.friction for row, one in zip(self.rows, self.references, strict=True))

    @property
    def heading(self) -> float:
        """The least of all cars."""
        return min(row.heading for row in self.rows)

    @property
    def peak_roll(self) -> float:
        """The largest of all cars, rad."""
        return max(row.peak_roll for row in self.rows)


def choose(
    swings: Sequence[SwingFile],
    cars: Sequence[Car],
    highest: float,
    *,
    step: float = FINE_STEP,
    engine: RunEngine | None = None,
    progress: ProgressLine = silent,
) -> Claim | None:
    """The claim of the swing that gains most on the worst car; None when none turns far enough and survives the first.

    Args:
        swings: the most promising first; `FINALISTS` of them are driven.
        cars: with references at the steps of their scenarios.
        highest: friction up to which is looked, of the first car; see `shares` for the others.
        step: of the plant, s.
        engine: where the cars are driven.
        progress: takes lines of text.
    """
    engine = engine or SerialRunEngine()
    fine = engine.call(_at_step, [(car, step) for car in cars])
    references = tuple(car.reference for car in fine)
    for number, one in enumerate(references, start=1):
        progress(
            f"car {number} at {1000 * step:g} ms: the published swing is clean to {one.friction:.4f}, turns "
            f"{one.heading:.3f} rad"
        )
    tops = [max(top, one.friction) for top, one in zip(shares(cars, highest), references, strict=True)]
    best: Claim | None = None
    for place, swing in enumerate(swings[:FINALISTS]):
        if best is not None and all(
            row.friction > top - 0.5 * FRICTION_STEP for row, top in zip(best.rows, tops, strict=True)
        ):
            break  # nothing better can come
        claim = Claim(
            place,
            tuple(engine.call(_row, [(swing, car, top) for car, top in zip(fine, tops, strict=True)])),
            references,
        )
        for number, row in enumerate(claim.rows, start=1):
            progress(f"  finalist {place + 1}, car {number}: clean to {row.friction:.4f}, heading {row.heading:.1%}")
        lost = any(row.friction == 0.0 for row in claim.rows)
        if lost or claim.heading < LEAST_HEADING or (best is not None and min(claim.gains) <= min(best.gains)):
            continue
        best = claim
    return best


def _at_step(item: tuple[Car, float]) -> Car:
    car, step = item
    scenario = scenario_from_dict(car.scenario)
    fine = varied(scenario, simulation={"step": step, "log_rate": min(scenario.simulation.log_rate, 1.0 / step)})
    return Car(fine.resolved(), Reference.of(fine, car.reference.friction))


def _row(item: tuple[SwingFile, Car, float]) -> DrivenFriction:
    swing, car, top = item
    low = car.reference.friction
    search = Search(FRICTION, low, top, 2 * FRICTION_STEP, FRICTION_STEP)
    found = clean_critical_friction(scenario_from_dict(car.scenario), swing, search, low)
    highest = found.survived or 0.0
    rolled = max((seen.peak_roll for friction, seen in found.rows.items() if friction <= highest), default=float("nan"))
    return DrivenFriction(highest, next(iter(found.rows.values())).heading / car.reference.heading, rolled)
