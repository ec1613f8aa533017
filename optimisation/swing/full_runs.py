"""Runs of the full car in a comparison: its steering is scaled to where the swerve just counts."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import starmap
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from aerodima.optimisation.studies.limit_search import LimitSearch, run_rounds
from aerodima.optimisation.studies.runs import (
    FINE_STEP,
    RUN_ERRORS,
    CachedRunner,
    code_content,
    scenario_content,
    step_settings,
)
from aerodima.optimisation.swerve.aims import FAILED, find_aim
from aerodima.optimisation.swerve.candidate import SWERVE, Candidate
from aerodima.optimisation.swerve.steering import (
    STEERING_KEYS,
    scaled_steering,
    steering_settings,
)
from aerodima.optimisation.swerve.suite import Case
from aerodima.optimisation.swing.swerve_shooting import read_limits
from aerodima.workbench.batch.row_store import Row, content_key
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.swerve import Swerve, swerve_of, swerve_row
from aerodima.workbench.control.user_law import in_words, load_law
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.scenario.scenario import load_scenario

SHARE_SEARCH = LimitSearch(low=0.4, high=1.6, stride=0.1, tolerance=0.025)
"""Search of the share of the angles with which the full car is driven: strides of a tenth from 1,
up until the swerve no longer counts, or down until it first counts, then the last stride halved."""

CLIMB_STEP = 0.002
"""Step of the plant, s, at which steerings are scaled and searched. At a finer one only the best
run of each candidate is driven, with smaller angles until it also counts there."""
CONFIRM_SEARCH = LimitSearch(low=0.4, high=1.0, stride=0.1, tolerance=0.025)
"""Search of the share of the best run's angles at the finer step: all of them, and smaller ones
where the swerve does not count with these."""


class FullRun(NamedTuple):
    """A run of the full car, small enough to send to a worker.

    Attributes:
        settings: overrides of the scenario `swerve`.
        aim: name of the aim, or function of a file, `mine.py:my_aim`.
        law: `FILE:CLASS` of the law that drives the tail; empty for that of the scenario.
        limits: limits that the run must keep, such as `roll=0.3`, see `LIMITS`.
    """

    settings: Settings
    aim: str
    law: str = ""
    limits: tuple[str, ...] = ()


def drive_full(run: FullRun) -> Row:
    """Returns aim and measures of a full run. It does not count if its aim is not finite or it
    breaks a limit, nor if it cannot be made; `error` then says why it cannot.
    """
    try:
        swerve = full_swerve(run)
    except Exception as error:
        if not (run.law or isinstance(error, RUN_ERRORS)):
            raise
        return {"counts": False, "error": in_words(error)}
    row = swerve_row(swerve)
    value = float(find_aim(run.aim)(swerve)[0])
    is_kept = isfinite(value) and all(one.is_kept(swerve) for one in read_limits(run.limits))
    return row | {"counts": row["counts"] and is_kept, "value": value, "error": ""}


def full_swerve(run: FullRun) -> Swerve:
    """Returns the swerve of a full run."""
    scenario = load_scenario(SWERVE, run.settings)
    law = load_law(run.law, scenario) if run.law else None
    return swerve_of(simulate(scenario, record="outcome", stop_when_certain=True, law=law))


def run_key(run: FullRun) -> str:
    """Returns the key of a cached full run, with the content of the files of its law and aim."""
    files = code_content(run.law, run.aim)
    content = scenario_content(SWERVE, run.settings)
    return content_key("full run", run.aim, run.limits, *files, *content)


@dataclass
class Descent:
    """One candidate in one case, at one speed, for one aim, on its way from the reduced car to the
    full car.

    Attributes:
        candidate: candidate that is driven.
        case: car, tail and floor.
        speed: speed of the swerve, m/s.
        aim: name of the aim, or function of a file, `mine.py:my_aim`.
        settings: settings of the car, without the steering.
        result: score, steering and variant of the search on the reduced car.
        borrows: whether that is the result of another candidate, which the reduced car can follow.
        step: step of the plant of the full car in the table, s; None for the reduced car alone.
        motion: file of the candidate's motion, which a search on the full car may vary.
        limits: limits of the full runs, beside those of every swerve.
        rows: results of full runs, by share of the angles.
        further: number of full runs of a search on the full car, and of dropped confirmations.
        found: best run of that search, in the form of `best_run`; None if none that counts is
            above the best of `rows`.
        confirmed: results of runs at a step finer than `CLIMB_STEP`, by share of the best run's
            angles.
    """

    candidate: Candidate
    case: Case
    speed: float
    aim: str
    settings: Settings
    result: Mapping[str, Any]
    borrows: bool = False
    step: float | None = FINE_STEP
    motion: Path | None = None
    limits: tuple[str, ...] = ()
    rows: dict[float, Row] = field(default_factory=dict)
    further: int = 0
    found: tuple[FullRun, Row, None] | None = None
    confirmed: dict[float, Row] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """Case, speed and aim in the name of a file, the same for all candidates."""
        words = (*self.case.names.values(), f"{self.speed:g}", Path(self.aim).name)
        return "_".join(words).replace(" ", "").replace(":", "_")

    @property
    def has_tail(self) -> bool:
        """Whether the car has a tail."""
        return load_scenario(SWERVE, self.settings).has_tail

    @property
    def max_angle(self) -> float:
        """Largest angle of the wheels, rad."""
        return load_scenario(SWERVE, self.settings).servo.limit

    def next_shares(self) -> list[float]:
        """Returns the next share of the angles; none at the end."""
        if self.step is None:
            return []
        if self.candidate.is_at_full_lock:
            return [] if self.rows else [1.0]
        if self.result["score"] <= FAILED:
            return []
        return SHARE_SEARCH.next_values(1.0, {one: row["counts"] for one, row in self.rows.items()})

    @property
    def best(self) -> tuple[float, Row] | None:
        """Share and row of the run with the largest value among those that count; None if none
        does. The one run of a driver at full lock is taken in any case where the table has a finer
        step, at which it then counts or not.
        """
        if self.candidate.is_at_full_lock and self.has_finer_step:
            return next(iter(self.rows.items()), None)
        return best_counting(self.rows)

    def run(self, share: float) -> FullRun:
        """Returns the full run at a share of the angles, clipped to the limit of the wheels."""
        steering = scaled_steering(np.array(self.result["steering"]), share, self.max_angle)
        return self.run_with((*self.settings, *steering_settings(steering)))

    def run_with(self, settings: Settings) -> FullRun:
        """Returns the full run with settings of the car and of the steering."""
        step = step_settings(max(self.step or FINE_STEP, CLIMB_STEP))
        return FullRun((*settings, *step), self.aim, self.candidate.law, self.limits)

    @property
    def best_run(self) -> tuple[FullRun, Row, float | None] | None:
        """Best run of all, its row, and its share of the angles (None for a run of a search on the
        full car); None if there is no such run.
        """
        if self.found is not None or self.best is None:
            return self.found
        share, row = self.best
        return self.run(share), row, share

    @property
    def has_finer_step(self) -> bool:
        """Whether the table has a step finer than `CLIMB_STEP`."""
        return self.step is not None and self.step < CLIMB_STEP

    def next_confirmations(self) -> list[float]:
        """Returns the next share of the best run's angles at the finer step; none at the end."""
        is_driven = self.confirmed and self.candidate.is_at_full_lock
        if is_driven or self.best_run is None or not self.has_finer_step:
            return []
        return CONFIRM_SEARCH.next_values(
            1.0, {one: row["counts"] for one, row in self.confirmed.items()}
        )

    def confirming_run(self, share: float) -> FullRun:
        """Returns the best run at the finer step, with a share of its angles."""
        assert self.best_run is not None
        run = self.best_run[0]
        manoeuvre = load_scenario(SWERVE, run.settings).manoeuvre
        keys = STEERING_KEYS[: len(self.result["steering"])]
        steering = np.array([getattr(manoeuvre, key) for key in keys])
        angles = steering_settings(scaled_steering(steering, share))
        replaced = ("manoeuvre.level_", "manoeuvre.trim", *step_settings(CLIMB_STEP))
        kept = [setting for setting in run.settings if not setting.startswith(replaced)]
        return run._replace(settings=(*kept, *angles, *step_settings(self.step or FINE_STEP)))

    def final_run(self) -> tuple[FullRun, Row, float | None] | None:
        """Returns the run of the table, in the form of `best_run`; None where nothing counts."""
        if self.best_run is None or not self.has_finer_step:
            return self.best_run
        confirmed = best_counting(self.confirmed)
        if confirmed is None:
            return None
        factor, row = confirmed
        share = self.best_run[2]
        return self.confirming_run(factor), row, share and share * factor

    @property
    def value(self) -> float:
        """Aim of the best run; minus infinity where there is none."""
        return self.best_run[1]["value"] if self.best_run else -np.inf

    @property
    def final_value(self) -> float:
        """Aim of the run of the table; minus infinity where nothing counts."""
        final = self.final_run()
        return final[1]["value"] if final else -np.inf

    def improve(self, runs: Sequence[FullRun], rows: Sequence[Row]) -> int | None:
        """Takes the best of further runs that counts, if its value is the largest so far; returns
        its index, else None.
        """
        self.further += len(runs)
        values = [row["value"] if row["counts"] else -np.inf for row in rows]
        index = int(np.argmax(values))
        if values[index] <= self.value:
            return None
        self.found = runs[index], rows[index], None
        return index

    def as_row(self) -> Row:
        """Returns the row of the table."""
        score = self.result["score"]
        reduced = None if self.borrows or score <= FAILED else score
        row: Row = {
            "plant": "reduced" if self.step is None else "full",
            "candidate": self.candidate.name,
            **self.case.names,
            "speed_m_per_s": self.speed,
            "aim": self.aim,
            "value": reduced if self.step is None else None,
            "reduced_value": reduced,
            "share": None,
            "runs": len(self.rows) + self.further + len(self.confirmed),
            "variant": self.result["variant"],
            **dict(zip(STEERING_KEYS, self.result["steering"], strict=False)),
            "settings": "",
        }
        final = self.final_run()
        if final is None:
            return row
        run, result, share = final
        return row | result | {"share": share, "settings": json.dumps(run.settings)}


def best_counting(rows: Mapping[float, Row]) -> tuple[float, Row] | None:
    """Returns share and row of the largest value among runs that count; None if none does."""
    counting = [(share, row) for share, row in rows.items() if row["counts"]]
    return max(counting, key=lambda run: run[1]["value"], default=None)


def drive_shares(descents: Sequence[Descent], runs: CachedRunner) -> None:
    """Drives full cars with smaller and larger angles, see `SHARE_SEARCH`."""
    runs.stage = "full cars"
    run_rounds(
        descents,
        Descent.next_shares,
        lambda wanted: drive_items([*starmap(Descent.run, wanted)], runs),
        lambda one: one.rows,
    )


def confirm_best(descents: Sequence[Descent], runs: CachedRunner) -> None:
    """Drives the best run of each descent at the step of the table. Where a run that a search on
    the full car found does not count there with all its angles, the best one before that search is
    also driven, and the better of the two is kept.
    """
    runs.stage = "full cars at the finer step"
    finer = [one for one in descents if one.has_finer_step]
    _confirm(finer, runs)
    doubtful = [one for one in finer if one.found and not one.confirmed[1.0]["counts"]]
    climbed = [replace(one, found=None, confirmed={}) for one in doubtful]
    _confirm(climbed, runs)
    for one, before in zip(doubtful, climbed, strict=True):
        if before.final_value > one.final_value:
            one.found = None
            one.confirmed, before.confirmed = before.confirmed, one.confirmed
        one.further += len(before.confirmed)


def _confirm(descents: Sequence[Descent], runs: CachedRunner) -> None:
    """Drives the best run of each descent at the finer step, see `CONFIRM_SEARCH`."""
    run_rounds(
        descents,
        Descent.next_confirmations,
        lambda wanted: drive_items([*starmap(Descent.confirming_run, wanted)], runs),
        lambda one: one.confirmed,
    )


def drive_items(items: Sequence[FullRun], runs: CachedRunner) -> list[Row]:
    """Makes full runs, each once."""
    return runs.map(drive_full, items, [run_key(item) for item in items])
