"""Search of the feedback law: its score, reduced against full cars, and the search itself on one
car.
"""

import numpy as np
import pytest

from aerodima.optimisation import sweep_speeds
from aerodima.optimisation.judge.candidate import write_candidates
from aerodima.optimisation.judge.entry_rule import failed_rule
from aerodima.optimisation.judge.reduced_entries import gains_of
from aerodima.optimisation.judge.suite import (
    FEEDBACK,
    make_surfaces,
    select_candidates,
    select_manoeuvres,
)
from aerodima.optimisation.studies.runs import CachedRunner, RunTask, evaluate
from aerodima.optimisation.swing.feedback_training import (
    RANGES,
    LawSearch,
    _reference,
    laws_at,
    score,
    search_laws,
    shares_of,
    train_feedback,
)
from aerodima.workbench.car.reduced.entry_runs import EntryRollout
from aerodima.workbench.car.reduced.ground_terms import wheel_lifts
from aerodima.workbench.car.reduced.states import STATES
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.ensemble import load_ensemble
from tests.refusals import assert_refused

CARS = load_ensemble("physical").split(1).training[:1]
SETTINGS = tuple(CARS[0].settings_on("entry_turn"))


def test_score_is_half_the_mean_and_half_that_of_the_worst_fifth():
    ratios = np.array([[1.0, 1.2, 1.4, 1.6, 0.8], [1.2, 1.2, 1.2, 1.2, 1.2]])
    assert score(ratios) == pytest.approx([0.5 * (1.2 + 0.8), 1.2])


def test_a_rolled_car_lifts_its_inner_wheels_by_the_sine_of_its_roll():
    cars = _reference("turn", "designed", (SETTINGS,)).cars
    state = np.zeros((len(STATES), 1))
    flat = wheel_lifts(state, cars, np.zeros(1))
    state[5] = 0.1
    rolled = wheel_lifts(state, cars, np.zeros(1))
    track = cars.wheel[1, 0, 0] - cars.wheel[1, 1, 0]
    assert (flat[:, 0] < 0.0).all()
    assert rolled[0, 0] - rolled[1, 0] == pytest.approx(track * np.sin(0.1), abs=1e-4)
    assert rolled[2, 0] - rolled[3, 0] == pytest.approx(track * np.sin(0.1), abs=1e-4)


@pytest.mark.parametrize(("angle", "upright"), [("pitch", True), ("roll", False)])
def test_two_wheels_of_one_side_end_a_run_and_those_of_an_axle_do_not(angle, upright):
    """Nose up by 0.1 rad lifts the front wheels by 28 mm, roll by 0.1 rad those of a side."""
    drivers, cars, *_ = _reference("turn", "designed", (SETTINGS,))
    entering = EntryRollout(cars, drivers[0], gains_of([{}], drivers[0]), np.ones(1))
    entering.state[STATES.index(angle)] = -0.1
    entering.step(2.0, 0.0, 1.0, 0.0)
    assert entering.upright[0] == upright


def swept(manoeuvre, law):
    """Completion and lateral acceleration at 3.2 m/s with a law."""
    drivers, cars, *_ = _reference(manoeuvre, "designed", (SETTINGS,))
    gains = gains_of([law], drivers[0])
    return sweep_speeds(cars, np.array([[3.2]]), drivers, gains, np.ones(1))


@pytest.mark.slow
@pytest.mark.parametrize("manoeuvre", ["turn", "fishhook"])
def test_reduced_cars_turn_as_full_ones_with_the_feedback_law(manoeuvre):
    """Measured: 1 to 2 %.

    The fishhook is steered to both sides, the second time by its roll rate.
    """
    (chosen,) = select_manoeuvres([manoeuvre], "designed")
    upright, figure = swept(manoeuvre, {})
    task = (*SETTINGS, *chosen.settings, *FEEDBACK.settings, "manoeuvre.speed=3.2")
    full = evaluate(RunTask("full", chosen.scenario, task))
    assert upright[0, 0]
    assert full["side_lift_m"] < 0.005
    assert figure[0, 0] == pytest.approx(full["lateral_acceleration_m_per_s2"], rel=0.05)


def test_a_tail_that_stays_leant_is_no_completed_turn():
    """It returns at 0.01 rad/s, so that the car goes on turning after its wheels are straight."""
    upright, _ = swept("turn", {})
    slow = {"feedback.return_speed": 0.01, "feedback.pitch_angle": 0.0, "feedback.roll_gain": 0.0}
    leant, _ = swept("turn", slow)
    assert upright[0, 0]
    assert not leant[0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("manoeuvre", ["lane-change", "corner"])
def test_reduced_cars_keep_to_a_path_up_to_the_speed_of_the_full_ones(manoeuvre):
    """With the law and the first driver of the suite: 0.1 m/s below and above the reduced car's
    entry speed.
    """
    (chosen,) = select_manoeuvres([manoeuvre], "designed")
    settings = (*SETTINGS, *make_surfaces(CARS, [1.2])[0][1].settings)
    drivers, cars, *_ = _reference(manoeuvre, "designed", (settings,))
    speeds = np.arange(1.5, 3.5, 0.05)
    fits, _ = sweep_speeds(
        cars, speeds[:, None], drivers[:1], gains_of([{}], drivers[0]), np.ones(1)
    )
    entry = speeds[np.argmin(fits[:, 0]) - 1]
    assert 1.8 < entry < 3.0
    for speed, expected in ((entry - 0.1, {""}), (entry + 0.1, {"path", "two wheels"})):
        words = (
            *settings,
            *chosen.settings,
            *chosen.drivers[0],
            *FEEDBACK.settings,
            f"manoeuvre.speed={speed:.2f}",
        )
        assert (
            failed_rule(evaluate(RunTask("full", chosen.scenario, words)), "path", 0.0, 0.0)
            in expected
        )


@pytest.mark.slow
def test_search_finds_a_law_that_a_file_of_candidates_brings_back(tmp_path):
    found = train_feedback(
        make_surfaces(CARS, [1.2]), "designed", LawSearch(laws=3, generations=0), CachedRunner()
    )
    assert {setting.split("=")[0] for setting in found.settings} >= set(RANGES)
    path = write_candidates(tmp_path / "laws.yaml", [found], "test")
    assert select_candidates([str(path)])[1].settings == found.settings


def test_the_search_comes_to_the_best_law_and_begins_with_the_present_one():
    tried = []

    def worth(laws):
        tried.extend(map(dict, laws))
        return np.array([2.0 - np.linalg.norm(shares_of(law) - 0.3) for law in laws])

    (start,) = laws_at(np.full((1, len(RANGES)), 0.5))
    search = LawSearch(laws=5, generations=60, seed=1, around=1.0)
    best = search_laws(search, start, worth, [].append)
    assert tried[0] == start
    assert shares_of(best) == pytest.approx(0.3, abs=0.12)
    assert search_laws(search, start, worth, [].append) == best


def no_law():
    (start,) = laws_at(np.full((1, len(RANGES)), 0.5))
    search_laws(
        LawSearch(laws=3, generations=0), start, lambda laws: np.zeros(len(laws)), [].append
    )


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (no_law, ()),
        (lambda: LawSearch(laws=2), ("2", "3")),
        (lambda: LawSearch(around=0.0), ("around", "0")),
    ],
)
def test_a_search_that_cannot_succeed_is_refused(wrong, named):
    assert_refused(wrong, UserError, *named)
