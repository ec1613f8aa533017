"""Bound of the entry speed on a path: the best motion of the tail with its best driver, both known
beforehand.

A reduced car is searched by differential evolution (Storn and Price 1997, doi
10.1023/A:1008202821328) over the numbers of its driver and, for the bound, the roll and pitch of
its tail at places spread evenly over the path. Other candidates have their own best driver. A
motion need not clear the car; torque and speed of the motors limit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import differential_evolution

from aerodima.optimisation.judge.entry_speed import Surface
from aerodima.optimisation.judge.suite import CANDIDATES, FEEDBACK, MANOEUVRES, select_manoeuvres
from aerodima.optimisation.studies.runs import CachedRunner, make_frame, scenario_content
from aerodima.optimisation.swing.feedback_training import gains_of, reduced_cars
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.car.reduced.entry_runs import PathMotion, at_speeds, enter
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import Member
from aerodima.workbench.scenario.scenario import load_scenario

BOUND = "bound"
"""Name of the motion that is known beforehand; the other names are those of `suite.CANDIDATES`."""
CANDIDATE_NAMES = ("none", "low-ballast", "feedback", BOUND)
DRIVER_RANGES = [(0.15, 0.6), (0.0, 3.0), (0.02, 0.3)]
"""Ranges of the driver's preview, s, correction and lag, s."""
MOTION_RANGES = [(-1.45, 1.45)] * 12 + [(-1.25, 0.6)] * 4
"""Ranges of the tail's roll and pitch at places of the path, rad."""
ROLLS = len(DRIVER_RANGES) + 12
"""Where the rolls end among the searched numbers."""
FIRST_SPEED = 2.0
"""First speed that is expected, m/s."""
STEP = 0.1
"""Between two speeds, m/s."""
SPEED_OFFSETS = STEP * np.arange(-4, 4)
"""Speeds of each member of a generation, from the best one so far, m/s."""
POPULATION = 40
"""Members of a generation."""
RESTARTS = 2
"""Of the candidates beside the bound."""


@dataclass(frozen=True)
class BoundStart:
    """One start of a search: small enough to send to a worker.

    Attributes:
        manoeuvre, tail: of the suite.
        car: settings.
        who: of `CANDIDATE_NAMES`.
        seed: of all draws; `generations` beside the first one.
    """

    manoeuvre: str
    tail: str
    car: tuple[str, ...]
    who: str
    seed: int
    generations: int


def paths(names: Sequence[str] = ()) -> list[str]:
    """These manoeuvres of the suite, by default all with a path; SweepError for another one."""
    known = [name for name, one in MANOEUVRES.items() if one.rule == "path"]
    for name in names:
        if name not in known:
            raise SweepError(
                f"manoeuvre {name!r}: the bound is known on paths only; allowed: {', '.join(known)}"
            )
    return list(dict.fromkeys(names)) or known


def search_bound(
    names: Sequence[str],
    cases: Sequence[tuple[Member, Surface]],
    tail: str,
    starts: int,
    generations: int,
    runs: CachedRunner,
) -> pd.DataFrame:
    """Entry speeds of reduced cars on paths, m/s: a row for each manoeuvre, car and floor, a column
    for `CANDIDATE_NAMES`.

    The bound has so many starts, and is never below the law, which is a motion, too.
    """
    runs.stage = "bound"
    wanted = []
    places = []
    for name, car, floor in [(name, *case) for name in names for case in cases]:
        settings = (*car.settings_on(MANOEUVRES[name].scenario), *floor.settings)
        for who, seed in [
            (one, seed)
            for one in CANDIDATE_NAMES
            for seed in range(starts if one == BOUND else RESTARTS)
        ]:
            wanted.append(BoundStart(name, tail, settings, who, seed, generations))
            places.append(
                {
                    "manoeuvre": MANOEUVRES[name].name,
                    "car": car.name,
                    "floor": floor.name,
                    "who": who,
                }
            )
    keys = [
        content_key("bound", vars(one), *scenario_content(MANOEUVRES[one.manoeuvre].scenario))
        for one in wanted
    ]
    found = runs.call(best_speed, wanted, keys)
    table = make_frame(
        [place | {"speed": speed} for place, speed in zip(places, found, strict=True)]
    )
    best = (
        table.groupby(["manoeuvre", "car", "floor", "who"], sort=False)["speed"]
        .max()
        .unstack(sort=False)
    )
    best[BOUND] = best[[BOUND, "feedback"]].max(axis=1)
    return best.reset_index()


def best_speed(start: BoundStart) -> float:
    """Highest speed at which a start of the search finds the path kept, m/s; 0 where it finds none.

    A member of a generation keeps the path from 0.4 m/s below the best speed before that generation
    on.
    """
    (chosen,) = select_manoeuvres([start.manoeuvre], start.tail)
    moves = start.who == BOUND
    car = reduced_cars(chosen, [start.car], CANDIDATES.get(start.who, FEEDBACK))
    scenario = load_scenario(chosen.scenario, (*chosen.settings, *FEEDBACK.settings))
    low, high = np.array(DRIVER_RANGES + MOTION_RANGES * moves).T[..., None]
    follows = float(start.who != "none" and start.who != "low-ballast")
    best = 0.0

    def cost(shares: FloatArray) -> FloatArray:
        nonlocal best
        members = shares.shape[1]
        speeds = np.round(max(best, FIRST_SPEED) + SPEED_OFFSETS, 2)
        numbers = np.repeat(low + shares * (high - low), len(speeds), axis=1)
        cars = at_speeds(car.take(np.zeros(numbers.shape[1], int)), np.tile(speeds, members))
        preview, correction, lag = numbers[: len(DRIVER_RANGES)]
        motion = PathMotion(
            preview, correction, lag, numbers[len(DRIVER_RANGES) : ROLLS], numbers[ROLLS:]
        )
        gains = gains_of([{}] * cars.count, scenario)
        found = enter(cars, scenario, gains, np.full(cars.count, follows), motion)
        kept = np.cumprod(found.upright.reshape(members, -1), axis=1).sum(axis=1)
        best = max(best, float(np.where(kept > 0, speeds[kept - 1], 0.0).max()))
        driven = found.driven.reshape(members, -1)[
            np.arange(members), np.minimum(kept, len(speeds) - 1)
        ]
        return -(speeds[0] + STEP * (kept + driven))

    ends = [(0.0, 1.0)] * len(low)
    first = np.random.default_rng(start.seed).random((POPULATION, len(low)))
    first[0, len(DRIVER_RANGES) :] = 0.5  # a tail that lies still
    settings = {
        "polish": False,
        "vectorized": True,
        "updating": "deferred",
        "rng": start.seed,
        "tol": 0.0,
    }
    differential_evolution(cost, ends, init=first, maxiter=start.generations, **settings)
    return best
