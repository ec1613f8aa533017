"""Training of the rollover control for a driver at full lock, without tail or together with the
feedback law.

Numbers are scored by aims, such as how far the last point of the outline has moved aside after
0.5 s and after 1 s, each over its usual size, on training cars as modelled and on cars that differ
from their model: half the mean over all runs, half the mean of the worst fifth. A run that does not
count is worth nothing.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swerve.aims import FAILED, find_aim
from aerodima.optimisation.swerve.aims import score as score_swerves
from aerodima.optimisation.swerve.candidate import NO_TAIL, SWERVE, Candidate
from aerodima.optimisation.swerve.car_conditions import UNLIKE
from aerodima.optimisation.swerve.reduced_swerves import ReducedSwerve
from aerodima.optimisation.swerve.steering import constant_steering
from aerodima.optimisation.swerve.suite import FEEDBACK, Case
from aerodima.optimisation.swing.feedback_training import (
    RANGES,
    Law,
    LawSearch,
    law_settings,
    repeated,
    score,
    search_laws,
)
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.scenario.scenario import load_scenario

CONTROL_RANGES = {
    "rollover_control.gain": (0.5, 60.0),
    "rollover_control.start": (0.0, 0.25),
    "rollover_control.lead": (0.0, 0.3),
    "rollover_control.acceleration": (2.0, 80.0),
}
"""Ranges of the free numbers of the control, in the units of `RolloverControlParameters`."""
CONTROL_START = {
    "rollover_control.gain": 30.0,
    "rollover_control.start": 0.05,
    "rollover_control.lead": 0.1,
    "rollover_control.acceleration": 20.0,
}
"""Control that the search starts from, chosen by hand."""


class ControlBatch(NamedTuple):
    """Numbers to try on a car at its speed in several conditions, small enough for a worker."""

    settings: tuple[Settings, ...]
    aims: tuple[str, ...]
    numbers: tuple[Law, ...]


def train_rollover_control(
    has_tail: bool,
    cases: Sequence[Case],
    speeds: Sequence[float],
    aims: Sequence[str],
    search: LawSearch,
    runs: CachedRunner,
) -> Candidate:
    """Searches the rollover control with the best score on training cars.

    Args:
        has_tail: whether the numbers of the feedback law are searched with the control; if not, the
            cars have no tail.
        cases: training cars with their tail and floor.
        speeds: speeds of the swerves, m/s.
        aims: names of the aims by which numbers are scored.
        search: budget of the search; each round starts from the best of the one before.
        runs: runner of the swerves.

    Raises:
        UserError: no control keeps a car upright.
    """
    base = NO_TAIL
    ranges = dict(CONTROL_RANGES)
    start = dict(CONTROL_START)
    if has_tail:
        base = FEEDBACK
        ranges |= RANGES
        shipped = load_scenario(SWERVE).feedback
        start |= {key: getattr(shipped, key.removeprefix("feedback.")) for key in RANGES}
    best: Law = start
    places = control_places(base, cases, speeds)
    runs.stage = "rollover control"

    def score_numbers(numbers: Sequence[Law]) -> FloatArray:
        batches = [ControlBatch(place, tuple(aims), tuple(numbers)) for place in places]
        worth = np.concatenate(runs.map(score_control_batch, batches))
        return score(worth.T)

    for number in range(search.rounds):
        one = replace(search, seed=search.seed + number)
        best = search_laws(one, best, score_numbers, runs.say, ranges)
    name = f"trained {base.name}, rollover control"
    return Candidate(name, (*base.settings, *law_settings(best)))


def control_places(
    base: Candidate, cases: Sequence[Case], speeds: Sequence[float]
) -> list[tuple[Settings, ...]]:
    """Returns the settings of cars at their speeds, each in all the conditions of `UNLIKE`."""
    places = []
    for case in cases:
        conditions = [condition.settings(case) for condition in UNLIKE]
        for speed in speeds:
            driven = (*base.settings, f"manoeuvre.speed={speed!r}")
            places.append(tuple((*case.settings(), *one, *driven) for one in conditions))
    return places


def score_control_batch(batch: ControlBatch) -> list[list[float]]:
    """Returns the worth of numbers to a driver at full lock (conditions, numbers)."""
    aims = [find_aim(name) for name in batch.aims]
    worth = []
    for settings in batch.settings:
        car = ReducedSwerve(load_scenario(SWERVE, settings))
        steerings = constant_steering(car.scenario.servo.limit, len(batch.numbers))
        swerves = car.drive(steerings, repeated(batch.numbers, 1))
        values = [score_swerves(swerves, aim) / aim.size for aim in aims]
        counts = score_swerves(swerves, aims[0]) > FAILED
        row: list[float] = np.where(counts, np.mean(values, axis=0), 0.0).tolist()
        worth.append(row)
    return worth
