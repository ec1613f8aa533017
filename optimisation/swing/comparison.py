"""Comparison of candidates in swerves. Each has its own best steering, which is found on reduced
cars and then driven on the full car, its angles scaled to where the swerve just counts there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.runs import (
    FINE_STEP,
    CachedRunner,
    make_frame,
)
from aerodima.optimisation.swerve.aims import FAILED
from aerodima.optimisation.swerve.candidate import NO_TAIL, SWERVE, Candidate
from aerodima.optimisation.swerve.reduced_swerves import (
    ReducedSwerve,
    SteeringItem,
    best_steering,
    reduced_car_knows,
)
from aerodima.optimisation.swerve.steering import SearchEffort
from aerodima.optimisation.swerve.suite import ANNOUNCED, BOUNDS, FOLDED, Case, candidate_settings
from aerodima.optimisation.swing.bound import BoundEffort, find_bound
from aerodima.optimisation.swing.full_runs import Descent, confirm_best, drive_shares
from aerodima.optimisation.swing.full_search import search_full
from aerodima.optimisation.swing.solution import LIMITS_OPTION, solution_swing
from aerodima.optimisation.swing.swerve_shooting import read_limits, tail_at_knots
from aerodima.optimisation.swing.verification import car_limit
from aerodima.workbench.batch.row_store import Row, no_progress, print_progress
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import swing_from_dict, write_swing


@dataclass(frozen=True)
class BoundItem:
    """A search of a bound for one car, or of one motion for several.

    Attributes:
        settings: settings of the first car.
        aim: name of the aim, or function of a file, `mine.py:my_aim`.
        effort: budget of the search; None for a `BoundEffort()`.
        others: settings of further cars that have the same motion.
        limits: limits, such as `roll=0.3`, of a motion that is to be verified; it also keeps what a
            verification asks for, and the worker prints its progress. None for a bound.
        starts: settings and steering of candidates with the same tail, from whose motions the
            search also starts.
        name: name of the swing that is made.
        announced: whether the turn is announced, so that the tail may wait at a side.
    """

    settings: Settings = ()
    aim: str = ""
    effort: BoundEffort | None = None
    others: tuple[Settings, ...] = ()
    limits: tuple[str, ...] | None = None
    starts: tuple[tuple[Settings, tuple[float, ...]], ...] = ()
    name: str = ""
    announced: bool = False


def best_motion(item: BoundItem) -> Row:
    """Returns score and steering of a bound, and its swing file as plain data."""
    scenarios = [load_scenario(SWERVE, one) for one in (item.settings, *item.others)]
    limits = []
    if item.limits is not None:
        limits = [*map(car_limit, scenarios), *read_limits(item.limits)]
    progress = print_progress if limits else no_progress
    starts = []
    for settings, numbers in item.starts:
        steering = np.array(numbers)
        swerve = ReducedSwerve(load_scenario(SWERVE, settings)).drive(steering[:, None])
        starts.append((tail_at_knots(swerve), steering))
    bound = find_bound(
        scenarios,
        item.aim,
        limits,
        item.effort,
        starts,
        progress=progress,
        announced=item.announced,
    )
    swing = solution_swing(item.name, item.settings, bound, item.aim)
    content = swing.plain()
    if item.limits:
        content["provenance"]["options"] = {LIMITS_OPTION: " ".join(item.limits)}
    return bound.result | {"swing": content}


def compare_swerves(
    candidates: Sequence[Candidate],
    cases: Sequence[Case],
    speeds: Sequence[float],
    aims: Sequence[str],
    runs: CachedRunner,
    folder: Path,
    *,
    steering_effort: SearchEffort | None = None,
    bound: BoundItem | None = None,
    step: float | None = FINE_STEP,
    further: int = 0,
) -> pd.DataFrame:
    """Compares candidates; the car without tail and the folded tail are always among them.

    Args:
        candidates: candidates with their laws; those of `suite.BOUNDS` stand for the best motions
            of the tail, and the announced one brings the other along.
        cases: cars with their tail and floor.
        speeds: speeds of the swerves, m/s.
        aims: names of `AIMS`, or functions of a file, `mine.py:my_aim`.
        runs: runner of the searches and full runs, which makes each once.
        folder: folder of the swing files of bounds.
        steering_effort: budget of each search of a steering; by default `SearchEffort()`.
        bound: effort, limits and further cars of each bound; by default a `BoundItem()`.
        step: step of the plant of the full car, s; None compares reduced cars alone.
        further: number of full runs with which each candidate is searched on, see `search_full`.

    Returns:
        A row per candidate, case, speed and aim: `plant`; `value`, which is NaN on the full car
        where no share of the angles counts; `reduced_value`; number of full `runs`; `share` of the
        angles, and the steering before it is applied; measures and all `settings` of the best full
        run. The share is NaN where the search on the full car found a better run.
    """
    effort = steering_effort or SearchEffort()
    chosen = [one for one in candidates if one not in BOUNDS]
    if NO_TAIL not in chosen:
        chosen.insert(0, NO_TAIL)
    if FOLDED not in chosen:
        chosen.append(FOLDED)
    places = [(case, speed, aim) for case in cases for speed in speeds for aim in aims]
    runs.stage = "steerings"
    descents = _search_steerings(chosen, places, effort, runs)
    runs.stage = "bounds"
    for one in BOUNDS:  # the second also starts from the first
        if one in candidates or ANNOUNCED in candidates:
            descents += _search_bounds(one, descents, bound or BoundItem(), runs, folder)
    for descent in descents:
        descent.step = step
    drive_shares(descents, runs)
    if further:
        searched = [one for one in descents if not one.candidate.is_at_full_lock]
        search_full(searched, further, runs, folder / "further", effort.seed)
    confirm_best(descents, runs)
    return make_frame([one.as_row() for one in descents])


def _search_steerings(
    candidates: Sequence[Candidate],
    places: Sequence[tuple[Case, float, str]],
    effort: SearchEffort,
    runs: CachedRunner,
) -> list[Descent]:
    """Searches the steering of each candidate in each case, except that of a driver at full lock. A
    law that reduced cars cannot follow takes that of the folded tail, and has no value on them.
    """
    descents = []
    items = []
    variants = []
    for case, speed, aim in places:
        for candidate in candidates:
            options = candidate_settings(candidate, case, speed)
            known = not candidate.law and reduced_car_knows(load_scenario(SWERVE, options[0]))
            searched = options if known else candidate_settings(FOLDED, case, speed)
            variants.append(options)
            own = None if candidate.is_at_full_lock else effort
            items.append(SteeringItem(searched, aim, own))
            descents.append(Descent(candidate, case, speed, aim, (), {}, borrows=not known))
    results = runs.map(best_steering, items, [item.key for item in items])
    for descent, options, result in zip(descents, variants, results, strict=True):
        descent.settings = options[min(result["variant"], len(options) - 1)]
        descent.result = result
    return descents


def _search_bounds(
    candidate: Candidate,
    descents: Sequence[Descent],
    bound: BoundItem,
    runs: CachedRunner,
    folder: Path,
) -> list[Descent]:
    """Searches a bound in each case, starting also from the motions of candidates with a tail."""
    folder.mkdir(parents=True, exist_ok=True)
    items = []
    places: dict[str, list[Descent]] = {}
    for one in descents:
        places.setdefault(one.stem, []).append(one)
    for stem, own in places.items():
        starts = []
        for one in own:
            known = not one.candidate.law and reduced_car_knows(load_scenario(SWERVE, one.settings))
            if known and one.has_tail and one.result["score"] > FAILED:
                starts.append((one.settings, tuple(one.result["steering"])))
        (settings,) = candidate_settings(candidate, own[0].case, own[0].speed)
        items.append(
            replace(
                bound,
                settings=settings,
                aim=own[0].aim,
                starts=tuple(starts),
                name="announced_" * (candidate is ANNOUNCED) + stem,
                announced=candidate is ANNOUNCED,
            )
        )
    results = runs.map(best_motion, items)
    bounds = []
    for (first, *_), item, result in zip(places.values(), items, results, strict=True):
        path = folder.resolve() / f"{item.name}.yaml"
        write_swing(swing_from_dict(result["swing"]), path, force=True)
        settings = (*item.settings, f"controller.swing_file={path}")
        bounds.append(
            Descent(
                candidate,
                first.case,
                first.speed,
                first.aim,
                settings,
                result,
                motion=path,
                limits=item.limits or (),
            )
        )
    return bounds
