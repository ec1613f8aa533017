"""The last choice among polished swings: the fine step, and an unbroken row of frictions.

On two wheels a car balances, and another step of the plant can tip it or lay its tail on the ground at a friction where
the search saw nothing, also below the highest one survived. So the claim of a swing is the highest friction of a row
without a gap, from the highest that the published swing survives upwards, at `FINE_STEP`; and its heading change is
compared there at the lowest friction of that row. Of several cars each has its row; the least gain counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Search
from aerodima.optimisation.sweep.study_engine import Engine, SerialEngine
from aerodima.optimisation.swing.full_car import FINE_STEP, FRICTION_STEP, LEAST_HEADING, critical_friction, varied
from aerodima.optimisation.swing.search_options import Told
from aerodima.optimisation.swing.swing_candidate import Car, Reference, shares
from aerodima.workbench.config.scenario import scenario_from_dict
from aerodima.workbench.config.swing_file import SwingFile

FINALISTS = 2
"""Swings that are driven at the fine step, the most promising first."""


@dataclass(frozen=True)
class Row:
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
    rows: tuple[Row, ...]
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
    engine: Engine | None = None,
    told: Told = lambda _line: None,
) -> Claim | None:
    """The claim of the swing that gains most on the worst car; None when none turns far enough and survives the first.

    Args:
        swings: the most promising first; `FINALISTS` of them are driven.
        cars: with references at the steps of their scenarios.
        highest: friction up to which is looked, of the first car; see `shares` for the others.
        step: of the plant, s.
        engine: where the cars are driven.
        told: progress, line by line.
    """
    engine = engine or SerialEngine()
    fine = engine.call(_at_step, [(car, step) for car in cars])
    references = tuple(car.reference for car in fine)
    for number, one in enumerate(references, start=1):
        told(
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
            told(f"  finalist {place + 1}, car {number}: clean to {row.friction:.4f}, heading {row.heading:.1%}")
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


def _row(item: tuple[SwingFile, Car, float]) -> Row:
    swing, car, top = item
    low = car.reference.friction
    search = Search(FRICTION, low, top, 2 * FRICTION_STEP, FRICTION_STEP)
    found = critical_friction(scenario_from_dict(car.scenario), swing, search, low)
    highest = found.survived or 0.0
    rolled = max((seen.peak_roll for friction, seen in found.rows.items() if friction <= highest), default=float("nan"))
    return Row(highest, next(iter(found.rows.values())).heading / car.reference.heading, rolled)
