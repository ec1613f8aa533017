"""Search of the feedback law: its score, reduced against full cars, and the search itself on one
car.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from aerodima.optimisation import SearchEffort
from aerodima.optimisation.studies.runs import FINE_STEP, CachedRunner
from aerodima.optimisation.swerve.aims import AIMS
from aerodima.optimisation.swerve.candidate import write_candidate
from aerodima.optimisation.swerve.reduced_swerves import ReducedSwerve
from aerodima.optimisation.swerve.steering import CONSTANT_ENDS, steering_settings
from aerodima.optimisation.swerve.suite import FEEDBACK, ensemble_cases, select_candidates
from aerodima.optimisation.swing.feedback_training import (
    PASSED,
    RANGES,
    LawBatch,
    LawSearch,
    Place,
    counter_steer,
    find_places,
    laws_at,
    score,
    score_law_batch,
    search_laws,
    shares_of,
    train_feedback,
)
from aerodima.optimisation.swing.full_runs import FullRun, drive_full
from aerodima.workbench.car.swerve import swerve_row
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

CASES = ensemble_cases("physical", "training", 1, "built", [1.2])
SETTINGS = (*CASES[0].settings(), *FEEDBACK.settings, "manoeuvre.speed=6.0")
STEERING = (0.08, 0.04, 0.02, 0.2, 0.4)


def test_score_is_half_the_mean_and_half_that_of_the_worst_fifth():
    ratios = np.array([[1.0, 1.2, 1.4, 1.6, 0.8], [1.2, 1.2, 1.2, 1.2, 1.2]])
    assert score(ratios) == pytest.approx([0.5 * (1.2 + 0.8), 1.2])


def test_laws_are_scored_by_their_best_steering_over_the_car_without_tail():
    """A law that never moves the tail, and one that is tried with steerings that tip the car."""
    still = dict.fromkeys(RANGES, 0.0) | {"feedback.grip": 4.0, "feedback.pitch_angle": -1.0}
    shipped = {name: getattr(load_scenario("swerve").feedback, name[9:]) for name in RANGES}
    place = Place(SETTINGS, "aside-0.5", (STEERING, (0.5, 0.5, 0.5, 0.2, 0.4)), 0.5)
    (one,) = score_law_batch(LawBatch(place, (still,)))
    (again, law) = score_law_batch(LawBatch(place, (still, shipped)))
    assert one == again
    assert 0.0 < one != law
    tips = place._replace(steerings=((0.5, 0.5, 0.5, 0.2, 0.4),))
    assert score_law_batch(LawBatch(tips, (still,))) == [0.0]
    survived = place._replace(reference=None)
    assert score_law_batch(LawBatch(survived, (still,))) == [PASSED / 2.0], "one of two manoeuvres"


def test_a_law_is_scored_by_the_aim_of_its_place():
    car = ReducedSwerve(load_scenario("swerve", SETTINGS))
    swerve = car.drive(np.array(STEERING)[:, None])
    law = {name: getattr(car.scenario.feedback, name[9:]) for name in RANGES}
    for name, column in (("aside-0.5", "aside_soon_m"), ("aside-1.0", "aside_later_m")):
        place = Place(SETTINGS, name, (STEERING,), 0.25)
        (worth,) = score_law_batch(LawBatch(place, (law,)))
        assert worth == pytest.approx(swerve_row(swerve)[column] / 0.25)


def test_every_car_is_a_place_of_each_aim_in_the_same_condition():
    """Two cars: a place's reference is what the car without tail reaches of its own aim."""
    cases = ensemble_cases("physical", "training", 2, "built", [1.0])
    few = SearchEffort(16, 2, searches=1)
    places = find_places(cases, [6.0], ["aside-0.5", "aside-1.0"], CachedRunner(), few)
    assert [place.aim for place in places] == 2 * ["aside-0.5"] + 2 * ["aside-1.0"]
    assert [place.settings for place in places[:2]] == [place.settings for place in places[2:]]
    assert places[0].settings != places[1].settings
    for soon, later in zip(places[:2], places[2:], strict=True):
        assert 0.15 < soon.reference < 0.5 < later.reference < 2.0


def test_a_fishhook_is_counter_steered_when_its_driver_does():
    """Cars that roll outwards from 0.1 s until 0.3 s, that never do, and that never stop."""
    car = ReducedSwerve(load_scenario("swerve", (*SETTINGS, "imu.delay=0.02")))
    time = np.arange(-0.1, 2.0, 0.002)
    rolls = [0.5 * np.clip(time - 0.1, 0.0, 0.2), 0.0 * time, 0.5 * time]
    driven = SimpleNamespace(time=time, roll=np.stack(rolls, axis=1), steered=time >= 0.0)
    one_side = np.tile([0.1, 0.1, 0.1, *CONSTANT_ENDS], (3, 1))
    steerings = counter_steer(one_side, driven, car)
    assert steerings[:, :3] == pytest.approx(np.tile([0.1, -0.1, -0.1], (3, 1)))
    held = car.scenario.manoeuvre.turn_hold
    assert steerings[:, 3] == pytest.approx([0.32, held, held], abs=0.005)


@pytest.mark.slow
def test_reduced_cars_swerve_as_full_ones_with_the_feedback_law():
    """Measured: 2 % at the fine step, 3.0 % when the full car takes 2 ms."""
    steering = np.array(STEERING)
    fine = f"simulation.step={FINE_STEP}"
    reduced = swerve_row(ReducedSwerve(load_scenario("swerve", SETTINGS)).drive(steering[:, None]))
    full = drive_full(FullRun((*SETTINGS, fine, *steering_settings(steering)), "aside-0.5"))
    assert full["counts"]
    assert reduced["counts"]
    for name in ("aside_soon_m", "centre_aside_later_m", "course_later_rad", "sustained_m_per_s2"):
        assert reduced[name] == pytest.approx(full[name], rel=0.03)
    assert full["value"] == full["aside_soon_m"]
    assert AIMS["aside-0.5"].unit == "m"


@pytest.mark.slow
def test_search_finds_a_law_that_a_file_of_candidates_brings_back(tmp_path):
    search = LawSearch(laws=4, generations=1, rounds=1)
    found = train_feedback(CASES, [6.0], ["aside-0.5"], search, CachedRunner(), SearchEffort(24, 2))
    assert {setting.split("=")[0] for setting in found.settings} >= set(RANGES)
    path = write_candidate(tmp_path / "laws.yaml", found, "test")
    assert select_candidates([str(path)])[1].settings == found.settings


def test_the_search_comes_to_the_best_law_and_begins_with_the_present_one():
    tried = []

    def worth(laws):
        tried.extend(map(dict, laws))
        return np.array([2.0 - np.linalg.norm(shares_of(law) - 0.3) for law in laws])

    (start,) = laws_at(np.full((1, len(RANGES)), 0.5))
    search = LawSearch(laws=12, generations=80, seed=1)
    best = search_laws(search, start, worth, [].append)
    assert tried[0] == start
    assert shares_of(best) == pytest.approx(0.3, abs=0.12)
    assert search_laws(search, start, worth, [].append) == best


def no_law():
    (start,) = laws_at(np.full((1, len(RANGES)), 0.5))
    search_laws(
        LawSearch(laws=4, generations=1), start, lambda laws: np.zeros(len(laws)), [].append
    )


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (no_law, ()),
        (lambda: LawSearch(laws=2), ("2", "4")),
        (lambda: LawSearch(rounds=0), ("rounds", "0", "1")),
        (lambda: LawSearch(around=0.0), ("around", "0")),
    ],
)
def test_a_search_that_cannot_succeed_is_refused(wrong, named):
    assert_refused(wrong, UserError, *named)
