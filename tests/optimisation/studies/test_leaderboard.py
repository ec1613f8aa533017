"""The benchmark: its fixed cars, the shipped table, the score on made-up cars, and a cell that comes out again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.studies import leaderboard
from aerodima.optimisation.studies.contestants import HELD, THESIS, Contestant
from aerodima.optimisation.studies.corner_floors import turn_settings
from aerodima.optimisation.studies.corner_plan import CornerPlan, counts
from aerodima.optimisation.studies.law_files import read_laws
from aerodima.optimisation.studies.leaderboard import (
    CASES,
    NO_TAIL,
    PUBLISHED,
    Benchmark,
    bootstrap_interval,
    load_benchmark,
    make_leaderboard,
    score_laws,
)
from aerodima.optimisation.sweep.study_engine import RunTask, evaluate
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.swing_file import read_swing, write_swing
from aerodima.workbench.errors import UserError
from aerodima.workbench.report.short_turn import load_entries
from aerodima.workbench.resources import model_path
from tests.optimisation.studies.test_corner import MadeUp


@pytest.fixture(scope="module")
def benchmark() -> Benchmark:
    return load_benchmark()


@pytest.fixture(scope="module")
def shipped() -> pd.DataFrame:
    return pd.read_csv(model_path(CASES))


def test_no_car_was_trained_or_judged_on(benchmark: Benchmark) -> None:
    ensemble = load_ensemble("car")
    split = ensemble.split(1)
    names = {car.name for car in benchmark.cars}
    assert not names & {car.name for part in (split.training, split.test, (ensemble.best,)) for car in part}
    reserved = {member.name: member for member in split.reserved}
    for car, floor in zip(benchmark.cars, benchmark.cases()[:: len(benchmark.floors)], strict=True):
        assert reserved[car.name].values_with("designed") == car.values
        assert floor.member.settings_on(benchmark.scenario) == reserved[car.name].settings_on(benchmark.scenario)


def test_the_table_has_every_law_of_ours_in_every_case(benchmark: Benchmark, shipped: pd.DataFrame) -> None:
    ours = {one.name: tuple(one.settings) for one in load_entries().contestants}
    assert set(shipped["contestant"]) == set(ours)
    assert ours[PUBLISHED] == THESIS.settings
    assert ours["held"] == HELD.settings
    cases = [(one.member.name, one.speed, one.share, one.friction) for one in benchmark.cases()]
    for name in ours:
        rows = shipped[shipped["contestant"] == name]
        own = list(rows[["car", "speed_m_per_s", "floor", "friction"]].itertuples(index=False, name=None))
        assert sorted(own) == sorted(cases)


def test_a_law_joins_the_table_and_one_of_ours_takes_its_own_place(tmp_path: Path) -> None:
    """On made-up cars a swing of 9 rad/s bears 7.1 degrees of steering, a held tail 6, at the fine step 5 % less."""
    quick = Contestant("quick", ("tail.mode=swing", "controller.swing_file=none", "controller.swing_speed=9.0"))
    (held,) = read_laws("held", "turn_designed")
    engine = MadeUp()
    board = make_leaderboard(tmp_path, [quick, held], engine)
    number = len(load_benchmark().cases())
    assert set(board.cases["contestant"].value_counts()) == {number}
    own = board.cases[board.cases["contestant"] == "quick"]["course_change_rad"]
    assert np.degrees(own.to_numpy()) == pytest.approx(8.0 * 7.1 * 0.95, rel=0.03)
    held_now = board.cases[board.cases["contestant"] == "held"]["course_change_rad"]
    assert np.degrees(held_now.to_numpy()) == pytest.approx(8.0 * 6.0 * 0.95, rel=0.03)
    assert all("manoeuvre.steer_angle" in " ".join(task.settings) for task in engine.tasks), "floors are not looked for"
    assert "| quick |" in (tmp_path / "leaderboard.md").read_text()
    assert list(board.scores["gain_over_no_tail"]) == sorted(board.scores["gain_over_no_tail"], reverse=True)
    again = MadeUp()
    assert make_leaderboard(tmp_path, [quick, held], again).cases.equals(board.cases)
    assert not again.tasks


def made_up(gains: dict[str, list[float]]) -> pd.DataFrame:
    """Two cases on each of three cars, with the gains of a law over no tail."""
    rows: list[dict[str, Any]] = []
    for name, ratio in ({NO_TAIL: [0.0] * 6, PUBLISHED: [0.25] * 6} | gains).items():
        for place, gain in enumerate(ratio):
            rows.append(
                {"contestant": name, "car": f"car{place // 2}", "speed_m_per_s": 4.5, "floor": (1.1, 1.3)[place % 2]}
                | {"pulse_s": 0.5, "course_change_rad": 0.5 * (1.0 + gain), "exit_time_s": 0.6}
            )
    return pd.DataFrame(rows)


def test_a_score_is_median_interval_and_worst_car() -> None:
    scores = score_laws(made_up({"law": [0.1, 0.2, 0.3, 0.4, 0.5, math.nan]})).set_index("law")
    law = scores.loc["law"]
    assert law["gain_over_no_tail"] == pytest.approx(0.25), "of 10, 20, 30, 40, 50 and -100 %"
    assert law["worst_car_over_no_tail"] == pytest.approx(-0.25)
    assert law["gain_over_published"] == pytest.approx(0.0)
    assert law["without_a_turn_that_counts"] == 1
    # Cars are drawn with both cases: the first alone has a median of 15 %, the second alone of 35 %.
    assert law["low_gain_over_no_tail"] == pytest.approx(-0.25)
    assert law["high_gain_over_no_tail"] == pytest.approx(0.35)
    published = scores.loc[PUBLISHED, ["low_gain_over_no_tail", "high_gain_over_no_tail"]]
    assert published.to_list() == pytest.approx([0.25, 0.25])


def test_an_interval_over_cars_covers_what_one_over_cases_would_not() -> None:
    """Cases of a car alike: as many draws as cars, not as cases."""
    table = pd.DataFrame({"car": np.repeat(list("abcdef"), 10), "gain": np.repeat([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], 10)})
    low, high = bootstrap_interval(table)
    assert low <= 0.1
    assert high >= 0.4


def test_a_swing_for_another_car_is_refused(tmp_path: Path) -> None:
    thesis = read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))
    path = str(write_swing(thesis.model_copy(update={"car": {"car.mass": 6.5}}), tmp_path / "other.yaml"))
    with pytest.raises(UserError, match=r"made for another car: car\.mass: made for 6\.5"):
        read_laws(path, "turn_designed")
    (law,) = read_laws(path, "turn_designed", other_car=True)
    assert f"controller.swing_file={path}" in law.settings


@pytest.mark.parametrize(
    ("laws", "words"),
    [
        (
            [Contestant("held", ("tail.mode=none",))],
            "law 'held': the name is taken; allowed: others than no_tail",
        ),
        ([Contestant("one", HELD.settings)] * 2, "law 'one': the name is taken"),
    ],
)
def test_a_taken_name_is_refused(laws: list[Contestant], words: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=words):
        make_leaderboard(tmp_path, laws, MadeUp())


def test_a_benchmark_with_a_missing_friction_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "benchmark.yaml"
    text = model_path(leaderboard.BENCHMARK).read_text(encoding="utf-8")
    other.write_text(text.replace("speeds_m_per_s: [4.5]", "speeds_m_per_s: [4.5, 6.0]"))
    monkeypatch.setattr(leaderboard, "model_path", lambda name: other)
    with pytest.raises(UserError, match="critical_friction: allowed: one of each of 2 speeds"):
        load_benchmark()


@pytest.mark.slow
@pytest.mark.parametrize("name", [NO_TAIL, "best_swing"])
def test_a_cell_comes_out_again(benchmark: Benchmark, shipped: pd.DataFrame, name: str) -> None:
    floor = benchmark.cases()[0]
    rows = shipped[(shipped["contestant"] == name) & (shipped["car"] == floor.member.name)]
    row = rows[rows["floor"] == floor.share].iloc[0]
    (law,) = read_laws(name, benchmark.scenario)
    plan = CornerPlan(benchmark.scenario)
    end = 2.0 + benchmark.pulse_s + 1.5
    steered = [f"manoeuvre.steer_angle={math.radians(row['steering_deg']):.9g}", f"manoeuvre.duration={end!r}"]
    settings = turn_settings(benchmark.scenario, law, floor.member, floor.speed, plan.fine_step)
    hold = f"manoeuvre.turn_hold={benchmark.pulse_s!r}"
    ground = f"car.tyre_friction={float(row['friction'])!r}"
    run = evaluate(RunTask(name, benchmark.scenario, (*settings, ground, *steered, hold)))
    assert counts(run)
    assert run["course_change_rad"] == pytest.approx(row["course_change_rad"], rel=1e-6)
