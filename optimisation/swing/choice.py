"""The last choice among polished swings: the fine step, and an unbroken row of frictions.

On two wheels a car balances, and another step of the plant can tip it or lay its tail on the ground at a friction where
the search saw nothing, also below the highest one survived. So the claim of a swing is the highest friction of a row
without a gap, from the highest that the published swing survives upwards, at `FINE_STEP`; and its heading change is
compared there at the lowest friction of that row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from optimisation.swing.candidate import Reference
from optimisation.swing.full_car import FINE_STEP, FRICTION_STEP, LEAST_HEADING, unbroken_friction, varied
from optimisation.swing.options import Told
from workbench.scenario import Scenario
from workbench.swing_file import SwingFile

FINALISTS = 2
"""Swings that are driven at the fine step, the most promising first."""


@dataclass(frozen=True)
class Claim:
    """What the best swing keeps at the fine step.

    Attributes:
        place: of the swing among those given.
        friction: highest of the row that is survived clean.
        heading: share of the published swing's at the lowest friction of the row.
        peak_roll: the largest in the row up to `friction`, rad.
        reference: the published swing at the same step.
    """

    place: int
    friction: float
    heading: float
    peak_roll: float
    reference: Reference


def choose(
    swings: Sequence[SwingFile],
    scenario: Scenario,
    reference: Reference,
    highest: float,
    *,
    step: float = FINE_STEP,
    told: Told = lambda _line: None,
) -> Claim | None:
    """The claim of the swing that survives most friction; None when none turns far enough and survives the first.

    Args:
        swings: the most promising first; `FINALISTS` of them are driven.
        scenario: car and turn, as published but for speed and car.
        reference: at the step of the scenario.
        highest: friction up to which is looked.
        step: of the plant, s.
        told: progress, line by line.
    """
    fine = varied(scenario, simulation={"step": step, "log_rate": min(scenario.simulation.log_rate, 1.0 / step)})
    common = Reference.near(fine, reference.friction)
    told(f"at {1000 * step:g} ms the published swing is clean to {common.friction:.4f}, turns {common.heading:.3f} rad")
    best: Claim | None = None
    for place, swing in enumerate(swings[:FINALISTS]):
        if best is not None and best.friction > highest - 0.5 * FRICTION_STEP:
            break  # nothing better can come
        row = unbroken_friction(fine, swing, common.friction, max(highest, common.friction))
        heading = row.runs[0][1].heading / common.heading
        told(f"  finalist {place + 1}: clean to {row.value:.4f}, heading {heading:.1%}")
        if row.value == 0.0 or heading < LEAST_HEADING or (best is not None and row.value <= best.friction):
            continue
        rolled = max(seen.peak_roll for friction, seen in row.runs if friction <= row.value)
        best = Claim(place, row.value, heading, rolled, common)
    return best
