"""NHTSA's fishhook and J-turn at the standard's own angle, on the full car.

The steering is 6.5 times (fishhook) or 8 times (J-turn) the angle at which the car has 0.3 g at
50 mph (49 CFR 575). For a car with the same cornering stiffness per load on both axles that angle
is wheelbase x 0.3 g / speed squared. Speeds and times are those of the standard over the root of
10, for a car of scale 1:10.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import pandas as pd

from aerodima.optimisation.studies.runs import (
    FINE_STEP,
    CachedRunner,
    RunTask,
    make_frame,
    step_settings,
)
from aerodima.optimisation.swerve.candidate import Candidate
from aerodima.optimisation.swerve.suite import Case, candidate_settings
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.car.verdict import keeps_sides_down
from aerodima.workbench.core.file_reading import Facts, Settings
from aerodima.workbench.core.quantity import STANDARD_GRAVITY
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

MPH = 0.44704 / math.sqrt(10.0)
"""Speed of the car that stands for one mile per hour of the full-size car, m/s."""
SPEEDS = tuple(round(MPH * speed, 3) for speed in (35.0, 40.0, 45.0, 50.0))
"""Speeds of the standard, scaled to the car, m/s."""
REFERENCE_ACCELERATION = 0.3 * STANDARD_GRAVITY
"""Lateral acceleration at which the reference steering is measured, m/s2."""


class StandardManoeuvre(NamedTuple):
    """Manoeuvre of the standard: scenario, factor on the reference steering, further settings."""

    scenario: str
    factor: float
    settings: Settings = ()


MANOEUVRES: Mapping[str, StandardManoeuvre] = {
    "fishhook": StandardManoeuvre("entry_fishhook", 6.5),
    "j-turn": StandardManoeuvre("entry_held_turn", 8.0, ("manoeuvre.turn_hold=1.26",)),
}
"""Manoeuvres of the standard by name; the J-turn is held for 4 s at full size."""


def standard_angle(scenario: Scenario, factor: float) -> float:
    """Returns the steering angle of the standard, rad, at most the servo's limit."""
    reference = scenario.car.wheelbase * REFERENCE_ACCELERATION / SPEEDS[-1] ** 2
    return min(factor * reference, scenario.servo.limit)


def stays_down(row: Facts) -> bool:
    """Returns whether a full run neither lifts two wheels, nor touches the ground, nor flips."""
    lift = row.get("side_lift_m")
    upright = row["outcome"] == "survived" and row.get("touched_when_steered") == ""
    return upright and lift is not None and bool(keeps_sides_down(lift))


def passed_from_below(results: Sequence[bool]) -> int:
    """Returns how many speeds are passed before the first that is not."""
    return [*results, False].index(False)


def compare_standard(
    candidates: Sequence[Candidate], cases: Sequence[Case], runs: CachedRunner
) -> pd.DataFrame:
    """Drives the manoeuvres of the standard, with ballast at each of its places.

    Returns:
        A row per manoeuvre, candidate and case, for the best place of the ballast: `passed`, the
        number of speeds that are passed, counted from the lowest, and `tips_at_m_per_s`, the first
        speed that is not.
    """
    tasks = []
    rows: list[Row] = []
    for name, (scenario, factor, more) in MANOEUVRES.items():
        for case in cases:
            angle = standard_angle(load_scenario(scenario, case.settings(scenario)), factor)
            driver = (*more, f"manoeuvre.steer_angle={angle!r}", *step_settings(FINE_STEP))
            for candidate in candidates:
                names = {"manoeuvre": name, "candidate": candidate.name, **case.names}
                drives = [candidate_settings(candidate, case, one, scenario) for one in SPEEDS]
                for place in zip(*drives, strict=True):
                    rows.append(names)
                    for settings in place:
                        words = " ".join((*names.values(), settings[-1]))
                        task = RunTask(words, scenario, (*settings, *driver), law=candidate.law)
                        tasks.append(task)
    runs.stage = "standard manoeuvres"
    results = [stays_down(row) for row in runs.rows(tasks)]
    number = len(SPEEDS)
    starts = range(0, len(tasks), number)
    frame = make_frame(rows)
    frame["passed"] = [passed_from_below(results[first : first + number]) for first in starts]
    frame["tips_at_m_per_s"] = frame["passed"].map(dict(enumerate(SPEEDS)))
    best = frame.groupby([*rows[0]], sort=False)["passed"].idxmax()
    return frame.loc[best].reset_index(drop=True)
