"""The suite: its names, the two tails, floors, and what is refused."""

import pytest

from aerodima.optimisation.swerve import suite
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

CARS = load_ensemble("physical").split(1).test[:2]


@pytest.mark.parametrize("tail", suite.SUITE.tails)
def test_a_case_is_a_swerve_with_either_tail_and_the_mount_of_the_car(tail):
    (case,) = suite.make_cases(CARS[:1], tail, [1.0])
    scenario = load_scenario("swerve", case.settings())
    assert scenario.manoeuvre.rolling_start
    assert scenario.controller.delay == 0.0
    assert (scenario.tail.name == "designed") == (tail == "designed")
    own = load_scenario("swerve", CARS[0].settings_on("swerve"))
    for key in ("roll_stop", "mount_height", "mount_x"):
        assert getattr(scenario.tail, key) == getattr(own.tail, key)


def test_floors_are_shares_of_the_friction_of_each_car():
    cases = suite.make_cases(CARS, "built", [0.8, 1.2])
    assert [case.names["floor"] for case in cases] == ["x 0.8", "x 0.8", "x 1.2", "x 1.2"]
    for case in cases:
        own = load_scenario("swerve", case.car.settings_on("swerve")).car.tyre_friction
        there = load_scenario("swerve", case.settings()).car.tyre_friction
        assert there / own == pytest.approx(case.floor, rel=1e-5)


def test_the_car_without_tail_comes_first_and_once():
    names = [one.name for one in suite.select_candidates(["feedback", "none", "folded"])]
    assert names == ["no tail", "feedback", "tail folded back, locked"]


def test_cars_are_those_of_a_part_of_the_ensemble():
    cases = suite.ensemble_cases("physical", "test", 2, "built", [1.0])
    assert [case.car for case in cases] == list(CARS)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: suite.make_cases(CARS, "longer", [1.0]), ("longer",)),
        (lambda: suite.make_cases(CARS, "built", [3.0]), ("floor", "3", "0.2", "2")),
        (lambda: suite.make_cases(CARS, "built", [1.0, 1.0]), ("floor", "1")),
        (lambda: suite.select_candidates(["feedbak"]), ("feedbak", "feedback")),
        (lambda: suite.select_candidates(["folded", "folded"]), ("folded",)),
        (
            lambda: suite.ensemble_cases("physical", "test", 999, "built", [1.0]),
            ("cars", "999"),
        ),
    ],
)
def test_what_is_not_there_is_refused(make, named):
    assert_refused(make, SweepError, *named)
