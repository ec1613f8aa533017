"""The suite: its names, the two tails, floors, and what is refused."""

import json

import pytest

from aerodima.optimisation.swerve import suite
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.swerve_chapter import stored_swerves
from tests.refusals import assert_refused

CARS = load_ensemble("physical").split(1).test[:2]


@pytest.mark.parametrize("tail", suite.SUITE.tails)
def test_a_case_is_a_swerve_with_either_tail_and_the_mount_of_the_car(tail):
    (case,) = suite.ensemble_cases("physical", "test", 1, tail, [1.0])
    scenario = load_scenario("swerve", case.settings())
    assert scenario.manoeuvre.rolling_start
    assert scenario.controller.delay == 0.0
    assert (scenario.tail.name == "designed") == (tail == "designed")
    own = load_scenario("swerve", CARS[0].settings_on("swerve"))
    for key in ("roll_stop", "mount_height", "mount_x"):
        assert getattr(scenario.tail, key) == getattr(own.tail, key)


def test_floors_are_shares_of_the_friction_of_each_car():
    cases = suite.ensemble_cases("physical", "test", 2, "built", [0.8, 1.2])
    assert [case.car for case in cases] == [*CARS, *CARS]
    assert [case.names["floor"] for case in cases] == ["x 0.8", "x 0.8", "x 1.2", "x 1.2"]
    for case in cases:
        own = load_scenario("swerve", case.car.settings_on("swerve")).car.tyre_friction
        there = load_scenario("swerve", case.settings()).car.tyre_friction
        assert there / own == pytest.approx(case.floor, rel=1e-5)


@pytest.mark.parametrize(
    ("number", "tail", "floors", "named"),
    [
        (1, "longer", [1.0], ("longer",)),
        (1, "built", [3.0], ("floor", "3", "0.2", "2")),
        (1, "built", [1.0, 1.0], ("floor", "1")),
        (999, "built", [1.0], ("cars", "999")),
    ],
)
def test_cases_that_there_are_not_are_refused(number, tail, floors, named):
    assert_refused(
        lambda: suite.ensemble_cases("physical", "test", number, tail, floors), SweepError, *named
    )


@pytest.mark.parametrize(
    ("names", "named"), [(["feedbak"], ("feedbak", "feedback")), (["folded"] * 2, ("folded",))]
)
def test_candidates_are_named_rightly_and_once(names, named):
    assert_refused(lambda: suite.select_candidates(names), SweepError, *named)


def test_conditions_hold_for_every_candidate():
    late = ("imu.delay=0.024",)
    (case,) = suite.ensemble_cases("physical", "test", 1, "built", [1.0], conditions=late)
    for candidate in (suite.FEEDBACK, suite.NO_TAIL):
        scenario = load_scenario("swerve", (*case.settings(), *candidate.settings))
        assert scenario.imu.delay == 0.024


def test_stored_runs_have_all_settings_of_their_candidate():
    """A number of the law that is new must not change what a stored candidate does."""
    known = {candidate.name: candidate for candidate in suite.NAMED_CANDIDATES.values()}
    table = stored_swerves()
    driven = table[(table["plant"] == "full") & table["value"].notna()]
    assert set(driven.loc[driven["settings"].isna(), "candidate"]) == {"bound"}
    stored = table.dropna(subset=["settings"])
    for name, settings in zip(stored["candidate"], stored["settings"], strict=True):
        assert set(known[name].settings) <= set(json.loads(settings)), name
