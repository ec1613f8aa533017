"""Co-design on made-up cars: what tails of a budget are, what forbids them, and how they are chosen and judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.studies.codesign import BOARD_MARGIN, CodesignPlan, budget_name
from aerodima.optimisation.studies.codesign_figures import pareto
from aerodima.optimisation.studies.codesign_page import make_codesign
from aerodima.optimisation.studies.contestants import raised_gearbox
from aerodima.optimisation.studies.corner_plan import CornerPlan
from aerodima.optimisation.studies.law_search import LawSearch
from aerodima.optimisation.studies.law_training import TRAINED, Screening, changed, screened_courses
from aerodima.optimisation.studies.steering_search import SteeringSearch
from aerodima.optimisation.studies.tail_family import (
    AREAL,
    GROUND_GAP,
    SIZES,
    WHEEL_GAP,
    areal_mass,
    family_of,
    limits_broken,
    read_tails,
    scenario_with,
)
from aerodima.optimisation.sweep.rollover_threshold import FRICTION
from aerodima.optimisation.sweep.study_engine import RunTask
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.plants.car_model import chassis_centre, gearbox_height
from aerodima.workbench.plants.tail import tail_geometry

CARS = (Member("light", 0.5, {"car.mass": 5.5}), Member("heavy", 0.5, {"car.mass": 6.5}))
NOMINAL = Member("nominal", 1.0, {})
SEARCH = LawSearch(laws=3, generations=2, finalists=2)
PLAN = CodesignPlan(CornerPlan(training=SEARCH), budgets=(0.1, 0.2, math.inf), samples=2, mounts=(0.0, 0.2))
DRAWS = np.random.default_rng(1).random((60, 14))


@pytest.mark.parametrize("budget", [0.05, 0.15, 0.3, math.inf])
def test_every_candidate_is_a_tail_of_its_budget(budget: float) -> None:
    family, car = family_of("", "turn_fast", budget), load_scenario("turn_fast").car
    for law in family.laws(DRAWS):
        geometry = tail_geometry(load_scenario("turn_fast", family.settings(law)).tail)
        assert geometry.inertial.mass == pytest.approx(law["tail.mass"], rel=1e-9)
        assert geometry.inertial.mass <= budget + 1e-6
        assert geometry.area == pytest.approx(law["tail.sail_length"] * law["tail.sail_width"])
        # The mass is rounded to 1 mg; the smallest sail weighs 0.65 g.
        assert areal_mass(law) >= SIZES[AREAL][0] * (1.0 - 2e-3)
        assert law["tail.sail_width"] <= 2.0 * (law["tail.mount_height"] - GROUND_GAP)
        free = law["tail.length"] - law["tail.sail_length"] - car.outer_half_track - WHEEL_GAP
        assert free >= -2e-4 or law["tail.sail_length"] <= SIZES["tail.sail_length"][0]


def test_a_law_comes_back_from_its_place_in_the_ranges() -> None:
    family = family_of("", "turn_fast")
    (law,) = family.laws(np.full((1, 14), 0.4))
    assert family.laws(family.shares(law)[None])[0] == pytest.approx(law, rel=2e-3)
    assert family.starts[0]["tail.mass"] == load_scenario("turn_designed").tail.mass


def test_the_gearbox_moves_with_the_mount_and_the_chassis_stays() -> None:
    before = load_scenario("turn_fast")
    after = load_scenario("turn_fast", raised_gearbox(before, before.tail.mount_height - 0.05))
    assert gearbox_height(after.car, after.tail) == pytest.approx(gearbox_height(before.car, before.tail) - 0.05)
    gravity = before.environment.gravity
    assert chassis_centre(after.car, after.tail, gravity) == pytest.approx(
        chassis_centre(before.car, before.tail, gravity), abs=1e-9
    )
    law = {"tail.mount_height": before.tail.mount_height - 0.05}
    assert changed(before, law).car.com_height == pytest.approx(after.car.com_height)


def test_a_candidate_is_screened_as_its_scenario_would_be() -> None:
    """With 4 degrees: the same course with the numbers in the law and in the settings of the case."""
    family = family_of("", "turn_fast")
    law = {**family.starts[0], "swing_speed": 9.0, "delay": 0.1}
    case = ("manoeuvre.speed=4.5", "car.tyre_friction=0.9", "manoeuvre.turn_hold=0.5")
    one = SteeringSearch(math.radians(2.0), math.radians(8.0), runs=1, spread=1)
    task = Screening("turn_fast", (case,), ("",), one, 1.0, 0.5, (law,), family.fixed)
    plain = load_scenario("turn_fast", family.settings(law))
    own = (*case, *family.settings(law), *raised_gearbox(plain, law["tail.mount_height"]))
    (course,) = screened_courses(task)
    assert course == pytest.approx(screened_courses(replace(task, cases=(own,), laws=({},), fixed=()))[0], abs=1e-9)
    assert course[0] > 0.0


def test_a_turn_counts_while_the_board_keeps_its_margin() -> None:
    """Of 0.1 mm less and of 0.1 mm more than the height that the same turn leaves it."""
    family = family_of("", "turn_fast")
    law = {**family.starts[0], "swing_speed": 9.0, "delay": 0.1}
    plain = load_scenario("turn_fast", family.settings(law))
    case = (*family.settings(law), *raised_gearbox(plain, law["tail.mount_height"]))
    case += ("manoeuvre.speed=4.5", "car.tyre_friction=0.9", "manoeuvre.turn_hold=0.5")
    one = SteeringSearch(math.radians(2.0), math.radians(8.0), runs=1, spread=1)
    task = Screening("turn_fast", (case,), ("",), one, 1.0, 0.5)
    turn = load_scenario("turn_fast", [*case, f"manoeuvre.steer_angle={one.angle(one.intervals // 2)!r}"])
    driven = drive_turns(Vehicles.of([turn]), TurnPlans.of([turn]), duration=task.duration)
    (height,) = driven.lowest_board.tolist()
    assert screened_courses(replace(task, board_margin=height - 1e-4)) == [[pytest.approx(driven.course[0], abs=1e-9)]]
    assert screened_courses(replace(task, board_margin=height + 1e-4)) == [[0.0]]


def test_what_forbids_a_tail_is_what_the_findings_say() -> None:
    family = family_of("", "turn_fast")
    law = dict(family.starts[0])
    assert limits_broken(scenario_with("turn_fast", family.settings(law), 0.235)) == []
    ahead = law | {"tail.mount_x": 0.26}
    (words,) = limits_broken(scenario_with("turn_fast", family.settings(ahead), 0.235))
    assert "inside the cage" in words
    heavy = law | {"tail.mass": 1.9}
    broken = " ".join(limits_broken(scenario_with("turn_fast", family.settings(heavy), 0.235)))
    assert "more than the 8.3 N m that its motor holds for long" in broken
    assert "over a cycle it asks" in broken


class MadeUp:
    """The larger the sail and the lighter the tail for it, the more steering a car bears; no limits but 0.5 kg."""

    workers, startup = 1, 0.0

    def __init__(self) -> None:
        self.tasks: list[RunTask] = []
        self.margins: set[float] = set()

    def rows(self, tasks: Sequence[RunTask], done: Any = None) -> list[dict[str, Any]]:
        rows = []
        for place, task in enumerate(tasks):
            self.tasks.append(task)
            rows.append(self.row(dict(setting.partition("=")[::2] for setting in task.settings)))
            if done is not None:
                done(place, rows[-1])
        return rows

    def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
        if not items:
            return []
        if not isinstance(items[0], Screening):
            masses = [float(dict(s.partition("=")[::2] for s in settings)["tail.mass"]) for _, settings, _ in items]
            return [0.0 if mass <= 0.5 else 1.0 for mass in masses]
        self.margins |= {item.board_margin for item in items if item.laws != ({},)}
        return [[[math.radians(8.0 * limit_of(law)) for _ in item.cases] for law in item.laws] for item in items]

    def row(self, given: dict[str, str]) -> dict[str, Any]:
        if "manoeuvre.steer_angle" not in given:
            return {"outcome": "survived", "clean": float(given[FRICTION]) <= 0.6 + 1e-9, "error": ""}
        steering = math.degrees(float(given["manoeuvre.steer_angle"]))
        law = {name: float(given[name]) for name in ("tail.sail_length", "tail.sail_width") if name in given}
        limit = 4.5 if given["tail.mode"] == "none" else limit_of(law)
        return {
            "outcome": "survived", "clean": True, "error": "", "exit_sideslip_rad": 0.0, "exit_speed_m_per_s": 4.0,
            "course_change_rad": math.radians(8.0 * steering), "exit_time_s": 0.7,
            "exit_heading_change_rad": 0.5, "average_linear_acceleration_m_per_s2": 5.0, "two_wheel_time_s": 0.0,
            "peak_roll_rad": 0.3 if steering <= limit else 0.4, "swing_trigger_time_s": None,
        }  # fmt: skip


def limit_of(law: Any) -> float:
    """Steering that a car bears, degrees."""
    return 5.0 + 10.0 * law.get("tail.sail_length", 0.0) * law.get("tail.sail_width", 0.0)


@pytest.fixture(scope="module")
def codesigned(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("codesign")
    engine = MadeUp()
    found, summary, files = make_codesign(folder, PLAN, NOMINAL, CARS[:1], CARS[1:], engine)
    return found, summary, files, engine, folder


def test_a_lighter_budget_is_never_better(codesigned: Any) -> None:
    found, _, _, engine, _ = codesigned
    assert [design.name for design in found.designs] == ["design 100 g", "design 200 g", "design free"]
    for design, budget in zip(found.designs, PLAN.budgets, strict=True):
        assert design.geometry.inertial.mass <= budget
    worth = [
        found.finalists.loc[found.finalists["chosen_for"].str.contains(budget_name(b)), "worth"].max()
        for b in PLAN.budgets
    ]
    assert worth == sorted(worth)
    assert worth[0] < worth[-1]
    line = pareto(found.tried)
    assert (np.diff(line["tail.mass"]) >= 0.0).all()
    assert (np.diff(line["worth"]) > 0.0).all()
    assert line["worth"].max() == found.tried["worth"].max()
    assert found.tried["tail.mass"].max() <= 0.5  # what is not allowed is never driven
    assert BOARD_MARGIN in engine.margins


def test_designs_are_judged_on_cars_that_they_were_not_made_on(codesigned: Any) -> None:
    found, summary, files, engine, _ = codesigned
    assert set(found.corner.cases["car"]) == {"nominal", "light"}
    table = summary.set_index("contestant")
    for design in found.designs:
        assert table.loc[design.name, "unseen_over_published"] > 0.0
        own = {f"tail.mass={design.law['tail.mass']!r}", f"controller.delay={design.law['delay']!r}"}
        searched = [t for t in engine.tasks if own <= set(t.settings)]
        fine = [t for t in searched if "simulation.step=0.0005" in t.settings]
        assert fine
        assert not any("car.mass=6.5" in t.settings for t in fine)
        height = design.law["tail.mount_height"]
        assert all(f"tail.mount_height={height!r}" in t.settings for t in searched)
        assert load_scenario("turn_fast", design.settings).tail.length == design.law["tail.length"]
    assert len(found.mounts) == 3 * len(PLAN.mounts)
    assert set(found.sensitivities["parameter"]) == {*SIZES, *TRAINED.ranges}
    pictures = {f"{name}.png" for name in ("pareto", "tails", "mounts", "sensitivities")}
    assert {path.name for path in files} >= {"codesign.html", "sensitivities.csv", *pictures}


def test_a_search_begins_with_the_finalists_of_an_earlier_one(codesigned: Any, tmp_path: Path) -> None:
    """No generation beside the first one: the best earlier tail is there again, and the new one is not worse."""
    found, *_, folder = codesigned
    first = tuple(read_tails(folder))
    assert len(first) == len(found.finalists)
    search = replace(PLAN.corner, training=replace(SEARCH, generations=0))
    plan = replace(PLAN, corner=search, budgets=(math.inf,), samples=0, mounts=(), first=first)
    again, *_ = make_codesign(tmp_path, plan, NOMINAL, CARS[:1], CARS[1:], MadeUp())
    lengths = again.tried["tail.length"].to_numpy()
    assert all(np.abs(lengths - law["tail.length"]).min() < 2e-3 for law in first)
    assert again.tried["worth"].max() >= found.tried["worth"].max() * 0.99


def test_what_is_no_earlier_search_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"finalists\.csv: .*allowed: the folder of an earlier"):
        read_tails(tmp_path)
    (tmp_path / "finalists.csv").write_text("tail.length,tail.mass\n1,0.2\n")
    with pytest.raises(UserError, match=r"finalists\.csv: .*not in index"):
        read_tails(tmp_path)


def test_asked_again_it_runs_nothing(codesigned: Any) -> None:
    found, _, _, _, folder = codesigned
    again = MadeUp()
    second, *_ = make_codesign(folder, PLAN, NOMINAL, CARS[:1], CARS[1:], again)
    assert again.tasks == []
    pd.testing.assert_frame_equal(second.finalists, found.finalists)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: family_of("", "turn_fast", 0.02), r"budget 0\.02 kg: the lightest tail .* weighs 0\.026 kg; allowed"),
        (lambda: family_of("", "turn_fast", math.nan), "budget nan kg"),
        (lambda: replace(PLAN, budgets=()), "0 budgets, 1 speeds; allowed: at least one budget and one speed"),
        (lambda: replace(PLAN, samples=12), "12 samples: allowed: 0, or a power of two"),
        (lambda: replace(PLAN, budgets=(0.3, 0.01)), "budget 0.01 kg: the lightest"),
        (lambda: replace(PLAN, budgets=(150.0,)), r"budget 150 kg: allowed: less than the car, 6\.\d+ kg, or free"),
        (lambda: replace(PLAN, mounts=(0.0, 13.0)), r"mount 13 m ahead of the rear axle: allowed: -0\.\d+ to 0\.\d+ m"),
        (lambda: replace(PLAN, mounts=(math.nan,)), "mount nan m ahead of the rear axle"),
    ],
)
def test_wrong_input_names_what_is_allowed(wrong: Any, words: str) -> None:
    with pytest.raises(UserError, match=words):
        wrong()


def test_a_budget_that_no_tail_keeps_is_an_error(tmp_path: Path) -> None:
    class Strict(MadeUp):
        """Nothing is allowed."""

        def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
            return super().call(function, items) if isinstance(items[0], Screening) else [1.0] * len(items)

    with pytest.raises(UserError, match=r"100 g: none of the .* keeps the limits of its car; allowed: more mass"):
        make_codesign(tmp_path, PLAN, NOMINAL, CARS[:1], CARS[1:], Strict())


@pytest.mark.parametrize(
    ("budget", "words"),
    [("heavy", "--budget heavy: allowed: a mass in kg above 0, or free"), ("-1", "--budget -1"), ("0.001", "lightest")],
)
def test_the_command_refuses_a_wrong_budget(budget: str, words: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(build_app(), ["optimise", "tail", "--out", str(tmp_path), "--budget", budget])
    assert result.exit_code != 0
    assert words in str(result.exception) + result.output
