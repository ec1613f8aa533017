"""The search of a steering, and the score that it climbs."""

import numpy as np
import pytest

from aerodima.optimisation import AIMS, SearchEffort
from aerodima.optimisation.swerve.aims import FAILED, find_aim, score
from aerodima.optimisation.swerve.candidate import LOW_BALLAST, NO_TAIL
from aerodima.optimisation.swerve.evolution import evolve
from aerodima.optimisation.swerve.reduced_swerves import ReducedSwerve
from aerodima.optimisation.swerve.standard_manoeuvres import (
    SPEEDS,
    compare_standard,
    passed_from_below,
    standard_angle,
    stays_down,
)
from aerodima.optimisation.swerve.steering import (
    MIN_FIRST_LEVEL,
    constant_steering,
    draw_steering,
    possible_steering,
    scaled_steering,
    search_steering,
    steering_settings,
)
from aerodima.optimisation.swerve.suite import ensemble_cases, select_candidates
from aerodima.workbench.car.reduced.swerves import LEVELS
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

LIMIT = 0.5


@pytest.fixture(scope="module")
def car():
    (case,) = ensemble_cases("physical", "test", 1, "built", [1.2])
    settings = (*case.settings(), "tail.mode=none", "manoeuvre.speed=6.0")
    return ReducedSwerve(load_scenario("swerve", settings))


def test_evolution_finds_the_top_of_a_hill():
    top = np.array([0.6, -1.8, 0.1])
    ranges = (np.array([0.0, -2.0, 0.0]), np.array([2.0, 0.0, 2.0]))
    first = np.random.default_rng(1).uniform(*ranges, (30, 3))
    least, point = evolve(lambda x: np.sum((x - top) ** 2, axis=1) - 1.0, first, ranges, 40, 1)
    assert point == pytest.approx(top, abs=1e-2)
    assert least == pytest.approx(-1.0, abs=1e-4)


def test_steerings_begin_with_a_level_into_the_turn_and_end_at_ticks_in_order():
    generator = np.random.default_rng(2)
    drawn = draw_steering(generator, 40, LIMIT) * generator.normal(1.0, 2.0, (40, 5))
    steering = possible_steering(drawn, LIMIT)
    assert (steering[:, 0] >= MIN_FIRST_LEVEL).all()
    assert (np.abs(steering[:, :3]) <= LIMIT).all()
    ends = steering[:, 3:] / 0.01
    assert ends == pytest.approx(np.rint(ends), abs=1e-9)
    assert (ends[:, 1] >= ends[:, 0]).all()
    half = scaled_steering(np.array([0.2, -0.1, 0.1, 0.1, 0.3]), 0.5)
    scenario = load_scenario("swerve", steering_settings(half))
    manoeuvre = scenario.manoeuvre
    assert (manoeuvre.level_1, manoeuvre.level_2, manoeuvre.level_2_end) == (0.1, -0.05, 0.3)


def test_the_best_steering_counts_and_beats_every_constant_angle(car):
    value, steering = search_steering(car.drive, AIMS["aside-0.5"], LIMIT, SearchEffort(40, 8))
    again = score(car.drive(steering[:, None]), AIMS["aside-0.5"])
    assert again == pytest.approx([value], abs=1e-12)
    angles = np.geomspace(0.02, LIMIT, 16)
    constant = np.stack([angles, angles, angles, 0.0 * angles + 0.2, 0.0 * angles + 0.6])
    values = score(car.drive(constant), AIMS["aside-0.5"])
    assert (values <= FAILED).any()  # the largest angles tip this car
    assert value >= values.max()


def test_more_searches_are_never_worse_and_the_first_of_them_is_that_of_one(car):
    aim = AIMS["aside-0.5"]
    alone = [
        search_steering(car.drive, aim, LIMIT, SearchEffort(16, 2, 1, seed)) for seed in (1, 2)
    ]
    best, _ = search_steering(car.drive, aim, LIMIT, SearchEffort(16, 2, 2, 1))
    assert best == max(value for value, _ in alone)


@pytest.mark.parametrize(("name", "side"), [("held", -1.0), ("published", 1.0)])
def test_motions_of_the_thesis_begin_in_the_middle_when_the_steering_does(name, side):
    (case,) = ensemble_cases("physical", "test", 1, "built", [1.0])
    _, candidate = select_candidates([name])
    settings = (*case.settings(), *candidate.settings, "manoeuvre.speed=6.0")
    steering = np.array([0.02, 0.02, 0.02, 0.2, 0.4])[:, None]
    swerve = ReducedSwerve(load_scenario("swerve", settings)).drive(steering)
    roll = swerve.tail[:, 1, 0]
    assert roll[~swerve.steered] == pytest.approx(0.0, abs=0.01)
    assert roll[swerve.time > 0.6] == pytest.approx(side * np.pi / 2, abs=0.1)
    assert np.abs(np.diff(roll)).max() < 0.002 * 12.0  # it follows 8 rad/s


def test_a_constant_steering_has_one_angle():
    steering = constant_steering(0.4, 3)
    assert steering.shape == (2 * LEVELS - 1, 3)
    assert np.all(steering[:LEVELS] == 0.4)


@pytest.mark.parametrize(("factor", "degrees"), [(6.5, 8.2), (8.0, 10.1)])
def test_angles_of_the_standard_are_those_of_its_lateral_acceleration(factor, degrees):
    """At 50 mph over the root of 10, for a wheelbase of 0.374 m."""
    scenario = load_scenario("swerve", ["car.wheelbase=0.374"])
    angle = standard_angle(scenario, factor)
    assert np.degrees(angle) == pytest.approx(degrees, abs=0.1)
    acceleration = angle / factor * SPEEDS[-1] ** 2 / scenario.car.wheelbase
    assert acceleration == pytest.approx(0.3 * 9.80665)
    assert pytest.approx([4.95, 5.66, 6.36, 7.07], abs=0.005) == SPEEDS


def test_ballast_is_driven_at_each_of_its_places_and_the_best_counts():
    """Only the second place stays down, at all speeds but the third, above which none counts."""
    driven = []

    class Runs:
        def rows(self, tasks):
            driven.extend(load_scenario(task.scenario, task.settings) for task in tasks)
            places = sorted({one.car.com_x for one in driven if one.car.mass > driven[0].car.mass})
            assert len(places) == 4
            for one in driven:
                stays = one.car.com_x == places[1] and one.manoeuvre.speed != SPEEDS[2]
                lift = 0.0 if stays else 0.1
                yield {"outcome": "survived", "touched_when_steered": "", "side_lift_m": lift}

    cases = ensemble_cases("physical", "test", 1, "built", [1.0])
    table = compare_standard([NO_TAIL, LOW_BALLAST], cases, Runs())
    assert len(driven) == 2 * (1 + 4) * len(SPEEDS)
    assert list(table["candidate"]) == ["no tail", "low ballast"] * 2
    assert list(table["passed"]) == [0, 2, 0, 2]
    assert list(table["tips_at_m_per_s"]) == [SPEEDS[0], SPEEDS[2]] * 2


def test_a_car_that_passes_all_speeds_tips_at_none():
    class Runs:
        def rows(self, tasks):
            return [
                {"outcome": "survived", "touched_when_steered": "", "side_lift_m": 0.0}
                for _ in tasks
            ]

    cases = ensemble_cases("physical", "test", 1, "built", [1.0])
    table = compare_standard([NO_TAIL], cases, Runs())
    assert list(table["passed"]) == [len(SPEEDS)] * 2
    assert table["tips_at_m_per_s"].isna().all()


def test_a_speed_is_passed_where_all_below_are_and_nothing_tips_or_touches():
    row = {"outcome": "survived", "touched_when_steered": "", "side_lift_m": 0.004}
    assert stays_down(row)
    for change in ({"side_lift_m": 0.006}, {"touched_when_steered": "tail"}, {"outcome": None}):
        assert not stays_down(row | change)
    assert passed_from_below([True, False, True, True]) == 1
    assert passed_from_below([True, True]) == 2


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: SearchEffort(members=3), ("3", "8")),
        (lambda: find_aim("asid-0.5"), ("asid-0.5", "aside-0.5")),
    ],
)
def test_what_is_not_there_is_refused(make, named):
    assert_refused(make, SweepError, *named)
