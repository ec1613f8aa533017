"""Full-model refinement: CMA-ES over the release and the shape of a swing, with the criterion that counts.

A swing counts by the highest tyre friction that the full car survives clean, and only if the turn stays the turn: at
the highest friction that the published swing survives as well, the heading change must be at least 95 % of that
swing's (design section 10). A reduced model is driven by the yaw motion of a run and cannot know this; so the changes
of `swing_construction` are searched on the full car itself, ranked as `swing_ranking` says. The target friction rises
whenever the best candidate is clean at it. The search runs at the scenario's step; the last candidates to reach a
target are then driven at the fine step over an unbroken row of frictions, and what is best there is what is claimed
(`swing_ranking.choose`). With several cars all of them must survive and turn.

A generation is the best tenth of what is drawn, by rank on reduced cars (`swing_screening`) where they know the swing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from aerodima.optimisation.sweep.study_engine import RunEngine, SerialRunEngine
from aerodima.optimisation.swing.full_car import FINE_STEP, FRICTION_STEP, SPIN, Car
from aerodima.optimisation.swing.search_state import SearchOptions, open_rows, saying_the_limit
from aerodima.optimisation.swing.swing_construction import changed, changes
from aerodima.optimisation.swing.swing_ranking import Candidate, Score, choose, score
from aerodima.optimisation.swing.swing_screening import DRAWN, SwingScreen
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.batch.row_store import Row, RowStore, content_key
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.config.swing_curve import swing_at
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.errors import SwingError, SwingFileError
from aerodima.workbench.plants.clearance import RangeOfMotion, make_range_of_motion

CLEARANCE = 0.01
"""Least distance of the tail's planned path from the car, m."""
FIRST_SPREAD, CLOSE_SPREAD = 0.6, 0.3
"""Of the first generation, in units of the changes; the second for a swing that was refined before."""
FIRST_PITCH = (0.5, 0.5, 0.5, 0.4, 0.2, 0.0)
"""Pitch that a refinement with two joints begins with, in units of the change: forwards, which loads the front axle."""
WIDEST = 4.0
"""Largest change, in its unit."""
PATIENCE, NARROWER = 2, 0.4
"""Generations without a better candidate after which the search begins again around the best one, narrower by this."""


@dataclass(frozen=True)
class Refined:
    """What came of a refinement.

    Attributes:
        x: the changes; zeros are the swing that was given.
        friction: highest target that was survived clean with enough heading; 0 if none was.
        heading: share of the reference's at the common friction.
        peak_roll: at `friction`, rad.
        evaluations: candidates that were driven.
        earlier: changes of the best candidates before, the last one first.
        gaining: the last generation still had a better candidate when the candidates were used up.
    """

    x: FloatArray
    friction: float = 0.0
    heading: float = math.nan
    peak_roll: float = math.inf
    evaluations: int = 0
    earlier: tuple[FloatArray, ...] = ()
    gaining: bool = False


def refine(
    swing: SwingFile,
    cars: Sequence[Car],
    *,
    evaluations: int,
    seed: int,
    dof: int = 1,
    target: float | None = None,
    begin: FloatArray | None = None,
    sigma: float = FIRST_SPREAD,
    screen: SwingScreen | None = None,
    engine: RunEngine | None = None,
    store: RowStore | None = None,
    progress: ProgressLine = silent,
) -> Refined:
    """Searches for the changes of a swing with which the car survives most friction and still turns.

    Args:
        swing: to begin with.
        cars: that must survive the turn with it; the path of the tail is kept free of the first one.
        evaluations: how many candidates at most; whole generations are driven.
        seed: of CMA-ES; the same seed tries the same candidates.
        dof: 2 moves pitch too, and keeps the tail free of the car.
        target: first friction aimed at with the first car; by default that of its reference.
        begin: changes to begin with; by default none, or `FIRST_PITCH` with two joints.
        sigma: of the first generation, in units of the changes.
        screen: reduced cars that choose a tenth of what is drawn; None drives all that is drawn.
        engine: where the cars are driven.
        store: of scores of searches with the same swing and cars: what it holds is not driven again.
        progress: takes lines of text.

    Raises:
        SwingError: the package `cma` is not there.
    """
    cma = _cma()
    engine = engine or SerialRunEngine()
    generator = np.random.default_rng(seed)
    first = np.zeros(changes(dof))
    if begin is not None:
        first = np.array(begin, float)
    elif dof == 2:
        first[-len(FIRST_PITCH) :] = FIRST_PITCH
    # No global state: the random numbers come from `generator` alone.
    options = {"seed": np.nan, "randn": lambda *shape: generator.standard_normal(shape), "verbose": -9}
    options |= {"bounds": [-WIDEST, WIDEST]}
    search = cma.CMAEvolutionStrategy(first, sigma, options)
    aim = cars[0].reference.friction if target is None else target
    free_of = make_range_of_motion(scenario_from_dict(cars[0].scenario)) if dof == 2 else None
    scores: list[Score] = []

    rows: dict[str, Row] = {} if store is None else store.rows

    def tried(points: Sequence[FloatArray], headings: tuple[float, ...] = ()) -> list[Score]:
        candidates = [Candidate(_allowed(swing, x, dof, free_of), tuple(cars), aim, headings) for x in points]
        keys = [content_key(one.swing and one.swing.model_dump(mode="json"), aim, headings) for one in candidates]
        missing = {key: one for key, one in zip(keys, candidates, strict=True) if key not in rows}
        for key, one in zip(missing, engine.call(score, list(missing.values())), strict=True):
            rows[key] = asdict(one)
            if store is not None:
                store.add(key, rows[key])
        found = [Score(**(rows[key] | {"headings": tuple(rows[key]["headings"])})) for key in keys]
        scores.extend(found)
        return found

    best, idle = Refined(first), 1
    while len(scores) < evaluations and not search.stop():
        points = _best_drawn(search, screen, lambda x: _allowed(swing, x, dof, free_of), aim)
        found = tried(points)
        search.tell(points, [one.cost for one in found])
        leader = int(np.argmin([one.cost for one in found]))
        point, one = np.array(points[leader]), found[leader]
        idle = 0 if one.clean else idle + 1
        if one.clean and best.friction:
            best = replace(best, earlier=(best.x, *best.earlier))
        while one.clean:
            best = Refined(point, aim, one.heading, one.peak_roll, earlier=best.earlier)
            progress(
                f"  {len(scores)} candidates: clean at friction {aim:.4f}, heading {one.heading:.1%} of the published"
            )
            aim += FRICTION_STEP
            (one,) = tried([point], one.headings)
        progress(f"  {len(scores)} candidates: rank {one.cost:.3f} at friction {aim:.4f}, heading {one.heading:.1%}")
        if best.friction and idle >= PATIENCE:
            sigma, idle = NARROWER * sigma, 0
            search = cma.CMAEvolutionStrategy(best.x, sigma, options)
    return replace(best, evaluations=len(scores), gaining=idle == 0)


def refined(
    swing: SwingFile,
    scenarios: Sequence[Scenario],
    options: SearchOptions,
    *,
    engine: RunEngine | None = None,
    checkpoint: Path | None = None,
    progress: ProgressLine = silent,
) -> SwingFile:
    """A swing after its refinement, with what was found in its provenance; the same swing if nothing better was found.

    Args:
        swing: to begin with.
        scenarios: cars and their turn, as published but for speed and car; the first is the swing's own.
        options: of the search; `polish`, `seed` and `dof` are used.
        engine: where the cars are driven.
        checkpoint: of the search; candidates are kept beside it until the refinement is over.
        progress: takes lines of text.
    """
    engine = engine or SerialRunEngine()
    cars = _comparable(engine.call(Car.of, scenarios), progress)
    spread = FIRST_SPREAD if options.rounds else CLOSE_SPREAD
    begun = swing.model_dump(mode="json", include={"knots", "trigger", "gains", "limits"})
    identity: dict[str, Any] = {"swing": begun, "cars": [asdict(car) for car in cars]}
    identity |= {"seed": options.seed, "dof": options.dof, "spread": spread}
    little = np.eye(changes(options.dof))[-1] * 0.01
    screen = SwingScreen.of(cars, changed(swing, little, options.dof), progress)
    with open_rows(checkpoint and checkpoint.with_suffix(".polish.json"), "aerodima/polish/2", identity) as store:
        found = refine(
            swing, cars, evaluations=options.polish, seed=options.seed, dof=options.dof, sigma=spread, engine=engine,
            screen=screen, store=store, progress=progress,
        )  # fmt: skip
        if store is not None:
            store.remove()
    if not found.friction:
        progress("refinement: no candidate turns far enough and stays clean: kept the swing as it was")
        return swing
    points = (found.x, *found.earlier)
    shaped = [changed(swing, x, options.dof) for x in points]
    claim = choose(shaped, cars, found.friction, engine=engine, progress=progress)
    if claim is None:
        progress("refinement: no candidate turns far enough at the fine step: kept the swing as it was")
        return swing
    facts = {
        "polish_changes": " ".join(f"{value:.9g}" for value in points[claim.place]),
        "polish_candidates": found.evaluations,
        "fine_step_s": FINE_STEP,
        "reference_friction": round(claim.references[0].friction, 6),
        "heading_ratio": round(claim.heading, 6),
        "survived_friction": round(claim.rows[0].friction, 6),
        "peak_roll_rad": round(claim.peak_roll, 6),
    }
    if len(cars) > 1:
        facts["gain_by_car"] = " ".join(f"{gain - 1.0:+.4f}" for gain in claim.gains)
    best = shaped[claim.place]
    kept = {key: value for key, value in best.provenance.found.items() if key != "heading_rad"}  # before the refinement
    provenance = best.provenance.model_copy(update={"found": kept | facts})
    limit = f"{found.evaluations} candidates of the refinement" if found.gaining else ""
    return saying_the_limit(best.model_copy(update={"provenance": provenance}), limit)


def _best_drawn(
    search: Any, screen: SwingScreen | None, shaped: Callable[[FloatArray], SwingFile | None], aim: float
) -> list[FloatArray]:
    """A generation of CMA-ES: the best tenth on reduced cars of ten times as many points, in their order."""
    if screen is None:
        return list(search.ask())
    drawn = search.ask(DRAWN * search.popsize)
    swings = {place: one for place, x in enumerate(drawn) if (one := shaped(x)) is not None}
    costs = np.full(len(drawn), math.inf)
    costs[list(swings)] = screen.costs(list(swings.values()), aim) if swings else []
    return [drawn[place] for place in sorted(np.argsort(costs, kind="stable")[: search.popsize].tolist())]


def _comparable(cars: Sequence[Car], progress: ProgressLine) -> list[Car]:
    """The first car, and those of the others that turn with the published swing and do not spin."""
    kept = []
    for number, car in enumerate(cars, start=1):
        one = car.reference
        spins = number > 1 and one.heading > SPIN
        progress(
            f"refinement, car {number}: the published swing is clean to friction {one.friction:.4f}, turns "
            f"{one.heading:.3f} rad{', which is a spin: left out' if spins else ''}"
        )
        if not spins:
            kept.append(car)
    return kept


def _allowed(swing: SwingFile, x: FloatArray, dof: int, free_of: RangeOfMotion | None) -> SwingFile | None:
    """The changed swing; None when it leaves its limits or its tail comes too close to the car."""
    try:
        moved = changed(swing, x, dof)
    except SwingFileError:
        return None
    if free_of is not None:
        point = swing_at(moved, np.linspace(0.0, moved.knots.time_s[-1], 201))
        clear = free_of.clearance(point.pitch_position, point.roll_position, ("cage", "deck", "wheels"))
        if float(np.min(clear)) < CLEARANCE:
            return None
    return moved


def _cma() -> Any:
    try:
        import cma  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise SwingError(
            "--refine: needs the package cma, which is not installed; allowed: pip install "
            "'aerodima-workbench[optimise]', or no refinement"
        ) from None
    return cma
