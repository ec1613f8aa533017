"""The benchmark: laws of the tail on fixed cars and floors, by how much further they turn the car than no tail.

`models/leaderboard` holds the cars, with the critical frictions that set their floors, and what our laws came to: cars
that no law of ours was trained or judged on. Measured is the course after a pulse of steering, each law with its own
best steering in each case (`corner_study`), so that a law that survives by not turning gains nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from aerodima.optimisation.studies.contestants import Contestant
from aerodima.optimisation.studies.corner_page import gains
from aerodima.optimisation.studies.corner_plan import CornerPlan, Floor
from aerodima.optimisation.studies.corner_study import CornerRuns
from aerodima.optimisation.studies.leaderboard_page import write_leaderboard
from aerodima.optimisation.studies.study_report import CONFIDENCE
from aerodima.optimisation.studies.study_store import open_runs
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RememberingEngine, RunEngine
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.batch.row_store import saying_how_to_go_on
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.checked_files import StrictModel, checked, read_yaml
from aerodima.workbench.config.ensemble import Member, Value
from aerodima.workbench.errors import SweepError
from aerodima.workbench.report.short_turn import load_entries
from aerodima.workbench.resources import model_path

SCHEMA = "aerodima/benchmark/1"
BENCHMARK, CASES = "leaderboard/benchmark.yaml", "leaderboard/cases.csv"
NO_TAIL, PUBLISHED = "no_tail", "published_swing"
"""Of our laws, those over which others gain."""
RESAMPLES, SEED = 10000, 1
"""Of the bootstrap."""


class BenchmarkCar(StrictModel):
    """A car as it differs from the parameter files, and the critical friction of the published swing at each speed."""

    name: str
    values: dict[str, Value]
    critical_friction: list[float]


class Benchmark(StrictModel):
    """The cases.

    Attributes:
        version: of cars, floors, speeds and pulse; scores of different versions do not compare.
        scenario: of the turn.
        made: how cars and frictions were come by.
        pulse_s: length of the steering.
        speeds_m_per_s: of the turns.
        floors: friction over the critical friction of the published swing at full lock.
        cars: of the benchmark.
    """

    schema_: str = Field(alias="schema")
    version: int
    scenario: str
    made: str
    pulse_s: float
    speeds_m_per_s: list[float] = Field(min_length=1)
    floors: list[float] = Field(min_length=1)
    cars: list[BenchmarkCar] = Field(min_length=1)

    @model_validator(mode="after")
    def _frictions_of_all_speeds(self) -> Benchmark:
        for car in self.cars:
            if len(car.critical_friction) != len(self.speeds_m_per_s):
                number = len(self.speeds_m_per_s)
                raise ValueError(f"{car.name}: critical_friction: allowed: one of each of {number} speeds")
        return self

    def cases(self) -> list[Floor]:
        """Car by car."""
        found = []
        for car in self.cars:
            member = Member(car.name, 1.0 / len(self.cars), dict(car.values))
            for speed, critical in zip(self.speeds_m_per_s, car.critical_friction, strict=True):
                found += [Floor(member, speed, share, critical) for share in self.floors]
        return found


@dataclass(frozen=True)
class Board:
    """What was measured.

    Attributes:
        cases: a row per case and law, ours among them.
        scores: a row per law, the best first.
        files: tables, then the page.
    """

    cases: pd.DataFrame
    scores: pd.DataFrame
    files: list[Path]


def load_benchmark() -> Benchmark:
    """The shipped one.

    Raises:
        UserError: a key is missing, unknown or of another kind.
    """
    path = model_path(BENCHMARK)
    return checked(Benchmark, read_yaml(path, SweepError), str(path), SweepError, schema=SCHEMA)


def make_leaderboard(
    out: Path, laws: Sequence[Contestant], engine: RunEngine, *, force: bool = False, progress: ProgressLine = silent
) -> Board:
    """Drives laws that the folder has no runs of yet, and puts them beside ours; writes tables and page.

    Args:
        out: folder; the runs are kept in its `runs.jsonl`.
        laws: one of ours by its name takes the place of its shipped rows.
        engine: where to run.
        force: drop the runs of other parameters or versions.
        progress: takes lines of text.

    Raises:
        UserError: a law has the name of one of ours and other settings; the folder is in use, or holds the runs of
            other parameters or versions.
    """
    refuse_taken_names(laws)
    benchmark, shipped = load_benchmark(), pd.read_csv(model_path(CASES))
    measured = pd.DataFrame(columns=shipped.columns)
    if laws:
        with open_runs(out, force=force) as store:
            remembering = RememberingEngine(engine, store, progress)
            with saying_how_to_go_on(progress, lambda: f"{len(store.rows)} runs"):
                measured = drive_cases(benchmark, laws, remembering)
            progress(f"{remembering.ran} runs made, the others were there")
    others = shipped[~shipped["contestant"].isin([law.name for law in laws])]
    cases = pd.concat([part for part in (others, measured) if len(part)], ignore_index=True)
    scores = score_laws(cases)
    return Board(cases, scores, write_leaderboard(out, cases, scores, _words(benchmark)))


def drive_cases(benchmark: Benchmark, laws: Sequence[Contestant], engine: RememberingEngine) -> pd.DataFrame:
    """A row per case and law."""
    speeds, floors = tuple(benchmark.speeds_m_per_s), tuple(benchmark.floors)
    plan = CornerPlan(benchmark.scenario, speeds, floors, pulses=(benchmark.pulse_s,))
    return CornerRuns(plan, engine).cases(laws, benchmark.cases())


def score_laws(cases: pd.DataFrame) -> pd.DataFrame:
    """A row per law, the largest median gain over no tail first.

    Intervals by bootstrap over the cars: drawn with replacement, each with all its cases. Cases in which no turn of the
    law counts are gains of -1.
    """
    gained = {"no_tail": gains(cases, NO_TAIL), "published": gains(cases, PUBLISHED)}
    rows = []
    for name in dict.fromkeys(cases["contestant"]):
        own = cases[cases["contestant"] == name]
        row = {"law": name, "cars": own["car"].nunique(), "cases": len(own)}
        row |= {"without_a_turn_that_counts": int(own["course_change_rad"].isna().sum())}
        row |= {f"median_{column}": float(own[column].median()) for column in ("course_change_rad", "exit_time_s")}
        for label, table in gained.items():
            mine = table[table["contestant"] == name]
            low, high = bootstrap_interval(mine)
            row[f"gain_over_{label}"] = float(mine["gain"].median())
            row |= {f"low_gain_over_{label}": low, f"high_gain_over_{label}": high}
            row[f"worst_car_over_{label}"] = float(mine.groupby("car")["gain"].median().min())
        rows.append(row)
    return make_frame(rows).sort_values("gain_over_no_tail", ascending=False, kind="stable", ignore_index=True)


def bootstrap_interval(gained: pd.DataFrame) -> tuple[float, float]:
    """Percentiles of the median gain over resampled cars.

    Args:
        gained: rows with `car` and `gain`, equally many of each car.
    """
    by_car: FloatArray = np.array([own["gain"].to_numpy(float) for _, own in gained.groupby("car")])
    drawn = np.random.default_rng(SEED).integers(len(by_car), size=(RESAMPLES, len(by_car)))
    medians = np.median(by_car[drawn].reshape(RESAMPLES, -1), axis=1)
    low, high = np.quantile(medians, [0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0])
    return float(low), float(high)


def refuse_taken_names(laws: Sequence[Contestant]) -> None:
    """Raises SweepError when two laws have one name, or a law that of one of ours with other settings."""
    ours = {one.name: tuple(one.settings) for one in load_entries().contestants}
    names = [law.name for law in laws]
    for law in laws:
        if names.count(law.name) > 1 or ours.get(law.name, law.settings) != law.settings:
            raise SweepError(f"law {law.name!r}: the name is taken; allowed: others than {', '.join(ours)}, each once")


def _words(benchmark: Benchmark) -> str:
    cars = ", ".join(car.name for car in benchmark.cars)
    speeds, floors = (", ".join(f"{v:g}" for v in values) for values in (benchmark.speeds_m_per_s, benchmark.floors))
    return (
        f"Benchmark version {benchmark.version}: scenario {benchmark.scenario}, cars {cars}, {speeds} m/s, floors "
        f"{floors} times the critical friction of the published swing at full lock, pulse {benchmark.pulse_s:g} s."
    )
