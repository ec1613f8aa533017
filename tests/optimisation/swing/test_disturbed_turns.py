"""Disturbed runs of the corner study: what is drawn, what it changes, who meets it, and the interval of pairs."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.runs import RunTask
from aerodima.optimisation.swing.candidate import HELD, NO_TAIL, THESIS
from aerodima.optimisation.swing.disturbed_turns import (
    AIR_SHARE,
    DELAY,
    FRICTION_SHARE,
    LATE,
    LIMIT_SHARE,
    NEVER,
    NOISE_FACTOR,
    SPEED_SHARE,
    TORQUE_SHARE,
    Disturbance,
    draw_disturbances,
    paired_difference,
)
from aerodima.optimisation.swing.judge import Judgement, judge
from aerodima.optimisation.swing.judge_page import PAGE, write_judgement
from aerodima.optimisation.swing.task import Task
from aerodima.workbench.config.scenario import load_scenario
from tests.optimisation.swing.test_judge import LIMIT, BothCars, MadeUp

DISTURBED = BothCars(disturbed=6)


def test_draws_are_a_seeds_and_a_cars_and_more_of_them_begin_with_the_same() -> None:
    first = draw_disturbances(6, 1, "light")
    assert first == draw_disturbances(30, 1, "light")[:6]
    assert first != draw_disturbances(6, 2, "light")
    assert first != draw_disturbances(6, 1, "heavy")
    assert len({one.seed for one in first}) == 6, "each has its own noise"


def test_draws_fill_their_ranges_and_a_tenth_misses_its_release() -> None:
    draws = draw_disturbances(256, 1, "light")
    for name, low, high in (
        ("air", -AIR_SHARE, AIR_SHARE), ("friction", -FRICTION_SHARE, FRICTION_SHARE),
        ("speed", -SPEED_SHARE, SPEED_SHARE), ("torque", -TORQUE_SHARE, TORQUE_SHARE),
        ("torque_limit", -LIMIT_SHARE, 0.0), ("imu_delay", 0.0, DELAY), ("imu_noise", 1.0, NOISE_FACTOR),
    ):  # fmt: skip
        values = np.array([getattr(one, name) for one in draws])
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < values.max() <= high
    missed = [one for one in draws if one.missed]
    assert len(missed) == pytest.approx(25.6, abs=1.0)
    assert all(0.0 <= one.late <= LATE for one in draws if not one.missed)


def test_a_disturbance_changes_what_it_names_and_nothing_else() -> None:
    given = Disturbance(0.3, -0.05, 0.03, -0.2, -0.3, 0.02, 4.0, 0.05, 7)
    plan = ("controller.trigger=steering", "controller.delay=0.4")
    before = load_scenario("turn_designed", plan)
    after = load_scenario("turn_designed", (*plan, *given.settings(before)))
    assert after.environment.air_density == pytest.approx(1.3 * before.environment.air_density)
    assert after.car.tyre_friction == pytest.approx(0.95 * before.car.tyre_friction)
    assert after.manoeuvre.speed == pytest.approx(1.03 * before.manoeuvre.speed)
    assert after.tail_motor.torque_error == -0.2
    assert after.tail_motor.torque_limit == pytest.approx(0.7 * before.tail_motor.torque_limit)
    assert after.imu.delay == pytest.approx(before.imu.delay + 0.02)
    assert after.imu.gyro_noise == pytest.approx(4.0 * before.imu.gyro_noise)
    assert after.controller.delay == pytest.approx(0.45)
    assert after.seed == 7
    changed = {
        f"{section}.{key}"
        for section, values in before.resolved().items()
        if isinstance(values, dict)
        for key, value in values.items()
        if after.resolved()[section][key] != value
    }
    assert changed == {
        "environment.air_density", "car.tyre_friction", "manoeuvre.speed", "tail_motor.torque_error",
        "tail_motor.torque_limit", "imu.delay", "imu.gyro_noise", "imu.gyro_bias", "imu.accelerometer_noise",
        "imu.attitude_noise", "controller.delay",
    }  # fmt: skip
    assert Disturbance().settings(before) == ()
    missed = load_scenario("turn_designed", (*plan, *Disturbance(late=NEVER).settings(before)))
    assert missed.controller.delay > before.manoeuvre.duration


class Slippery(MadeUp):
    """A car that meets more friction than was planned goes over, unless its tail is held."""

    def row(self, given: dict[str, str]) -> dict[str, Any]:
        lost = float(given[FRICTION]) > 1.3 * 0.6 + 1e-9 and given["tail.mode"] != "held" and "seed" in given
        return super().row(given) | ({"outcome": "flipped", "clean": False} if lost else {})


def judged(folder: Path, engine: MadeUp, task: Task = DISTURBED) -> Judgement:
    return judge(task, [NO_TAIL, HELD, THESIS], folder, engine)


def disturbed_tasks(engine: MadeUp) -> list[RunTask]:
    return [task for task in engine.tasks if any(setting.startswith("seed=") for setting in task.settings)]


@pytest.fixture(scope="module")
def slippery(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, MadeUp, Judgement]:
    """Folder, engine and result."""
    folder, engine = tmp_path_factory.mktemp("slippery"), Slippery()
    return folder, engine, judged(folder, engine)


def test_all_candidates_of_a_car_meet_the_same_draws_with_their_own_steering(
    slippery: tuple[Path, MadeUp, Judgement],
) -> None:
    _, engine, corner = slippery
    runs = corner.disturbed
    assert len(runs) == len(disturbed_tasks(engine)) == 3 * 2 * 2 * 6, "candidates, cars, floors, draws"
    given = ["air", "friction", "speed", "torque", "torque_limit", "imu_delay", "imu_noise", "late", "seed"]
    assert (runs.groupby(["car", "draw"])[given].nunique() == 1).all().all()
    assert runs.groupby("car")["air"].nunique().to_dict() == {"light": 6, "heavy": 6}
    steering = corner.cases.set_index(["candidate", "car", "floor"])["steering_deg"]
    for task in disturbed_tasks(engine):
        settings = dict(setting.partition("=")[::2] for setting in task.settings)
        name = {"none": NO_TAIL, "held": HELD, "swing": THESIS}[settings["tail.mode"]].name
        car = "light" if settings["car.mass"] == "5.0" else "heavy"
        own = math.degrees(float(settings["manoeuvre.steer_angle"]))
        assert min(abs(own - steering[name, car, floor]) for floor in DISTURBED.floors) < 1e-6
        assert settings["simulation.step"] == "0.002"
        assert float(settings[SPEED]) == pytest.approx(4.5, rel=SPEED_SHARE)


def test_survival_and_course_are_compared_in_pairs_with_the_published_swing(
    slippery: tuple[Path, MadeUp, Judgement],
) -> None:
    folder, _, corner = slippery
    survival = corner.survival.set_index("candidate")
    held, published, bare = (survival.loc[who.name] for who in (HELD, THESIS, NO_TAIL))
    assert held["survived"] == 1.0
    assert 0.5 < published["survived"] < 1.0, "lost on the floor of 1.3 where friction is more than planned"
    assert held["survived_difference"] == pytest.approx(1.0 - published["survived"])
    assert 0.0 < held["survived_low"] <= held["survived_difference"] <= held["survived_high"]
    assert (bare["survived_difference"], bare["survived_low"], bare["survived_high"]) == (0.0, 0.0, 0.0)
    assert bare["course_difference"] < 0.0, "less steering, and a run that is not clean has turned nothing"
    ratio = bare["mean_course_rad"] / published["mean_course_rad"]
    assert ratio == pytest.approx(LIMIT["none"] / LIMIT["swing"], rel=0.03)
    write_judgement(folder, DISTURBED, corner, replays=False)
    assert "Disturbed runs" in (folder / PAGE).read_text(encoding="utf-8")
    assert list(pd.read_csv(folder / "survival.csv")["candidate"]) == list(survival.index)
    assert len(pd.read_csv(folder / "disturbed.csv")) == 72


def test_a_run_that_came_to_nothing_says_nothing(tmp_path: Path) -> None:
    class Failing(MadeUp):
        """With a held tail, where the noise has the seed 2."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            failed = given["tail.mode"] == "held" and given.get("seed") == "2"
            return {"outcome": None, "error": "the solver gave up"} if failed else super().row(given)

    held = judged(tmp_path, Failing()).survival.set_index("candidate").loc[HELD.name]
    assert (held["failed"], held["runs"], held["survived"], held["survived_difference"]) == (4, 20, 1.0, 0.0)


def test_a_candidate_without_a_turn_is_not_disturbed(tmp_path: Path) -> None:
    class Sliding(MadeUp):
        """Every turn with a held tail ends in a slide."""

        def row(self, given: dict[str, str]) -> dict[str, Any]:
            return super().row(given) | ({"exit_sideslip_rad": -0.11} if given["tail.mode"] == "held" else {})

    held = judged(tmp_path, Sliding()).survival.set_index("candidate").loc[HELD.name]
    assert held["runs"] == 0
    assert math.isnan(held["survived_difference"])


def test_more_draws_keep_those_that_are_there(tmp_path: Path, slippery: tuple[Path, MadeUp, Judgement]) -> None:
    folder, _, corner = slippery
    shutil.copytree(folder, tmp_path / "more")
    more = Slippery()
    runs = judged(tmp_path / "more", more, BothCars(disturbed=8)).disturbed
    assert len(more.tasks) == len(disturbed_tasks(more)) == 3 * 2 * 2 * 2
    pd.testing.assert_frame_equal(runs[runs["draw"] <= 6].reset_index(drop=True), corner.disturbed)


def test_the_interval_of_pairs() -> None:
    assert paired_difference([np.full(5, 0.5)]) == (0.5, 0.5, 0.5)
    assert all(map(math.isnan, paired_difference([])))
    mean, low, high = paired_difference([np.ones(30), -np.ones(30)])
    assert (mean, low, high) == (0.0, -1.0, 1.0), "two cars that disagree: all is open"
    # One car, half of its draws gained: the normal interval of a share of 100.
    mean, low, high = paired_difference([np.repeat([0.0, 1.0], 50)])
    assert mean == 0.5
    assert high - low == pytest.approx(2 * 1.96 * 0.05, rel=0.1)


@pytest.mark.slow
def test_the_interval_covers_the_truth_with_a_dozen_cars() -> None:
    """Cars that differ by 0.2 around 0.1, draws by 0.5; fewer cars are covered less often, as its words say."""
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(200):
        cars = [0.1 + 0.2 * rng.standard_normal() + 0.5 * rng.standard_normal(30) for _ in range(12)]
        _, low, high = paired_difference(cars)
        covered += low <= 0.1 <= high
    assert 0.88 <= covered / 200 <= 0.98
