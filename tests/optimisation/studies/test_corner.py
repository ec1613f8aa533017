"""The corner study on made-up cars: course, roll and time follow from the steering by a formula."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.studies.candidates import HELD, LOW_PLACE, NO_TAIL, THESIS, low_ballast
from aerodima.optimisation.studies.corner_page import corner_pulses, make_corner
from aerodima.optimisation.studies.corner_plan import CornerPlan, chosen_cars, candidates_of, counts
from aerodima.optimisation.studies.law_files import read_laws
from aerodima.optimisation.studies.law_search import LawSearch
from aerodima.optimisation.studies.law_training import TRAINED, TRAINED_BY_YAW, Screening
from aerodima.optimisation.studies.pulse_lengths import end_of_gain, pulse_rows
from aerodima.optimisation.studies.steering_search import SteeringSearch, best_place, search_steering
from aerodima.optimisation.sweep.rollover_threshold import FRICTION
from aerodima.optimisation.sweep.study_engine import RunTask
from aerodima.workbench.config.ensemble import Member, load_ensemble
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.turn_course import COURSES
from aerodima.workbench.plants.car_model import chassis_centre, gearbox_height
from aerodima.workbench.resources import model_path

CARS = (Member("light", 0.5, {"car.mass": 5.0}), Member("heavy", 0.5, {"car.mass": 6.0}))
LIMIT = {"none": 5.0, "held": 6.0, "swing": 7.0}
"""Steering at which a car rolls too far, degrees, with the published swing; see `limit_of`."""
GRID = SteeringSearch()
ONE_STEP = GRID.angle(1) / GRID.angle(0)
PLAN = CornerPlan(training=LawSearch(laws=4, generations=4, finalists=2))


def limit_of(mode: str, rate: float = 8.0) -> float:
    """Steering that a car bears, degrees: with a swing most at 10 rad/s."""
    return LIMIT[mode] + (0.1 * (2.0 - abs(rate - 10.0)) if mode == "swing" else 0.0)


class MadeUp:
    """Course of 8 times the steering, rolled too far beyond a limit, which is 5 % lower at the fine step.

    The critical friction at full lock is 0.6.
    """

    workers, startup = 1, 0.0

    def __init__(self, stop_after: int | None = None) -> None:
        self.tasks: list[RunTask] = []
        self.laws = 0
        self._stop_after = stop_after

    def rows(self, tasks: Sequence[RunTask], done: Any = None) -> list[dict[str, Any]]:
        rows = []
        for place, task in enumerate(tasks):
            if self._stop_after is not None and len(self.tasks) >= self._stop_after:
                raise KeyboardInterrupt
            self.tasks.append(task)
            rows.append(self.row(dict(setting.partition("=")[::2] for setting in task.settings)))
            if done is not None:
                done(place, rows[-1])
        return rows

    def call(self, function: Any, items: Sequence[Screening]) -> list[list[list[float]]]:
        """Reduced cars turn as far as the full ones."""
        self.laws += sum(len(item.laws) for item in items)
        limits = [[limit_of("swing", law.get("swing_speed", 8.0)) for law in item.laws] for item in items]
        return [np.radians(8.0 * np.outer(rows, np.ones(len(PLAN.floors)))).tolist() for rows in limits]

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
        for degrees in COURSES:
            time = degrees / (16.0 * steering)
            reached = time <= hold + 1e-6
            row |= {
                f"time_to_{degrees}_deg_s": time if reached else None,
                f"peak_roll_to_{degrees}_deg_rad": row["peak_roll_rad"] if reached else None,
                f"clean_to_{degrees}_deg": True if reached else None,
            }
        return row


def measured(folder: Path, engine: Any = None, plan: CornerPlan = PLAN) -> tuple[pd.DataFrame, pd.DataFrame]:
    chosen = candidates_of(["none", "held", "published", "constant"])
    corner, summary, _ = make_corner(folder, plan, chosen, [], CARS[:1], CARS[1:], engine or MadeUp())
    return corner.cases.set_index(["candidate", "floor"]), summary.set_index(["cases", "candidate"])


def test_each_candidate_gets_the_steering_that_the_fine_step_bears_out(tmp_path: Path) -> None:
    cases, summary = measured(tmp_path)
    for (name, floor), row in cases.iterrows():
        limit = {NO_TAIL.name: LIMIT["none"], HELD.name: LIMIT["held"]}.get(name) or limit_of("swing", rate_of(name))
        assert row["friction"] == pytest.approx(floor * 0.6)
        assert limit / ONE_STEP <= row["steering_found_deg"] <= limit
        assert 0.95 * limit / ONE_STEP**2 <= row["steering_deg"] <= 0.95 * limit
        assert row["course_change_rad"] == pytest.approx(math.radians(8.0 * row["steering_deg"]))
    names = list(dict.fromkeys(cases.index.get_level_values(0)))
    assert names[:3] == [NO_TAIL.name, HELD.name, THESIS.name]
    assert rate_of(names[3]) == pytest.approx(10.0, abs=0.5)
    assert summary.loc[("all", HELD.name), "gain_over_no_tail"] == pytest.approx(0.2, abs=0.04)
    assert summary.loc[("all", NO_TAIL.name), "gain_over_published"] == pytest.approx(5 / 7 - 1, abs=0.04)
    assert "| held |" in (tmp_path / "corner.md").read_text()


def rate_of(candidate: str) -> float:
    """rad/s, of "best constant rate (10 @ 0.5)"; the published one without."""
    found = re.search(r"\((\S+) @", candidate)
    return 8.0 if found is None else float(found[1])


def test_laws_are_found_on_training_cars_alone(tmp_path: Path) -> None:
    engine = MadeUp()
    cases, _ = measured(tmp_path, engine)
    laws = pd.read_csv(tmp_path / "laws.csv")
    assert list(laws["law"]) == ["published", "1", "2"]
    for rate in set(laws["swing_speed"]) - {8.0, rate_of(cases.index.get_level_values(0)[-1])}:
        tried = [task for task in engine.tasks if f"controller.swing_speed={rate!r}" in task.settings]
        assert tried
        assert all("car.mass=6.0" in task.settings for task in tried)


def test_a_law_that_only_reduced_cars_like_is_not_taken(tmp_path: Path) -> None:
    class Misled(MadeUp):
        """Reduced cars like slow swings, which the full ones do not bear."""

        def call(self, function: Any, items: Sequence[Screening]) -> list[list[list[float]]]:
            rates = [[law.get("swing_speed", 8.0) for law in item.laws] for item in items]
            return [(20.0 - np.outer(rows, np.ones(len(PLAN.floors)))).tolist() for rows in rates]

    cases, _ = measured(tmp_path, Misled())
    assert rate_of(cases.index.get_level_values(0)[-1]) == 8.0
    assert pd.read_csv(tmp_path / "laws.csv")["swing_speed"][1] < 4.0


def test_the_time_to_a_course_is_proved_by_a_run_that_is_steered_so_long(tmp_path: Path) -> None:
    engine = MadeUp()
    cases, _ = measured(tmp_path, engine, replace(PLAN, courses=(45,)))
    row = cases.loc[(HELD.name, 1.1)]
    assert row["time_to_45_deg_s"] == pytest.approx(45 / (16.0 * row["steering_to_45_deg_deg"]))
    assert row["steering_to_45_deg_deg"] == pytest.approx(0.95 * 6.0, rel=0.025)
    assert any(
        f"manoeuvre.turn_hold={float(f'{row.time_to_45_deg_s:.6g}')!r}" in task.settings for task in engine.tasks
    )


class Drawn(MadeUp):
    """A held tail gains 20 % at 0.5 s, and 40 % of a second's course less for each second beyond."""

    def row(self, given: dict[str, str]) -> dict[str, Any]:
        row, hold = super().row(given), float(given.get("manoeuvre.turn_hold", 0.5))
        less = 1.0 - 0.4 * (hold - 0.5) if given["tail.mode"] == "held" else 1.0
        return row if "course_change_rad" not in row else row | {"course_change_rad": less * row["course_change_rad"]}

    def call(self, function: Any, items: Sequence[Screening]) -> list[list[list[float]]]:
        """Each case turns as far as the full car with its best steering."""
        found = []
        for item in items:
            rows = [dict(setting.partition("=")[::2] for setting in case) for case in item.cases]
            hold = [float(row["manoeuvre.turn_hold"]) for row in rows]
            assert item.duration >= max(hold) + 0.5
            less = [1.0 - 0.4 * (h - 0.5) if r["tail.mode"] == "held" else 1.0 for h, r in zip(hold, rows, strict=True)]
            limit = [LIMIT[row["tail.mode"]] for row in rows]
            found.append([[math.radians(16.0 * h * c * k) for h, c, k in zip(hold, limit, less, strict=True)]])
        return found


@pytest.mark.parametrize("reduced", [False, True])
def test_the_gain_ends_where_longer_pulses_turn_no_further(tmp_path: Path, *, reduced: bool) -> None:
    plan, chosen = replace(PLAN, pulses=(0.5, 0.8, 1.2), reduced=reduced), candidates_of(["held"])
    engine = Drawn()
    corner, summary, _ = make_corner(tmp_path, plan, chosen, [], CARS[:1], (), engine)
    assert set(corner.cases["pulse_s"]) == {0.5, 0.8, 1.2}
    table = corner_pulses(corner.cases)
    assert list(table["median_gain"]) == pytest.approx([0.2, 0.2 - 1.2 * 0.12, 0.2 - 1.2 * 0.28], abs=0.03)
    # From 20 % at 0.5 s on 48 % less a second: nothing is left at 0.92 s.
    ((name, *_, end),) = pulse_rows(table)[1]
    assert (name, float(end.split()[0])) == ("held", pytest.approx(0.92, abs=0.06))
    assert "pulse of 1.2 s" in set(summary["cases"])
    assert "How long a turn" in (tmp_path / "corner.html").read_text()
    assert ("nothing is proved" in (tmp_path / "corner.md").read_text()) is reduced
    assert any("manoeuvre.steer_angle" in setting for task in engine.tasks for setting in task.settings) is not reduced


@pytest.mark.parametrize(
    ("gains", "end"), [([0.2, 0.1, -0.1], 0.75), ([-0.1, 0.1, 0.1], math.inf), ([-0.1, 0.0, -0.1], 0.0)]
)
def test_where_a_gain_ends(gains: list[float], end: float) -> None:
    assert end_of_gain([0.2, 0.5, 1.0], gains) == pytest.approx(end)


def test_longer_pulses_may_be_waited_for_and_swung_through() -> None:
    for family in (TRAINED, TRAINED_BY_YAW):
        assert family.for_pulse(0.3) == family == family.for_pulse(0.5)
        longer = family.for_pulse(1.0).ranges
        assert longer["delay"] == (0.0, 1.0)
        assert longer["swing_speed"] == (1.0, 14.0)
        assert longer["travel"] == family.ranges["travel"]


LAWS = """
schema: aerodima/laws/1
candidates:
  - name: slow
    settings: [tail.mode=swing, controller.swing_file=none, controller.swing_speed=3.0]
"""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ("controller.swing_speed=3.0", "car.com_height=0.1"),
            "'car.com_height=0.1' is no setting of a law; allowed: tail",
        ),
        (("controller.swing_speed=3.0", "controller.swing_sped=3.0"), "law 'slow': .*swing_sped"),
        (("laws/1", "laws/2"), "allowed is 'aerodima/laws/1'"),
        (
            ("settings: [tail.mode=swing, controller.swing_file=none, controller.swing_speed=3.0]", ""),
            "settings: missing",
        ),
        (("  - name: slow", "  - {name: slow, settings: [tail.mode=none]}\n  - name: slow"), "law 'slow': named twice"),
    ],
)
def test_a_list_of_laws_brings_laws_alone(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(LAWS)
    (law,) = read_laws(str(path), "turn_designed")
    assert (law.name, law.settings[-1]) == ("slow", "controller.swing_speed=3.0")
    path.write_text(LAWS.replace(*change))
    with pytest.raises(UserError, match=words):
        read_laws(str(path), "turn_designed")


def test_laws_that_ship_take_part_by_name() -> None:
    (best,) = read_laws("best_swing", "turn_designed")
    assert "controller.pitch_angle=0.593" in best.settings
    (thesis,) = read_laws("thesis_8_rad_per_s", "turn_fast")
    assert any(setting.startswith("controller.swing_file=") for setting in thesis.settings)
    assert len(read_laws(str(model_path("short_turn/candidates.yaml")), "turn_designed")) == 4
    with pytest.raises(UserError, match=r"law 'best_swin': no such file, and none ships by this name; .*best_swing"):
        read_laws("best_swin", "turn_designed")


@pytest.mark.parametrize(("chosen", "there"), [(["held", "constant"], True), (["held"], False)])
def test_tables_of_an_earlier_call_do_not_stay(tmp_path: Path, chosen: list[str], *, there: bool) -> None:
    for name in ("laws.csv", "survival.csv"):
        (tmp_path / name).write_text("of another call")
    make_corner(tmp_path, PLAN, candidates_of(chosen), [], CARS[:1], CARS[1:], MadeUp())
    assert (tmp_path / "laws.csv").exists() is there
    assert not (tmp_path / "survival.csv").exists()


def test_a_law_with_the_name_of_a_candidate_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    engine = MadeUp()
    with pytest.raises(UserError, match="candidate 'held': named twice; allowed: once"):
        make_corner(tmp_path, PLAN, candidates_of(["held"]), read_laws("held", "turn_fast"), CARS[:1], (), engine)
    assert not engine.tasks


def test_a_candidate_whose_turns_do_not_count_has_turned_nothing(tmp_path: Path) -> None:
    class Sliding(MadeUp):
        """Every turn with a held tail ends in a slide."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            return super().row(given) | ({"exit_sideslip_rad": -0.11} if given["tail.mode"] == "held" else {})

    cases, summary = measured(tmp_path, Sliding())
    assert math.isnan(cases.loc[(HELD.name, 1.3), "steering_deg"])
    assert summary.loc[("all", HELD.name), "without_a_turn_that_counts"] == 2
    assert summary.loc[("all", HELD.name), "gain_over_no_tail"] == -1.0


def test_a_car_without_a_floor_is_named_and_left_out(tmp_path: Path) -> None:
    class Touching(MadeUp):
        """The light car is clean on no floor at full lock."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            return super().row(given) | ({"clean": False} if given["car.mass"] == "5.0" else {})

    chosen = candidates_of(["held"])
    corner, *_ = make_corner(tmp_path, PLAN, chosen, [], CARS, (), Touching())
    assert set(corner.cases["car"]) == {"heavy"}
    assert "Left out: light at 4.5 m/s." in (tmp_path / "corner.md").read_text()
    with pytest.raises(UserError, match=r"light at 4\.5 m/s: the published swing at full lock is clean on no floor"):
        make_corner(tmp_path, PLAN, chosen, [], CARS[:1], (), Touching())


def test_two_levels_are_tried_and_the_better_shape_is_kept(tmp_path: Path) -> None:
    class Late(MadeUp):
        """What comes after a first level of 0.15 s counts double."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            late = given.get("manoeuvre.first_hold") == "0.15"
            row = super().row(given)
            return row | ({"course_change_rad": 2.0 * row["course_change_rad"]} if late else {})

    engine = Late()
    cases, _ = measured(tmp_path, engine, replace(PLAN, shapes=((1.0, 0.0), (1.5, 0.15), (1.5, 0.3))))
    row = cases.loc[(HELD.name, 1.1)]
    assert (row["first_level"], row["first_level_time_s"]) == (1.5, 0.15)
    assert row["course_change_rad"] == pytest.approx(math.radians(16.0 * row["steering_deg"]))
    (proof,) = [t for t in engine.tasks if "simulation.step=0.0005" in t.settings and "tail.mode=held" in t.settings][
        :1
    ]
    given = dict(setting.partition("=")[::2] for setting in proof.settings)
    assert float(given["manoeuvre.first_angle"]) == pytest.approx(1.5 * float(given["manoeuvre.steer_angle"]))


def test_fixed_steering_is_the_least_of_the_training_cars(tmp_path: Path) -> None:
    class Weaker(MadeUp):
        """With a held tail the heavy car, a training car, bears 4 degrees, and the light one as much as before."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            steering = math.degrees(float(given.get("manoeuvre.steer_angle", 0.0)))
            weak = given["car.mass"] == "6.0" and given["tail.mode"] == "held" and steering > 4.0
            strong = given["car.mass"] == "6.0" and given["tail.mode"] == "none"
            row = super().row(given)
            return row | ({"clean": False} if weak else {"peak_roll_rad": 0.0} if strong else {})

    cases, summary = measured(tmp_path, Weaker(), replace(PLAN, fixed=True))
    row = cases.loc[(HELD.name, 1.1)]
    assert 4.0 / ONE_STEP <= row["fixed_steering_deg"] <= 4.0 < row["steering_deg"]
    assert row["fixed_course_change_rad"] == pytest.approx(math.radians(8.0 * row["fixed_steering_deg"]))
    # Without tail the training car bears any steering, and the test car does not.
    assert summary.loc[("all", NO_TAIL.name), "fixed_without_a_turn_that_counts"] == 2
    assert summary.loc[("all", HELD.name), "fixed_without_a_turn_that_counts"] == 0


def test_stopped_it_goes_on(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        measured(tmp_path, MadeUp(stop_after=40))
    second, whole = MadeUp(), MadeUp()
    assert measured(tmp_path, second)[0].equals(measured(tmp_path / "other", whole)[0])
    assert len(second.tasks) == len(whole.tasks) - 40
    assert second.laws == 0 < whole.laws


@pytest.mark.parametrize(
    ("change", "counted"),
    [({}, True), ({"clean": False}, False), ({"outcome": "flipped"}, False), ({"peak_roll_rad": 0.36}, False),
     ({"exit_sideslip_rad": -0.11}, False), ({"exit_sideslip_rad": None}, False), ({"outcome": None}, False)],
)  # fmt: skip
def test_what_counts(change: dict[str, Any], counted: bool) -> None:
    row = {"outcome": "survived", "clean": True, "peak_roll_rad": 0.35, "exit_sideslip_rad": 0.1}
    assert counts(row | change) is counted


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
    # The first cars of all parts are drawn by weight: over many seeds the likeliest car is among them most often.
    first = [part[0] for seed in range(400) for part in ensemble.split(seed)[:1]]
    heavy = max((m for m in ensemble.members if m.name != ensemble.best.name), key=lambda m: m.weight)
    share = heavy.weight / (1.0 - ensemble.best.weight)
    drawn = sum(member.name == heavy.name for member in first) / len(first)
    assert drawn == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / len(first)))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: candidates_of(["none", "someone"]), "candidate 'someone': allowed: none, low-ballast, low-centre"),
        (lambda: chosen_cars(CARS, ["light", "light"]), "car 'light': named twice"),
        (lambda: CornerPlan(speeds=(4.5, 4.5)), "speed '4.5': named twice; allowed: once"),
        (lambda: CornerPlan(floors=(1.3, 1.1, 1.3)), "floor '1.3': named twice"),
        (lambda: CornerPlan(pulses=(0.5, 0.5)), "pulse '0.5': named twice"),
        (lambda: CornerPlan(courses=(45, 45)), "course '45': named twice"),
        (lambda: chosen_cars(CARS, ["other"]), "car 'other': is no test car with this seed; allowed: heavy, light"),
        (lambda: SteeringSearch(math.radians(-2.0), 0.5), "steering -2 to 28.6479 degrees: allowed: from above 0"),
        (lambda: LawSearch(laws=2), "2 laws for each number: allowed: at least 3"),
        (lambda: LawSearch(finalists=0), "0 finalists: allowed: at least 1"),
        (lambda: CornerPlan(courses=(50,)), "course 50: allowed: 45, 60, 90 degrees"),
        (lambda: CornerPlan(pulses=(0.5, 2.5)), r"pulse 2\.5 s: allowed: 0\.1 to 2 s"),
        (lambda: CornerPlan(reduced=True, fixed=True), "reduced cars: allowed: courses after pulses of one level"),
        (lambda: CornerPlan(scenario="slalom"), "slalom: manoeuvre.kind slalom; allowed: turn"),
        (lambda: CornerPlan(search=SteeringSearch(high=0.7)), "manoeuvre.steer_angle"),
    ],
)
def test_wrong_input_names_what_is_allowed(wrong: Any, words: str) -> None:
    with pytest.raises(UserError, match=words):
        wrong()
