"""The suite: its names, the two tails, floors, and what is refused."""

import pytest

from aerodima.optimisation.judge import suite
from aerodima.optimisation.judge.entry_search import EntrySearch
from aerodima.optimisation.judge.entry_speed import Manoeuvre, Surface, find_entry_speeds
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import Member, load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from tests.commands import refused
from tests.refusals import assert_named, assert_refused

CARS = load_ensemble("physical").split(1).test[:2]


@pytest.mark.parametrize("tail", suite.TAILS)
def test_every_manoeuvre_is_a_scenario_with_either_tail_and_the_mount_of_the_car(tail):
    for one in suite.select_manoeuvres(list(suite.MANOEUVRES), tail):
        scenario = load_scenario(one.scenario, (*CARS[0].settings_on(one.scenario), *one.settings))
        assert scenario.manoeuvre.rolling_start
        assert scenario.controller.delay == 0.0
        assert (scenario.manoeuvre.kind == "path") == (one.rule == "path")
        assert (scenario.tail.name == "designed") == (tail == "designed")
        own = load_scenario(one.scenario, CARS[0].settings_on(one.scenario))
        for key in ("roll_stop", "mount_height", "mount_x"):
            assert getattr(scenario.tail, key) == getattr(own.tail, key)


def test_floors_are_shares_of_the_friction_of_each_car():
    cases = suite.make_surfaces(CARS, [0.8, 1.2])
    assert [floor.name for _, floor in cases] == ["x 0.8", "x 0.8", "x 1.2", "x 1.2"]
    for car, floor in cases:
        friction = load_scenario("turn_none", car.settings_on("turn_none")).car.tyre_friction
        there = load_scenario(
            "turn_none", (*car.settings_on("turn_none"), *floor.settings)
        ).car.tyre_friction
        assert there / friction == pytest.approx(float(floor.name[2:]), rel=1e-5)


def test_the_car_without_tail_comes_first_and_once():
    names = [one.name for one in suite.select_candidates(["feedback", "none", "held"])]
    assert names == ["no tail", "feedback", "held"]


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: suite.select_manoeuvres(["fishhok"], "built"), ("fishhok", "fishhook")),
        (lambda: suite.select_manoeuvres(["turn"], "longer"), ("longer",)),
        (lambda: suite.select_manoeuvres(["turn", "turn"], "built"), ("turn",)),
        (lambda: suite.make_surfaces(CARS, [3.0]), ("floor", "3", "0.2", "2")),
        (lambda: suite.select_candidates(["feedbak"]), ("feedbak", "feedback")),
    ],
)
def test_what_is_not_there_is_refused(make, named):
    assert_refused(make, SweepError, *named)


LAW = """
import numpy as np


class Upright:
    rate = 100.0
    memory_size = 0

    def start(self):
        return np.zeros(0)

    def step(self, memory, observation):
        upright = np.array([0.0, 0.0, 17.0, 5.0, 0.0])
        return memory, upright, upright, 1


class Failing(Upright):
    def step(self, memory, observation):
        raise KeyError("gain")


class Half:
    rate = 100.0
"""
SHORT = ("speed_ramp=0.4", "turn_start=0.6", "turn_hold=0.1", "duration=1.6")


@pytest.fixture
def law_file(tmp_path):
    path = tmp_path / "my_law.py"
    path.write_text(LAW)
    return path


@pytest.mark.slow
def test_a_law_of_ones_own_climbs_and_one_that_fails_is_named(law_file):
    who = suite.select_candidates([], [f"{law_file}:Upright", f"{law_file}:Failing"])
    turn = Manoeuvre("turn", "turn_swing", tuple(f"manoeuvre.{setting}" for setting in SHORT))
    search = EntrySearch(start=1.0, lowest=1.0, ceiling=1.0)
    case = (Member("own", 1.0, {}), Surface("own"))
    table = find_entry_speeds([turn], who, [case], CachedRunner(), search).set_index("candidate")
    assert list(table.index) == ["no tail", "Upright", "Failing"]
    assert table.loc["Upright", "entry_speed_m_per_s"] == 1.0
    assert table.loc["Failing", "ended_by"] == "error: KeyError: 'gain'"


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--cars", "99"], ("--cars", "99")),
        (["--tail", "long"], ("long",)),
        (["--law", "other.py:Upright"], ("other.py",)),
        (["--law", "my_law.py:Other"], ("my_law.py", "Other")),
        (["--law", "my_law.py:Half"], ("Half", "memory_size", "start", "step")),
        (["--law", "my_law.py:Upright"] * 2, ("Upright",)),
    ],
)
def test_wrong_flags_are_one_line_before_any_run(law_file, monkeypatch, flags, named):
    monkeypatch.chdir(law_file.parent)
    assert_named(refused("swing", "judge", "--out", "out", *flags), named)
    assert not (law_file.parent / "out").exists()
