"""A study of one's own car on made-up cars, its files, and what it refuses; the documentation runs a tiny one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

from aerodima.optimisation.studies.law_files import read_laws
from aerodima.optimisation.studies.law_training import Screening
from aerodima.optimisation.studies.own_car_page import PAGE, own_rows, write_own_car
from aerodima.optimisation.studies.own_car_study import (
    CAR,
    LAW,
    STATED,
    TURN,
    WORDS,
    Effort,
    OwnCar,
    possible_cars,
    study_own_car,
)
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from tests.optimisation.studies.test_corner import MadeUp, limit_of

TINY = Effort(members=2, training=1, laws=3, generations=1, finalists=1, runs=5)
SETTINGS = ("car.mass=6.5", "manoeuvre.speed=4.5")


class Cars(MadeUp):
    """As in the corner study, for any number of cases."""

    def call(self, function: Any, items: Sequence[Screening]) -> list[list[list[float]]]:
        self.laws += sum(len(item.laws) for item in items)
        return [
            np.radians(
                [[8.0 * limit_of("swing", law.get("swing_speed", 8.0))] * len(item.cases) for law in item.laws]
            ).tolist()
            for item in items
        ]


Found = tuple[OwnCar, Path, list[str], Cars]


def study(out: Path, engine: Any = None, effort: Effort = TINY, progress: Any = print) -> OwnCar:
    return study_own_car(out, "turn_designed", SETTINGS, effort, engine or Cars(), progress=progress)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    out, lines, engine = tmp_path_factory.mktemp("own"), [], Cars()
    result = study(out, engine, progress=lines.append)
    write_own_car(out, result)
    return result, out, lines, engine


def test_the_sentence_has_all_figures(found: Found) -> None:
    result, *_ = found
    course = dict(zip(result.own["contestant"], np.degrees(result.own["course_change_rad"]), strict=True))
    words = result.sentence()
    told = zip(WORDS.values(), course.values(), strict=True)
    turned = ", ".join(f"{who} {value:.0f}" for who, value in told)
    assert words.startswith(f"course in 0.5 s, each with its best steering: {turned} degrees")
    assert words.endswith("critical friction at full lock 0.60 / 0.60 / 0.60 / 0.60 / 0.60")
    number, cars = result.furthest()
    assert f"furthest on {number} of {cars} unseen cars" in words
    assert cars == TINY.members


def test_what_is_stated_holds_for_all_cars_and_the_rest_differs(found: Found) -> None:
    result, out, *_ = found
    path = out / CAR
    cars = [load_scenario(path, car.settings_on(path)) for car in (*result.test, *result.training)]
    assert {(car.car.mass, car.manoeuvre.speed, car.tail.sail_length) for car in cars} == {(6.5, 4.5, 0.6)}
    assert len({car.car.com_height for car in cars}) == len(cars)
    names = {car.name for car in result.test}
    split = load_ensemble().split(TINY.seed)
    assert names == {car.name for car in split.test[:2]}
    assert set(result.corner.cases["car"]) == {STATED, *names}


def test_the_law_is_a_file_that_corner_reads_and_a_turn_that_is_the_proof(found: Found) -> None:
    result, out, _, engine = found
    (law,) = read_laws(str(out / LAW), "turn_designed")
    assert law.settings == result.law.at(4.5)
    turn = load_scenario(out / TURN)
    fine = [task for task in engine.tasks if "simulation.step=0.0005" in task.settings]
    assert any(load_scenario(task.scenario, task.settings) == turn for task in fine)
    row = result.own.iloc[-1]
    assert math.degrees(turn.manoeuvre.steer_angle) == pytest.approx(row["steering_deg"])


def test_the_page_begins_with_the_sentence(found: Found) -> None:
    result, out, *_ = found
    page = (out / PAGE).read_text()
    assert result.sentence() in page
    assert page.index(result.sentence()) < page.rindex("Unseen cars") < page.rindex("Laws on the training cars")
    header, rows = own_rows(result)
    assert all(cell in page for cell in (*header, *rows[-1]))
    assert "car.mass: 6.5" in page
    assert len(pd.read_csv(out / "cases.csv")) == 5 * 3


def test_progress_counts_the_whole_work_with_the_time_left(found: Found) -> None:
    bars = [line for line in found[2] if line.startswith("[") and "laws tried" not in line]
    counts = [tuple(map(int, line.split("] ")[1].split()[0].split("/"))) for line in bars]
    assert [done for done, _ in counts] == sorted(done for done, _ in counts)
    assert counts[0][1] == TINY.pieces
    assert 0.5 * TINY.pieces <= counts[-1][0] <= 1.3 * TINY.pieces
    assert all(line.endswith("s to go") for line in bars)


def test_stopped_it_goes_on_and_more_cars_keep_what_is_there(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        study(tmp_path, Cars(stop_after=60))
    second, whole = Cars(), Cars()
    assert study(tmp_path, second).sentence() == study(tmp_path / "other", whole).sentence()
    assert 0 < len(second.tasks) < len(whole.tasks)
    more = Cars()
    study(tmp_path, more, Effort(**(vars(TINY) | {"members": 3})))
    assert more.laws == 0
    third = load_ensemble().split(TINY.seed).test[2]
    assert more.tasks
    assert all(f"car.com_height={third.values['car.com_height']}" in task.settings for task in more.tasks)


def test_another_car_in_the_same_folder_is_trained_anew(tmp_path: Path) -> None:
    first, same, other = Cars(), Cars(), Cars()
    for engine, mass in ((first, 6.5), (same, 6.5), (other, 7.5)):
        study_own_car(tmp_path, "turn_designed", (f"car.mass={mass}",), TINY, engine)
    assert first.laws == other.laws > same.laws == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [({"members": 0}, r"--members 0: the ensemble has \d+ such cars; allowed: 1 to \d+"),
     ({"training": 999}, r"--training 999: the ensemble has \d+ such cars")],
)  # fmt: skip
def test_a_number_of_cars_that_is_not_there_is_refused(change: dict[str, int], words: str) -> None:
    with pytest.raises(UserError, match=words):
        possible_cars({}, "car", Effort(**change))


def test_a_car_of_which_all_is_stated_is_refused() -> None:
    with pytest.raises(UserError, match=r"states all .* numbers in which the cars of car differ"):
        possible_cars(load_scenario("turn_fast").resolved(), "car", TINY)


def test_a_car_that_is_clean_on_no_floor_is_refused(tmp_path: Path) -> None:
    class Touching(Cars):
        def row(self, given: dict[str, str]) -> dict[str, Any]:
            return super().row(given) | {"clean": False}

    with pytest.raises(UserError, match="the published swing at full lock is clean on no floor"):
        study(tmp_path, Touching())


def test_wrong_files_are_refused_in_one_line_and_leave_nothing(tmp_path: Path) -> None:
    def refused(*words: object) -> str:
        result = CliRunner().invoke(build_app(), [*map(str, words)], catch_exceptions=False)
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1), result.output
        return result.stderr

    swing = tmp_path / "swing.yaml"
    swing.write_text(yaml.safe_dump({"schema": "aerodima/swing/1", "name": "x"}))
    out = ("--out", tmp_path / "out")
    assert "allowed is 'aerodima/scenario/1'" in refused("study", "swing", swing, *out)
    assert "no such file" in refused("study", "swing", tmp_path / "nothing.yaml", *out)
    assert "manoeuvre.kind straight; allowed: turn" in refused("study", "swing", "straight", *out)
    assert "car.mas" in refused("study", "swing", "turn_fast", "--set", "car.mas=6", *out)
    assert not (tmp_path / "out").exists()
