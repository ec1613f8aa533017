"""Comparison of candidates in swerves: each with its own best steering, found on reduced cars, then
driven on the full car, its angles scaled to where the swerve just counts there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.limit_search import LimitSearch, run_rounds
from aerodima.optimisation.studies.runs import (
    FINE_STEP,
    CachedRunner,
    make_frame,
    scenario_content,
    step_settings,
)
from aerodima.optimisation.swerve.aims import FAILED, find_aim
from aerodima.optimisation.swerve.candidate import NO_TAIL, SWERVE, Candidate, Settings
from aerodima.optimisation.swerve.reduced_swerves import (
    SteeringItem,
    best_steering,
    reduced_car_knows,
)
from aerodima.optimisation.swerve.steering import STEERING_KEYS, SearchEffort, steering_settings
from aerodima.optimisation.swerve.suite import BOUND, FOLDED, Case
from aerodima.optimisation.swing.bound import BoundEffort, find_bound
from aerodima.optimisation.swing.solution import solution_swing
from aerodima.optimisation.swing.swerve_nlp import steering_of
from aerodima.workbench.batch.row_store import Row, content_key
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.swerve import swerve_of, swerve_row
from aerodima.workbench.control.user_law import in_words, load_law
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import swing_from_dict, write_swing

SHARE_SEARCH = LimitSearch("share of the angles", 0.4, 1.6, 0.1, 0.025)
"""Climb of the share of the angles with which the full car is driven: strides of a tenth from 1 on,
to either side, until the swerve counts no more, or first counts."""


@dataclass(frozen=True)
class BoundItem:
    """A search of a bound for one car.

    Attributes:
        settings: of the car.
        aim: name.
        effort: of the search.
        pitch, steering: of a tail that does not roll, from which it starts, too.
        name: of the swing that is made.
    """

    settings: Settings
    aim: str
    effort: BoundEffort
    pitch: float
    steering: tuple[float, ...]
    name: str


def best_motion(item: BoundItem) -> dict[str, Any]:
    """Returns score and steering of a bound, and its swing file as plain data."""
    scenario = load_scenario(SWERVE, item.settings)
    aim = find_aim(item.aim)
    still = [(item.pitch, np.array(item.steering))]
    bound = find_bound([scenario], aim, effort=item.effort, candidates=still)
    swing = solution_swing(item.name, item.settings, bound, item.aim)
    return {
        "score": float(bound.solution.aims[0]),
        "steering": steering_of(bound.program, bound.solution.x).tolist(),
        "variant": 0,
        "swing": swing.model_dump(mode="json", by_alias=True, exclude_none=True),
    }


class FullRun(NamedTuple):
    """A run of the full car: small enough to send to a worker.

    Attributes:
        settings: of the scenario `swerve`.
        aim: name, or function of a file.
        law: `FILE:CLASS` of the law that drives the tail instead of the scenario's; empty for that.
    """

    settings: Settings
    aim: str
    law: str = ""


def drive_full(run: FullRun) -> Row:
    """Returns aim and measures of a full run; one that cannot be made does not count, and has an
    error.
    """
    try:
        scenario = load_scenario(SWERVE, run.settings)
        law = load_law(run.law, scenario) if run.law else None
        log = simulate(scenario, record="outcome", stop_when_certain=True, law=law)
    except Exception as error:
        known = isinstance(error, (UserError, ArithmeticError, RuntimeError, ValueError))
        if not (known or run.law):
            raise
        return {"counts": False, "error": in_words(error)}
    swerve = swerve_of(log)
    return {**swerve_row(swerve), "value": float(find_aim(run.aim)(swerve)[0]), "error": ""}


@dataclass
class Descent:
    """One candidate in one case, at one speed, m/s, for one aim; its full runs, with a step of the
    plant (s), by share.
    """

    candidate: Candidate
    case: Case
    speed: float
    aim: str
    settings: Settings
    result: Mapping[str, Any]
    step: float = FINE_STEP
    rows: dict[float, Row] = field(default_factory=dict)

    def next_shares(self) -> list[float]:
        """Returns the next share of the angles; none at the end."""
        if self.result["score"] <= FAILED:
            return []
        if self.candidate.limit is not None:
            return [1.0] if not self.rows else []
        return SHARE_SEARCH.next_values(1.0, {one: row["counts"] for one, row in self.rows.items()})

    @property
    def best(self) -> tuple[float, Row] | None:
        """Share and run of the largest value among those that count, if any does."""
        counting = [(share, row) for share, row in self.rows.items() if row["counts"]]
        return max(counting, key=lambda run: run[1]["value"], default=None)

    def run(self, share: float) -> FullRun:
        """Returns the full run at a share of the angles."""
        steering = steering_settings(np.array(self.result["steering"]), share)
        settings = (*self.settings, *steering, *step_settings(self.step))
        return FullRun(settings, self.aim, self.candidate.law)

    def as_row(self) -> Row:
        """Returns the row of the table."""
        score = self.result["score"]
        row: Row = {
            "candidate": self.candidate.name,
            **self.case.names,
            "speed_m_per_s": self.speed,
            "aim": self.aim,
            "value": None,
            "reduced_value": score if score > FAILED else None,
            "share": None,
            "runs": len(self.rows),
            "variant": self.result["variant"],
            **dict(zip(STEERING_KEYS, self.result["steering"], strict=True)),
        }
        if self.best is None:
            return row
        share, run = self.best
        return row | run | {"share": share}


def compare_swerves(
    candidates: Sequence[Candidate],
    cases: Sequence[Case],
    speeds: Sequence[float],
    aims: Sequence[str],
    runs: CachedRunner,
    folder: Path,
    *,
    steering_effort: SearchEffort | None = None,
    bound_effort: BoundEffort | None = None,
    step: float = FINE_STEP,
) -> pd.DataFrame:
    """Compares candidates; the car without tail is always among them.

    Args:
        candidates: with their laws; `suite.BOUND` is the best motion of the tail.
        cases: cars with their tail and floor.
        speeds: m/s.
        aims: names of `AIMS`, or functions of a file, `mine.py:my_aim`.
        runs: where searches and runs are made, each once.
        folder: in which the swings of bounds are written.
        steering_effort, bound_effort: of the searches.
        step: of the plant of the full car, s.

    Returns:
        A row per candidate, case, speed and aim: `value` on the full car, NaN
        where it counts at no share of the angles; `reduced_value`; the `share`; the steering before
        that share; measures of the full run.
    """
    effort = steering_effort or SearchEffort()
    chosen = [one for one in candidates if one is not BOUND]
    if NO_TAIL not in chosen:
        chosen.insert(0, NO_TAIL)
    if FOLDED not in chosen:
        chosen.append(FOLDED)
    places = [(case, speed, aim) for case in cases for speed in speeds for aim in aims]
    runs.stage = "steerings"
    descents = _search_steerings(chosen, places, effort, runs)
    if BOUND in candidates:
        runs.stage = "bounds"
        descents += _search_bounds(descents, bound_effort or BoundEffort(), runs, folder)
    for descent in descents:
        descent.step = step
    drive_shares(descents, runs)
    return make_frame([one.as_row() for one in descents])


def drive_shares(descents: Sequence[Descent], runs: CachedRunner) -> None:
    """Drives full cars with smaller and larger angles, see `SHARE_SEARCH`."""
    runs.stage = "full cars"

    def drive(wanted: Sequence[tuple[Descent, float]]) -> list[Row]:
        items = [descent.run(share) for descent, share in wanted]
        return runs.map(drive_full, items, [_run_key(item) for item in items])

    run_rounds(
        descents,
        Descent.next_shares,
        drive,
        lambda descent, share, row: descent.rows.__setitem__(share, row),
    )


def _run_key(run: FullRun) -> str:
    """Returns the key of a cached full run; files of a law and an aim count by their content."""
    files = []
    for place in (run.law, run.aim):
        if ".py:" in place:
            path, _, name = place.rpartition(":")
            files += [name, Path(path).read_text(encoding="utf-8")]
    return content_key("full run", run.aim, *files, *scenario_content(SWERVE, run.settings))


def _search_steerings(
    candidates: Sequence[Candidate],
    places: Sequence[tuple[Case, float, str]],
    effort: SearchEffort,
    runs: CachedRunner,
) -> list[Descent]:
    """Searches the steering of each candidate in each case; a law that reduced cars cannot follow
    has that of the folded tail.
    """
    items = []
    variants = []
    for case, speed, aim in places:
        for candidate in candidates:
            options = candidate_settings(candidate, case, speed)
            known = not candidate.law and reduced_car_knows(load_scenario(SWERVE, options[0]))
            searched = options if known else candidate_settings(FOLDED, case, speed)
            variants.append(options)
            items.append(SteeringItem(searched, aim, effort, candidate.limit))
    results = runs.map(best_steering, items, [_key("steering", item) for item in items])
    descents = []
    index = 0
    for case, speed, aim in places:
        for candidate in candidates:
            result = results[index]
            options = variants[index]
            settings = options[min(result["variant"], len(options) - 1)]
            descents.append(Descent(candidate, case, speed, aim, settings, result))
            index += 1
    return descents


def _search_bounds(
    descents: Sequence[Descent], effort: BoundEffort, runs: CachedRunner, folder: Path
) -> list[Descent]:
    """Searches the bound in each case, from the steering of the folded tail, too."""
    folder.mkdir(parents=True, exist_ok=True)
    items = []
    still = [one for one in descents if one.candidate is FOLDED]
    for one in still:
        settings = (*one.case.settings(), *BOUND.settings, f"manoeuvre.speed={one.speed!r}")
        pitch = load_scenario(SWERVE, one.settings).feedback.pitch_angle
        stem = "_".join((*one.case.names.values(), f"{one.speed:g}", one.aim)).replace(" ", "")
        steering = tuple(one.result["steering"])
        items.append(BoundItem(settings, one.aim, effort, pitch, steering, stem))
    results = runs.map(best_motion, items, [_key("bound", item) for item in items])
    bounds = []
    for one, item, result in zip(still, items, results, strict=True):
        path = folder.resolve() / f"{item.name}.yaml"
        write_swing(swing_from_dict(result["swing"]), path, force=True)
        settings = (*item.settings, f"controller.swing_file={path}")
        bounds.append(Descent(BOUND, one.case, one.speed, one.aim, settings, result))
    return bounds


def candidate_settings(candidate: Candidate, case: Case, speed: float) -> tuple[Settings, ...]:
    """Returns the settings of a candidate's swerve, one for each place of its ballast."""
    base = case.settings()
    last = (*candidate.at(speed), f"manoeuvre.speed={speed!r}")
    if not candidate.ballasts:
        return ((*base, *last),)
    car = load_scenario(SWERVE, base)
    return tuple((*base, *last, *ballast(car)) for ballast in candidate.ballasts)


def _key(what: str, item: Any) -> str:
    """Returns the key of a cached search."""
    return content_key(what, repr(item), *scenario_content(SWERVE))
