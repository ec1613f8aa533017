"""Judge of candidates on made-up cars: course and roll follow from the steering by a formula."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
import pytest

from aerodima.optimisation.sweep.rollover_threshold import FRICTION
from aerodima.optimisation.sweep.runs import RunTask, evaluate
from aerodima.optimisation.swing.candidate import HELD, LOW_PLACE, NO_TAIL, THESIS, low_ballast, read_candidates
from aerodima.optimisation.swing.judge import judge
from aerodima.optimisation.swing.judge_page import PAGE, write_judgement
from aerodima.optimisation.swing.task import SteeringSearch, Task, best_place, load_task, search_steering
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.config.ensemble import Member, load_ensemble
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.plants.car_model import chassis_centre, gearbox_height
from aerodima.workbench.resources import model_path

CARS = (Member("light", 0.5, {"car.mass": 5.0}), Member("heavy", 0.5, {"car.mass": 6.0}))
LIMIT = {"none": 5.0, "held": 6.0, "swing": 7.0}
"""Steering at which a car rolls too far, degrees, with the published swing; see `limit_of`."""
GRID = SteeringSearch()
ONE_STEP = GRID.angle(1) / GRID.angle(0)


class MadeUpTask(Task):
    """On the light car; laws are searched on the heavy one."""

    test_cars: ClassVar[tuple[Member, ...]] = CARS[:1]
    training_cars: ClassVar[tuple[Member, ...]] = CARS[1:]


class BothCars(MadeUpTask):
    """On both cars."""

    test_cars: ClassVar[tuple[Member, ...]] = CARS


TASK = MadeUpTask()


def limit_of(mode: str, rate: float = 8.0) -> float:
    """Steering that a car bears, degrees: with a swing most at 10 rad/s."""
    return LIMIT[mode] + (0.1 * (2.0 - abs(rate - 10.0)) if mode == "swing" else 0.0)


class MadeUp(Engine):
    """Course of 8 times the steering, rolled too far beyond a limit, which is 5 % lower at the fine step.

    The critical friction at full lock is 0.6.
    """

    def __init__(self, stop_after: int | None = None) -> None:
        self.tasks: list[RunTask] = []
        self._stop_after = stop_after

    def map(self, work: Any, items: Sequence[Any], done: Any = None, lost: Any = None) -> list[Any]:
        rows = []
        for place, task in enumerate(items):
            assert work is evaluate
            if self._stop_after is not None and len(self.tasks) >= self._stop_after:
                raise KeyboardInterrupt
            self.tasks.append(task)
            rows.append(self.row(dict(setting.partition("=")[::2] for setting in task.settings)))
            if done is not None:
                done(place, rows[-1])
        return rows

    def row(self, given: dict[str, str]) -> dict[str, Any]:
        friction, fine = float(given[FRICTION]), given["simulation.step"] == "0.0005"
        if "manoeuvre.steer_angle" not in given:
            return {"outcome": "survived", "clean": friction <= 0.6 + 1e-9, "error": ""}
        steering = math.degrees(float(given["manoeuvre.steer_angle"]))
        limit = limit_of(given["tail.mode"], float(given.get("controller.swing_speed", 8.0))) * (0.95 if fine else 1.0)
        hold = float(given["manoeuvre.turn_hold"])
        row = {
            "outcome": "survived", "clean": True, "error": "", "exit_sideslip_rad": 0.0, "exit_speed_m_per_s": 4.0,
            "course_change_rad": math.radians(8.0 * steering) * hold / 0.5, "exit_time_s": 0.7,
            "exit_heading_change_rad": 0.5, "average_linear_acceleration_m_per_s2": 5.0, "two_wheel_time_s": 0.0,
            "peak_roll_rad": 0.3 if steering <= limit else 0.4, "swing_trigger_time_s": None,
        }  # fmt: skip
        return row


def judged(folder: Path, engine: Any = None, task: Task = TASK) -> tuple[pd.DataFrame, pd.DataFrame]:
    found = judge(task, [NO_TAIL, HELD, THESIS], folder, engine or MadeUp())
    return found.cases.set_index(["candidate", "floor"]), found.summary.set_index(["cases", "candidate"])


def test_each_candidate_gets_the_steering_that_the_fine_step_bears_out(tmp_path: Path) -> None:
    cases, summary = judged(tmp_path)
    for (name, floor), row in cases.iterrows():
        limit = {NO_TAIL.name: LIMIT["none"], HELD.name: LIMIT["held"]}.get(name) or limit_of("swing")
        assert row["friction"] == pytest.approx(floor * 0.6)
        assert limit / ONE_STEP <= row["steering_found_deg"] <= limit
        assert 0.95 * limit / ONE_STEP**2 <= row["steering_deg"] <= 0.95 * limit
        assert row["course_change_rad"] == pytest.approx(math.radians(8.0 * row["steering_deg"]))
    assert summary.loc[("all", HELD.name), "gain_over_no_tail"] == pytest.approx(0.2, abs=0.04)
    assert summary.loc[("all", NO_TAIL.name), "gain_over_published"] == pytest.approx(5 / 7 - 1, abs=0.04)


def test_tables_and_page_are_written(tmp_path: Path) -> None:
    found = judge(TASK, [NO_TAIL, HELD], tmp_path, MadeUp())
    files = write_judgement(tmp_path, TASK, found, replays=False)
    assert {file.name for file in files} == {"cases.csv", "summary.csv", "gains.png", PAGE}
    assert len(pd.read_csv(tmp_path / "cases.csv")) == 2 * len(TASK.floors)


LAWS = """
schema: aerodima/candidates/1
candidates:
  - name: slow
    settings: [tail.mode=swing, controller.swing_file=none, controller.swing_speed=3.0]
"""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ("controller.swing_speed=3.0", "car.com_height=0.1"),
            "'car.com_height=0.1' is no setting of a candidate; allowed: KEY=... of tail",
        ),
        (("controller.swing_speed=3.0", "controller.swing_sped=3.0"), "candidate 'slow': .*swing_sped"),
        (("candidates/1", "candidates/2"), "allowed is 'aerodima/candidates/1'"),
        (
            ("settings: [tail.mode=swing, controller.swing_file=none, controller.swing_speed=3.0]", ""),
            "settings: missing",
        ),
        (
            ("  - name: slow", "  - {name: slow, settings: [tail.mode=none]}\n  - name: slow"),
            "candidate 'slow': named twice",
        ),
    ],
)
def test_a_list_of_candidates_brings_tail_and_controller_alone(
    tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(LAWS)
    _, law = read_candidates([str(path)], "turn_designed")
    assert (law.name, law.settings[-1]) == ("slow", "controller.swing_speed=3.0")
    path.write_text(LAWS.replace(*change))
    with pytest.raises(UserError, match=words):
        read_candidates([str(path)], "turn_designed")


def test_candidates_that_ship_take_part_by_name() -> None:
    bare, held, best = read_candidates(["none", "held", "best_swing"], "turn_designed")
    assert (bare, held) == (NO_TAIL, HELD)
    assert "controller.pitch_angle=0.593" in best.settings
    _, thesis = read_candidates(["thesis_8_rad_per_s"], "turn_fast")
    assert any(setting.startswith("controller.swing_file=") for setting in thesis.settings)
    assert len(read_candidates([str(model_path("short_turn/candidates.yaml"))], "turn_designed")) == 1 + 4
    for name, words in (("best_swin", r"no such file, and none ships by this name; .*best_swing"), ("hold", "held")):
        with pytest.raises(UserError, match=words):
            read_candidates([name], "turn_designed")
    with pytest.raises(UserError, match="candidate 'held': named twice; allowed: once"):
        read_candidates(["held", str(model_path("short_turn/candidates.yaml"))], "turn_designed")


def test_a_candidate_whose_turns_do_not_count_has_turned_nothing(tmp_path: Path) -> None:
    class Sliding(MadeUp):
        """Every turn with a held tail ends in a slide."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            return super().row(given) | ({"exit_sideslip_rad": -0.11} if given["tail.mode"] == "held" else {})

    cases, summary = judged(tmp_path, Sliding())
    assert math.isnan(cases.loc[(HELD.name, 1.3), "steering_deg"])
    assert summary.loc[("all", HELD.name), "without_a_turn_that_counts"] == 2
    assert summary.loc[("all", HELD.name), "gain_over_no_tail"] == -1.0


def test_a_car_without_a_floor_is_named_and_left_out(tmp_path: Path) -> None:
    class Touching(MadeUp):
        """The light car is clean on no floor at full lock."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            return super().row(given) | ({"clean": False} if given["car.mass"] == "5.0" else {})

    found = judge(BothCars(), [NO_TAIL, HELD], tmp_path, Touching())
    assert set(found.cases["car"]) == {"heavy"}
    assert found.without_floor == ("light at 4.5 m/s",)
    with pytest.raises(UserError, match=r"light at 4\.5 m/s: the published swing at full lock is clean on no floor"):
        judge(TASK, [NO_TAIL, HELD], tmp_path / "alone", Touching())


def test_stopped_it_goes_on(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        judged(tmp_path, MadeUp(stop_after=40))
    second, whole = MadeUp(), MadeUp()
    assert judged(tmp_path, second)[0].equals(judged(tmp_path / "other", whole)[0])
    assert len(second.tasks) == len(whole.tasks) - 40


@pytest.mark.parametrize(
    ("change", "counted"),
    [({}, True), ({"clean": False}, False), ({"outcome": "flipped"}, False), ({"peak_roll_rad": 0.36}, False),
     ({"exit_sideslip_rad": -0.11}, False), ({"exit_sideslip_rad": None}, False), ({"outcome": None}, False)],
)  # fmt: skip
def test_what_counts(change: dict[str, Any], counted: bool) -> None:
    row = {"outcome": "survived", "clean": True, "peak_roll_rad": 0.35, "exit_sideslip_rad": 0.1}
    assert TASK.counts(row | change) is counted


def searched(value: Any) -> tuple[float, int]:
    """Best amplitude, degrees, and how many runs it took."""
    (found,) = search_steering(GRID, 1, lambda wanted: [value(math.degrees(GRID.angle(place))) for _, place in wanted])
    best = best_place(found)
    return (math.nan if best is None else math.degrees(GRID.angle(best))), len(found)


@pytest.mark.parametrize("limit", [2.05, 3.0, 3.87, 5.0, 11.0, 29.9])
def test_the_search_ends_a_step_below_the_limit(limit: float) -> None:
    best, runs = searched(lambda steering: steering if steering <= limit else None)
    assert limit / ONE_STEP**2 <= best <= limit
    assert runs <= GRID.runs


def test_the_search_finds_a_best_amplitude_within_the_range() -> None:
    """The tyres scrub beyond 12 degrees."""
    best, runs = searched(lambda steering: -abs(math.log(steering / 12.0)))
    assert best == pytest.approx(12.0, rel=0.08)
    assert runs == GRID.runs


def test_nothing_that_counts_is_no_steering() -> None:
    assert math.isnan(searched(lambda steering: None)[0])


def test_low_ballast_moves_gearbox_and_arm_and_leaves_the_chassis() -> None:
    before = load_scenario("turn_fast")
    after = load_scenario("turn_fast", [*NO_TAIL.settings, *low_ballast(before)])
    assert gearbox_height(after.car, after.tail) == pytest.approx(LOW_PLACE)
    arm = before.tail.mass + before.tail.hub_mass
    assert after.car.mass == pytest.approx(before.car.mass + arm)
    gravity = before.environment.gravity
    (m0, x0, z0), (m1, x1, z1) = (chassis_centre(one.car, one.tail, gravity) for one in (before, after))
    assert m1 == pytest.approx(m0 + arm)
    # What the chassis has more is the arm's mass where it was put; its tyres sink in a little more.
    assert (m1 * x1 - m0 * x0) / arm == pytest.approx(before.car.gearbox_x)
    assert (m1 * z1 - m0 * z0) / arm == pytest.approx(LOW_PLACE, abs=2e-3)


def test_no_car_is_in_two_parts_of_the_split() -> None:
    ensemble = load_ensemble()
    split = ensemble.split(1)
    names = [member.name for part in split for member in part]
    assert sorted(names) == sorted(m.name for m in ensemble.members if m.name != ensemble.best.name)
    assert split == ensemble.split(1)
    assert split != ensemble.split(2)
    reserved = Task(seed=1, cars=3, judged_on="reserved").test_cars
    assert reserved == ensemble.split(1).reserved[:3]
    # The first cars of all parts are drawn by weight: over many seeds the likeliest car is among them most often.
    first = [part[0] for seed in range(400) for part in ensemble.split(seed)[:1]]
    heavy = max((m for m in ensemble.members if m.name != ensemble.best.name), key=lambda m: m.weight)
    share = heavy.weight / (1.0 - ensemble.best.weight)
    drawn = sum(member.name == heavy.name for member in first) / len(first)
    assert drawn == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / len(first)))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: Task(cars=["car072", "car072"]).test_cars, "car 'car072': named twice"),
        (lambda: Task(cars=["other"]).test_cars, "car 'other': is no test car with this seed; allowed: car"),
        (
            lambda: Task(cars=["other"], judged_on="reserved").test_cars,
            "car 'other': is no reserved car with this seed",
        ),
        (lambda: Task(cars=999).test_cars, "cars: 999; the ensemble has"),
        (lambda: Task(speeds=[4.5, 4.5]), "speed '4.5': named twice; allowed: once"),
        (lambda: Task(floors=[1.3, 1.1, 1.3]), "floor '1.3': named twice"),
        (lambda: Task(floors=[9.0]), "floor 9: allowed: 0.2 to 3"),
        (lambda: SteeringSearch(math.radians(-2.0), 0.5), "steering -2 to 28.6479 degrees: allowed: from above 0"),
        (lambda: Task(scenario="slalom"), "slalom: manoeuvre.kind slalom; allowed: turn"),
        (lambda: Task(scenario="entry_twice"), "entry_twice: manoeuvre.turns 2; allowed: 1"),
        (lambda: Task(steering=(2.0, 40.0)), "manoeuvre.steer_angle"),
        (lambda: load_task("short_turns"), "task 'short_turns': models/tasks has none of this name"),
        (lambda: load_task("short_turn", ["pulse=5"]), "pulse: 5"),
        (lambda: load_task("short_turn", ["car=3"]), "--set car=3: allowed is KEY=VALUE; .*cars"),
    ],
)
def test_wrong_input_names_what_is_allowed(wrong: Any, words: str) -> None:
    with pytest.raises(UserError, match=words):
        wrong()
