"""Judge: how far candidates turn the cars of a task, each with the steering that is best for it.

The amplitude that turns the course furthest among the runs that count is searched at the ordinary step, proved at the
fine one, and lowered by a stated share until it counts there too. The steering is found on the car that is judged, as
a driver would; a motion is searched (`motion_search`) on training cars alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd

from aerodima.optimisation.sweep.runs import Runs, kept_runs, make_frame
from aerodima.optimisation.swing.candidate import NO_TAIL, THESIS, Candidate
from aerodima.optimisation.swing.task import CASE, Floor, SteeredTurn, Task, best_place, find_floors, search_steering
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import ProgressLine, silent
from aerodima.workbench.config.ensemble import Member

STEP_BACK, MOST_BACK = 2, 8
"""Places on the grid of the search by which the steering is lowered when the fine step does not bear it out, and how
often at most."""
SHOWN = (
    *("course_change_rad", "exit_heading_change_rad", "exit_time_s", "exit_speed_m_per_s", "exit_sideslip_rad"),
    *("average_linear_acceleration_m_per_s2", "peak_roll_rad", "two_wheel_time_s", "swing_trigger_time_s"),
)
"""Of the run that proves the steering."""


@dataclass(frozen=True)
class Judgement:
    """What was measured.

    Attributes:
        cases: a row per case and candidate.
        summary: medians and gains, a row per candidate over all cases, then over those of each speed and floor.
        candidates: in order.
        without_floor: cars and speeds that have no floor, since the published swing at full lock is clean on none.
    """

    cases: pd.DataFrame
    summary: pd.DataFrame
    candidates: tuple[Candidate, ...]
    without_floor: tuple[str, ...]


def judge(
    task: Task,
    candidates: Sequence[Candidate],
    out: Path,
    engine: Engine,
    *,
    force: bool = False,
    progress: ProgressLine = silent,
) -> Judgement:
    """Runs what the folder does not hold yet.

    Args:
        task: what is asked.
        candidates: of `read_candidates`; the car without tail is the reference.
        out: folder in which the runs are kept.
        engine: where to run.
        force: drop the runs that are there.
        progress: told lines.

    Raises:
        UserError: the folder is in use, or holds the runs of other parameters or versions; no case has a floor.
    """
    with kept_runs(out, engine, force=force, progress=progress) as runs:
        courses = Courses(task, runs)
        floors, without = courses.floors(task.test_cars)
        cases = courses.cases(candidates, floors)
    return Judgement(cases, summarise_cases(cases, candidates), tuple(candidates), tuple(without))


class Steering(NamedTuple):
    """An amplitude by its place on the grid, and the course that the search found, rad."""

    place: int
    course: float


@dataclass(frozen=True)
class Proof:
    """The steering of one candidate in one case.

    Attributes:
        found: what the search came to; None when nothing counted.
        proved: the place on the grid that the fine step bore out; None when none did.
        row: of that run; empty without.
    """

    found: Steering | None
    proved: int | None = None
    row: Mapping[str, Any] = field(default_factory=dict)


class Courses:
    """Measures the courses of a task; each run is made once."""

    def __init__(self, task: Task, runs: Runs) -> None:
        self._task, self._runs = task, runs

    def floors(self, cars: Sequence[Member]) -> tuple[list[Floor], list[str]]:
        """Floors of cars, speeds and shares, and who has none; SweepError when nobody has one."""
        self._runs.stage = "critical friction"
        return find_floors(self._task, cars, self._runs)

    def cases(self, candidates: Sequence[Candidate], floors: Sequence[Floor]) -> pd.DataFrame:
        """A row per floor and candidate, proved at the fine step."""
        turns = [(who, floor) for floor in floors for who in candidates]
        return make_frame([self._row(*turn, one) for turn, one in zip(turns, self._prove(turns), strict=True)])

    def _search(self, turns: Sequence[tuple[Candidate, Floor]]) -> list[Steering | None]:
        """The best steering of each turn."""

        def run(wanted: Sequence[tuple[int, int]]) -> list[float | None]:
            steered = [SteeredTurn(*turns[which], place) for which, place in wanted]
            rows = self._runs.rows([self._task.run(turn, self._task.step) for turn in steered])
            return [self._task.course(row) for row in rows]

        found = search_steering(self._task.search, len(turns), run)
        places = [best_place(tried) for tried in found]
        return [
            None if place is None else Steering(place, cast(float, tried[place]))
            for place, tried in zip(places, found, strict=True)
        ]

    def _prove(self, turns: Sequence[tuple[Candidate, Floor]]) -> list[Proof]:
        """The best steering of each turn, proved at the fine step."""
        task, runs = self._task, self._runs
        runs.stage = f"{task.pulse:g} s pulse"
        results = [Proof(found) for found in self._search(turns)]
        runs.stage += ", fine step"
        trying = {
            which: SteeredTurn(*turns[which], one.found.place)
            for which, one in enumerate(results)
            if one.found is not None
        }
        for _ in range(MOST_BACK + 1):
            coarse = runs.rows([task.run(turn, task.step) for turn in trying.values()])
            kept = [which for which, row in zip(trying, coarse, strict=True) if task.counts(row)]
            fine = runs.rows([task.run(trying[which], task.fine_step) for which in kept])
            for which, row in zip(kept, fine, strict=True):
                if task.counts(row):
                    results[which] = replace(results[which], proved=trying.pop(which).place, row=row)
            trying = {
                which: replace(turn, place=turn.place - STEP_BACK)
                for which, turn in trying.items()
                if turn.place >= STEP_BACK
            }
        return results

    def _row(self, who: Candidate, floor: Floor, proof: Proof) -> dict[str, Any]:
        found, proved = proof.found, proof.proved
        row: dict[str, Any] = {"candidate": who.name, "car": floor.car.name, "speed_m_per_s": floor.speed}
        row |= {"pulse_s": self._task.pulse, "floor": floor.share}
        row |= {"critical_friction": floor.critical, "friction": floor.friction}
        row |= {
            "steering_found_deg": math.nan if found is None else self._degrees(found.place),
            "steering_deg": math.nan if proved is None else self._degrees(proved),
        }
        return row | {name: _number(proof.row.get(name)) for name in SHOWN}

    def _degrees(self, place: int) -> float:
        return math.degrees(self._task.search.angle(place))


def gains(cases: pd.DataFrame, over: str) -> pd.DataFrame:
    """The cases with `gain` of the course over that of another candidate in the same case.

    A candidate without a run that counts has turned nothing: its gain is -1; without one of the other there is none.
    """
    value = "course_change_rad"
    other = cases[cases["candidate"] == over].set_index(CASE)[value].rename("other")
    joined = cases.join(other, on=CASE)
    ratio = joined[value].fillna(0.0) / joined["other"]
    return joined.assign(gain=np.where(joined["other"].isna(), np.nan, ratio - 1.0))


def summarise_cases(cases: pd.DataFrame, candidates: Sequence[Candidate]) -> pd.DataFrame:
    """A row per candidate over all cases, then over those of each speed and floor, with medians.

    The worst car is that of the lowest median over its own cases.
    """
    speeds, floors = (sorted(cases[name].unique()) for name in ("speed_m_per_s", "floor"))
    parts = {"all": cases["floor"] > 0.0}
    parts |= {f"{speed:g} m/s": cases["speed_m_per_s"] == speed for speed in speeds}
    parts |= {f"floor x {floor:g}": cases["floor"] == floor for floor in floors}
    gained = {"no_tail": gains(cases, NO_TAIL.name), "published": gains(cases, THESIS.name)}
    rows = []
    for part, inside in parts.items():
        for who in candidates:
            chosen = inside & (cases["candidate"] == who.name)
            own = cases[chosen]
            row: dict[str, Any] = {"cases": part, "candidate": who.name, "number": len(own)}
            row["without_a_turn_that_counts"] = int(own["course_change_rad"].isna().sum())
            row |= {f"median_{name}": float(own[name].median()) for name in ("steering_deg", *SHOWN[:4], *SHOWN[5:8])}
            for label, table in gained.items():
                mine = table[chosen]
                row[f"gain_over_{label}"] = float(mine["gain"].median())
                row[f"worst_car_over_{label}"] = float(mine.groupby("car")["gain"].median().min())
            rows.append(row)
    return make_frame(rows)


def middle_case(cases: pd.DataFrame) -> pd.DataFrame | None:
    """Rows of the case whose largest gain over the car without tail is in the middle; None where nobody gains.

    The lesser of two in the middle. Candidates without a turn that counts are left out.
    """
    table = cases.pivot_table(index=CASE, columns="candidate", values="course_change_rad", sort=False)
    if NO_TAIL.name not in table or table.shape[1] < 2:
        return None
    best = table.drop(columns=NO_TAIL.name).max(axis=1) / table[NO_TAIL.name]
    order = best.dropna().sort_values()
    if order.empty:
        return None
    key = order.index[(len(order) - 1) // 2]
    return cases.set_index(CASE).loc[[key]].reset_index().dropna(subset="course_change_rad")


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
