"""The short turn that the demo begins with: list and table go together, and the table comes out again."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from aerodima.optimisation.swing.candidate import HELD, NO_TAIL, THESIS, Candidate
from aerodima.optimisation.swing.task import Floor, SteeredTurn, Task
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import ScenarioError
from aerodima.workbench.metrics.turn_course import turn_course
from aerodima.workbench.report import short_turn
from aerodima.workbench.report.demo import plot_courses, short_turn_chapter
from aerodima.workbench.report.report_page import percent
from aerodima.workbench.report.short_turn import ShortTurn, load_short_turn, turn_of
from aerodima.workbench.simulate.simulation import simulate


@pytest.fixture(scope="module")
def table() -> ShortTurn:
    return load_short_turn()


def test_every_candidate_is_measured_in_every_case_on_test_cars(table: ShortTurn) -> None:
    entries = table.entries
    number = entries.test_cars * len(entries.speeds_m_per_s) * len(entries.floors)
    assert len(table.gains) == number
    assert set(table.cases["candidate"].value_counts()) == {number}
    test = load_ensemble(entries.ensemble).split(entries.seed).test[: entries.test_cars]
    assert set(table.cases["car"]) == {car.name for car in test}


def test_candidates_are_those_of_the_judge(table: ShortTurn) -> None:
    settings = {one.name: tuple(one.settings) for one in table.entries.candidates}
    assert settings["no_tail"] == NO_TAIL.settings
    assert settings["held"] == HELD.settings
    assert settings["published_swing"] == THESIS.settings


def test_the_case_that_is_shown_is_in_the_middle(table: ShortTurn) -> None:
    shown = table.gains[table.shown]
    below, above = (table.gains < shown).sum(), (table.gains > shown).sum()
    assert 0 <= above - below <= 1
    last, first = (table.row(table.entries.candidates[place].name)["course_change_rad"] for place in (-1, 0))
    assert shown == pytest.approx(last / first - 1.0)


@pytest.mark.parametrize("name", ["no_tail", "published_swing", "best_swing"])
def test_a_run_has_the_scenario_that_the_study_proved(table: ShortTurn, name: str) -> None:
    entries, row = table.entries, table.row(name)
    task = Task(scenario=entries.scenario)
    place = next(k for k in range(257) if math.isclose(math.degrees(task.search.angle(k)), row["steering_deg"]))
    car = next(member for member in load_ensemble(entries.ensemble).members if member.name == table.shown[0])
    floor = Floor(car, float(table.shown[1]), float(table.shown[2]), float(row["critical_friction"]))
    who = short_turn_candidate(table, name)
    run = task.run(SteeredTurn(who, floor, place), task.fine_step)
    assert table.scenario(name).resolved() == load_scenario(entries.scenario, run.settings).resolved()


def short_turn_candidate(table: ShortTurn, name: str) -> Candidate:
    return Candidate(name, tuple(next(one for one in table.entries.candidates if one.name == name).settings))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "place"), [("no_tail", 0), ("best_swing", -1)])
def test_two_cells_come_out_again(table: ShortTurn, name: str, place: int, tmp_path: Path) -> None:
    case = table.gains.index[place]
    row = table.cases.set_index(["candidate", "car", "speed_m_per_s", "floor"]).loc[(name, *case)]
    run = simulate(turn_of(table.entries, name, case, row["friction"], row["steering_deg"]), tmp_path / "run.parquet")
    course = turn_course(run)
    # The logs of a study are kept at the same rate; what is left is the order of sums on other processors.
    assert course.course_change_rad == pytest.approx(row["course_change_rad"], rel=1e-6)
    assert course.exit_time_s == pytest.approx(row["exit_time_s"], abs=1e-9)


@pytest.mark.slow
def test_chapter_has_the_replays_their_case_the_bars_and_the_gains(
    table: ShortTurn, standard_runs: dict[str, Any]
) -> None:
    who = table.entries.candidates
    logs = dict(zip((one.name for one in who), standard_runs.values(), strict=True))
    logs["held"] = replace(logs["held"], table=logs["held"].table.assign(tilt_truth_rad=2.0))
    shown, bars = short_turn_chapter(table, logs)
    replays, case = shown.parts
    names = [run["name"] for run in replays.values["runs"]]
    assert [name.split(":")[0] for name in names] == [one.words for one in who]
    assert names[1].endswith(": rolls over")
    assert dict(case.rows)["place of this gain"] == f"{(len(table.gains) + 1) // 2} of {len(table.gains)}"
    gains = bars.parts[1]
    assert [row[0] for row in gains.rows] == [one.words for one in who]
    assert gains.rows[0][3:] == ("+0 %", "+0 %")
    assert gains.rows[-1][3] == percent(table.gains.median())


def test_bars_are_the_medians(table: ShortTurn) -> None:
    (axes,) = plot_courses(table).axes
    medians = table.cases.groupby("candidate")["course_change_rad"].median()
    shown = [text.get_text() for text in axes.texts]
    assert shown == [f"{math.degrees(medians[one.name]):.1f}°" for one in reversed(table.entries.candidates)]


def test_a_table_of_other_candidates_is_refused(
    table: ShortTurn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "cases.csv"
    pd.DataFrame(table.cases[table.cases["candidate"] != "held"]).to_csv(other, index=False)
    real = short_turn.model_path
    monkeypatch.setattr(short_turn, "model_path", lambda name: other if name == short_turn.CASES else real(name))
    with pytest.raises(ScenarioError, match=r"has not the candidates of .*: no_tail, held"):
        load_short_turn()
