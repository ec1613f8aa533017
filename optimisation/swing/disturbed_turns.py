"""Turns with what may be otherwise than planned: who stays on the wheels and how far it still turns, in pairs.

All candidates of a car meet the same draws, each with the steering that it was given for the turn as planned, so that
a candidate and the published swing make a pair in each draw. Draws of one car are alike, and so are its floors: the
interval of the mean difference comes from drawing cars, and of each car its draws, again and again (a bootstrap of two
stages: Davison and Hinkley 1997, section 3.8). With few cars it is too narrow, since what differs from car to car is
then known from these few alone; with one car it holds for that car.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.candidates import THESIS, Candidate
from aerodima.optimisation.studies.corner_plan import ONE_LEVEL, Aim, CornerPlan, Floor, Run, counts
from aerodima.optimisation.studies.disturbances import (
    AIR_SHARE,
    DELAY,
    FRICTION_SHARE,
    LATE,
    LIMIT_SHARE,
    MISSED_SHARE,
    NOISE_FACTOR,
    SPEED_SHARE,
    TORQUE_SHARE,
    draw_disturbances,
)
from aerodima.optimisation.sweep.rollover_threshold import is_clean
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RunEngine, RunTask
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario

RESAMPLES = 4000
"""Draws of the bootstrap, of cars and of their runs."""
_SEED = 1
_CASE = ["car", "speed_m_per_s", "floor", "pulse_s"]


def drive_disturbed(
    plan: CornerPlan,
    cases: pd.DataFrame,
    candidates: Sequence[Candidate],
    members: Sequence[Member],
    task: Callable[[Run, float, tuple[float, float]], RunTask],
    engine: RunEngine,
) -> pd.DataFrame:
    """A row per disturbed run of each case whose steering was borne out; without `survived` where one came to nothing.

    Args:
        plan: of the cases.
        cases: a row per candidate and turn, with its steering.
        candidates, members: of the cases.
        task: makes the task of a turn as planned, with a step and the times steered and after that, s.
        engine: where to run.
    """
    who, cars = {one.name: one for one in candidates}, {member.name: member for member in members}
    heads, tasks = [], []
    for case in cases[cases["steering_deg"].notna()].to_dict("records"):
        floor = Floor(cars[case["car"]], case["speed_m_per_s"], case["floor"], case["critical_friction"])
        shape = (case.get("first_level", ONE_LEVEL[0]), case.get("first_level_time_s", ONE_LEVEL[1]))
        place = plan.search.place(math.radians(case["steering_deg"]))
        turn = task((who[case["candidate"]], floor, place, shape), plan.step, Aim(pulse=case["pulse_s"]).searching)
        planned = load_scenario(turn.scenario, turn.settings)
        for draw, given in enumerate(draw_disturbances(plan.disturbed, plan.seed, case["car"]), 1):
            head = {name: case[name] for name in ("candidate", *_CASE)} | {"draw": draw, **vars(given)}
            heads.append(head | {"missed": given.missed})
            tasks.append(replace(turn, settings=(*turn.settings, *given.settings(planned))))
    return make_frame([head | _result(row) for head, row in zip(heads, engine.rows(tasks), strict=True)])


def _result(row: Mapping[str, Any]) -> dict[str, Any]:
    """Of the row of a run; one that is not clean has turned nothing."""
    found = {name: row.get(name) for name in ("outcome", "peak_roll_rad", "exit_time_s", "swing_trigger_time_s")}
    found["error"] = row.get("error")
    if row["outcome"] is None:
        return found | dict.fromkeys(("survived", "counts", "course_change_rad"))
    clean = is_clean(row)
    course = float(row["course_change_rad"] or 0.0) if clean else 0.0
    return found | {"survived": float(clean), "counts": float(counts(row)), "course_change_rad": course}


def summarise_disturbed(runs: pd.DataFrame, candidates: Sequence[Candidate]) -> pd.DataFrame:
    """A row per candidate: shares and mean course of its runs, and the difference to the published swing in pairs.

    A run that is not clean has turned nothing. The differences are NaN without the published swing.
    """
    rows = []
    for who in candidates:
        own = runs[runs["candidate"] == who.name]
        ran = own[own["survived"].notna()]
        released, missed = (ran[ran["missed"].astype(bool) == one] for one in (False, True))
        row: dict[str, Any] = {"candidate": who.name, "cases": len(own.groupby(_CASE)), "runs": len(ran)}
        row |= {"failed": len(own) - len(ran), "survived": ran["survived"].mean(), "counted": ran["counts"].mean()}
        row |= {"released_survived": released["survived"].mean(), "missed_survived": missed["survived"].mean()}
        row["mean_course_rad"] = ran["course_change_rad"].mean()
        for name, value in (("survived", "survived"), ("course", "course_change_rad")):
            mean, low, high = paired_difference(paired_by_car(runs, who.name, THESIS.name, value))
            row |= {f"{name}_difference": mean, f"{name}_low": low, f"{name}_high": high}
        rows.append(row)
    return make_frame(rows)


def paired_by_car(runs: pd.DataFrame, one: str, other: str, value: str) -> list[FloatArray]:
    """Difference of a value between two candidates, of each car the means (draws,) over its other cases.

    Cases in which one of them has no steering make no pair.
    """
    tables = [
        runs[runs["candidate"] == name].set_index([*_CASE, "draw"])[value].astype(float) for name in (one, other)
    ]
    gap = (tables[0] - tables[1]).dropna()
    draws = gap.groupby(level=["car", "draw"]).mean()
    return [np.asarray(part, dtype=np.float64) for _, part in draws.groupby(level="car")]


def paired_difference(cars: Sequence[FloatArray]) -> tuple[float, float, float]:
    """Mean over the cars, and its 95 % interval; NaN without a pair.

    Args:
        cars: differences of each, in the unit of what they are of.
    """
    if not cars:
        return np.nan, np.nan, np.nan
    rng = np.random.default_rng(_SEED)
    number = len(cars)
    found = np.zeros(RESAMPLES)
    for _ in cars:
        drawn = rng.integers(number, size=RESAMPLES)
        for which, car in enumerate(cars):
            own = drawn == which
            draws = rng.integers(car.size, size=(np.count_nonzero(own), car.size))
            found[own] += car[draws].mean(axis=1) / number
    low, high = np.quantile(found, [0.025, 0.975])
    return float(np.mean([car.mean() for car in cars])), float(low), float(high)


COLUMNS = {
    "candidate": "candidate",
    "cases": "cases",
    "runs": "runs",
    "survived": "survived",
    "survived_difference": "over published [95 %]",
    "released_survived": "where the tail swung",
    "missed_survived": "where it missed",
    "counted": "a turn that counts",
    "mean_course_rad": "mean course [deg]",
    "course_difference": "over published [deg, 95 %]",
}
"""Of the summary, with the words of page and terminal."""


def survival_cells(survival: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the summary."""
    return list(COLUMNS.values()), [[_cell(name, row) for name in COLUMNS] for row in survival.to_dict("records")]


def disturbed_words(runs: pd.DataFrame) -> str:
    """What was disturbed and how survival is counted."""
    draws, cars = int(runs["draw"].max()), runs["car"].nunique()
    return (
        f"{draws} draws for each of {cars} cars, the same for all candidates, each with the steering of the turn as "
        f"planned, at the step of the search: force of the air +-{AIR_SHARE:.0%}, friction +-{FRICTION_SHARE:.0%}, "
        f"speed +-{SPEED_SHARE:.0%}, torque +-{TORQUE_SHARE:.0%} and its limit up to {LIMIT_SHARE:.0%} less, IMU up to "
        f"{1000 * DELAY:g} ms later and up to {NOISE_FACTOR:g} times as noisy, swing up to {1000 * LATE:g} ms after "
        f"its release; {MISSED_SHARE:.0%} of the draws miss the release. Survived: nothing but the wheels touches the "
        "ground. A turn that counts also keeps to the limits of roll and sideslip, which the steering was made to use "
        "up. A run that is not clean has turned nothing. Differences in pairs of the same draw; intervals from drawing "
        "cars, and of each its draws, again and again: with few cars they are too narrow."
    )


def _cell(name: str, row: Mapping[Any, Any]) -> str:
    value = row[name]
    if isinstance(value, str):
        return value
    if value != value or (name.endswith("_difference") and row["candidate"] == THESIS.name):
        return "-"
    if name in ("cases", "runs"):
        return f"{value:.0f}"
    if name.endswith("_difference"):
        ends = [row[name.replace("_difference", end)] for end in ("_low", "_high")]
        scale, digits = (100.0, 0) if name.startswith("survived") else (180.0 / np.pi, 1)
        unit = " %" if name.startswith("survived") else ""
        low, high = (f"{scale * end:+.{digits}f}" for end in ends)
        return f"{scale * value:+.{digits}f}{unit} [{low}, {high}]"
    return f"{np.degrees(value):.1f}" if name.endswith("_rad") else f"{value:.0%}"
