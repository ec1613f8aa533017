"""Bound of the entry speed on a path: the best motion of the tail with its best driver, both known
beforehand.

A reduced car is searched by differential evolution (Storn and Price 1997, doi
10.1023/A:1008202821328) over the numbers of its driver and, for the bound, the roll and pitch of
its tail at knots spread evenly over the path. Other candidates have their own best driver. A
motion need not clear the car; torque and speed of the motors limit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from aerodima.optimisation.judge.entry_speed import Case
from aerodima.optimisation.judge.reduced_entries import gains_of, reduced_cars
from aerodima.optimisation.judge.suite import CANDIDATES, FEEDBACK, MANOEUVRES, select_manoeuvres
from aerodima.optimisation.studies.limit_search import unbroken
from aerodima.optimisation.studies.runs import CachedRunner, make_frame, scenario_content
from aerodima.optimisation.swing.feedback_training import evolve
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.car.reduced.entry_runs import PathMotion, at_speeds, simulate_entries
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.scenario import load_scenario

BOUND = "bound"
"""Name of the motion that is known beforehand; the other names are those of `suite.CANDIDATES`."""
CANDIDATE_NAMES = ("none", "low-ballast", "feedback", BOUND)
FOLLOWING = ("feedback", BOUND)
"""Candidates whose tail rolls."""
DRIVER_RANGES = [(0.15, 0.6), (0.0, 3.0), (0.02, 0.3)]
"""Ranges of the driver's preview, s, correction and lag, s."""
ROLLS = 12
"""Number of rolls of the tail along the path."""
MOTION_RANGES = [(-1.45, 1.45)] * ROLLS + [(-1.25, 0.6)] * 4
"""Ranges of the tail's roll and pitch at knots along the path, rad."""
FIRST_SPEED = 2.0
"""First speed that is expected, m/s."""
STEP = 0.1
"""Between two speeds, m/s."""
SPEED_OFFSETS = STEP * np.arange(-4, 4)
"""Speeds of each member of a generation, from the best one so far, m/s."""
POPULATION = 40
"""Members of a generation."""
RESTARTS = 2
"""Starts of the candidates beside the bound."""
CASE = ["manoeuvre", "car", "floor"]
"""Columns that name a case."""


@dataclass(frozen=True)
class BoundStart:
    """One start of a search: small enough to send to a worker.

    Attributes:
        manoeuvre, tail: of the suite.
        car: settings.
        candidate: of `CANDIDATE_NAMES`.
        seed: of all draws; `generations` beside the first one.
    """

    manoeuvre: str
    tail: str
    car: tuple[str, ...]
    candidate: str
    seed: int
    generations: int


def paths(names: Sequence[str] = ()) -> list[str]:
    """Returns these manoeuvres of the suite, by default all with a path; SweepError for another
    one.
    """
    known = [name for name, one in MANOEUVRES.items() if one.rule == "path"]
    for name in names:
        if name not in known:
            raise SweepError(
                f"manoeuvre {name!r}: the bound is known on paths only; must be of "
                f"{', '.join(known)}"
            )
    return list(dict.fromkeys(names)) or known


def search_bound(
    names: Sequence[str],
    cases: Sequence[Case],
    tail: str,
    starts: int,
    generations: int,
    runs: CachedRunner,
) -> pd.DataFrame:
    """Searches the entry speeds of reduced cars on paths, m/s: a row for each manoeuvre, car and
    surface, a column for `CANDIDATE_NAMES`.

    The bound has so many starts, and is never below the law, which is a motion, too.
    """
    runs.stage = "bound"
    items = []
    rows = []
    keys = []
    for name in names:
        manoeuvre = MANOEUVRES[name]
        content = scenario_content(manoeuvre.scenario)
        for car, surface in cases:
            settings = (*car.settings_on(manoeuvre.scenario), *surface.settings)
            for candidate in CANDIDATE_NAMES:
                row = {"manoeuvre": manoeuvre.name, "car": car.name, "floor": surface.name}
                for seed in range(starts if candidate == BOUND else RESTARTS):
                    item = BoundStart(name, tail, settings, candidate, seed, generations)
                    items.append(item)
                    rows.append(row | {"candidate": candidate})
                    keys.append(content_key("bound", vars(item), *content))
    table = make_frame(rows)
    table["speed"] = runs.map(best_speed, items, keys)
    by_candidate = table.groupby([*CASE, "candidate"], sort=False)["speed"]
    best = by_candidate.max().unstack(sort=False)
    best[BOUND] = best[[BOUND, "feedback"]].max(axis=1)
    return best.reset_index()


def best_speed(start: BoundStart) -> float:
    """Returns the highest speed at which a start of the search finds the path kept, m/s; 0 where it
    finds none.

    A member of a generation keeps the path from 0.4 m/s below the best speed before that generation
    on.
    """
    (chosen,) = select_manoeuvres([start.manoeuvre], start.tail)
    car = reduced_cars(chosen, [start.car], CANDIDATES.get(start.candidate, FEEDBACK))
    scenario = load_scenario(chosen.scenario, (*chosen.settings, *FEEDBACK.settings))
    ranges = list(DRIVER_RANGES)
    if start.candidate == BOUND:
        ranges += MOTION_RANGES
    low, high = np.array(ranges).T[..., None]
    follows = float(start.candidate in FOLLOWING)
    drivers = len(DRIVER_RANGES)
    best = 0.0

    def cost(shares: FloatArray) -> FloatArray:
        nonlocal best
        members = shares.shape[1]
        speeds = np.round(max(best, FIRST_SPEED) + SPEED_OFFSETS, 2)
        numbers = np.repeat(low + shares * (high - low), len(speeds), axis=1)
        count = numbers.shape[1]
        cars = at_speeds(car.take(np.zeros(count, int)), np.tile(speeds, members))
        rolls, pitches = np.split(numbers[drivers:], [ROLLS])
        preview, correction, lag = numbers[:drivers]
        motion = PathMotion(preview, correction, lag, rolls, pitches)
        gains = gains_of([{}] * count, scenario)
        entries = simulate_entries(cars, scenario, gains, np.full(count, follows), motion)
        completed = entries.completed.reshape(members, -1)
        kept = unbroken(completed, axis=1).sum(axis=1)
        best = max(best, float(np.where(kept > 0, speeds[kept - 1], 0.0).max()))
        progress = entries.progress.reshape(members, -1)
        first_lost = np.minimum(kept, len(speeds) - 1)
        driven = progress[np.arange(members), first_lost]
        return np.asarray(-(speeds[0] + STEP * (kept + driven)))

    first = np.random.default_rng(start.seed).random((POPULATION, len(low)))
    first[0, drivers:] = 0.5  # a tail that is fixed in the middle
    evolve(cost, first, start.generations, start.seed)
    return best
