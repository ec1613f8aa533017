"""Search on the full car: what is varied, and that it stays possible."""

from dataclasses import replace

import numpy as np
import pytest

from aerodima.optimisation.studies.runs import CachedRunner, step_settings
from aerodima.optimisation.swerve.candidate import NO_TAIL
from aerodima.optimisation.swerve.steering import TRIMS, steering_settings
from aerodima.optimisation.swerve.suite import BOUND, FOLDED, NAMED_CANDIDATES, ensemble_cases
from aerodima.optimisation.swing import full_search
from aerodima.optimisation.swing.full_runs import CLIMB_STEP, Descent, FullRun
from aerodima.optimisation.swing.full_search import (
    NO_CHANGE,
    ROUND,
    TAIL_RANGES,
    FullSearch,
    driven_tail,
    follow_leaders,
    varied_swing,
)
from aerodima.optimisation.swing.solution import KNOT_ROUNDING, with_tail
from aerodima.optimisation.swing.swerve_shooting import KNOTS, ROLL_MARGIN, within_reach
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.swing_file import read_swing, swing_at

INSIDE = model_path("swings/inside_8_rad_per_s.yaml")
STEERING = [0.1, 0.05, -0.02, 0.2, 0.4]
STEERED = steering_settings(np.array(STEERING))


def search(motion=None, value=0.4, candidate=FOLDED, share=0.9):
    (case,) = ensemble_cases("physical", "test", 1, "built", [1.2])
    result = {"score": 0.4, "steering": STEERING, "variant": 0}
    if motion is not None:
        candidate = BOUND
    settings = ("tail.mode=swing",) if candidate is BOUND else candidate.settings
    rows = {share: {"counts": True, "value": value}}
    descent = Descent(candidate, case, 6.0, "aside-0.5", settings, result, motion=motion, rows=rows)
    return FullSearch.from_descent(descent, share)


def test_a_swing_is_scaled_in_roll_and_time_and_moved_in_pitch():
    swing = read_swing(INSIDE)
    times = np.linspace(0.0, 0.5, 11)
    varied = varied_swing(swing, np.array([0.5, 2.0, -0.3]), STEERED)
    before = swing_at(swing, times / 2.0)
    after = swing_at(varied, times)
    assert after.roll_position == pytest.approx(0.5 * before.roll_position)
    assert after.pitch_position == pytest.approx(before.pitch_position - 0.3)
    same = varied_swing(swing, np.array(NO_CHANGE), STEERED)
    assert swing_at(same, times).roll_position == pytest.approx(
        swing_at(swing, times).roll_position
    )
    beyond = varied_swing(swing, np.array([1.5, 1.0, 0.0]), STEERED).knots.roll_position_rad
    assert min(beyond) == pytest.approx(-swing.limits.roll_position_rad)


def test_a_varied_solution_names_its_own_steering_and_claims_nothing_of_the_old_one():
    swing = read_swing(INSIDE)
    found = {"aim": "aside-0.5", "aim_reduced": 0.7, "evaluations": 90}
    before = ("tail.length=0.4", *steering_settings(np.array([0.3, 0.2, 0.1, 0.3, 0.5])))
    origin = swing.provenance.model_copy(update={"found": found, "settings": before})
    solution = swing.model_copy(update={"provenance": origin})
    varied = varied_swing(solution, np.array(NO_CHANGE), STEERED).provenance
    assert varied.found == {"aim": "aside-0.5"}
    assert varied.settings == ("tail.length=0.4", *STEERED)


@pytest.mark.parametrize("motion", [None, INSIDE])
def test_a_search_starts_at_the_best_run_and_its_mutations_are_possible(motion):
    one = search(motion)
    angles = 0.9 * np.array(STEERING[:3])
    expected = [*angles, 0.2, 0.4, *(() if motion is None else NO_CHANGE)]
    assert one.point == pytest.approx(expected)
    one.spread = 20.0 * one.spread
    points = one.mutations(np.random.default_rng(3), 0.5)
    assert points.shape == (ROUND, len(expected))
    assert (np.abs(points[:, :3]) <= 0.5).all()
    assert (points[:, 0] > 0.0).all()
    assert (points[:, 4] >= points[:, 3]).all()
    low, high = np.array(TAIL_RANGES)[:, : len(expected) - 5]
    assert ((points[:, 5:] >= low) & (points[:, 5:] <= high)).all()


def test_a_trim_is_varied_within_its_range_and_named_in_the_run(tmp_path):
    one = announced(0.4)
    assert one.point == pytest.approx([*0.9 * np.array(STEERING[:3]), 0.2, 0.4, -0.01, *NO_CHANGE])
    one.spread = 20.0 * one.spread
    points = one.mutations(np.random.default_rng(3), 0.5)
    trims = points[:, 5]
    assert ((trims >= TRIMS[0]) & (trims <= TRIMS[1])).all()
    assert len(set(trims)) > 2
    low, high = TAIL_RANGES
    assert ((points[:, 6:] >= low) & (points[:, 6:] <= high)).all()
    point = np.array([*STEERING, -0.01, 1.2, 1.0, 0.0])
    run = one.run(point, tmp_path / "varied.yaml")
    trim = "manoeuvre.trim_angle=-0.012"  # it goes with the roll at which the tail waits
    assert trim in run.settings
    large = one.run(np.array([*STEERING, 0.009, 1.5, 1.0, 0.0]), tmp_path / "large.yaml")
    assert "manoeuvre.trim_angle=0.009" in large.settings  # more would release the swing
    assert read_swing(tmp_path / "varied.yaml").provenance.settings[-1] == trim


@pytest.mark.parametrize("value", [0.3, 0.5])
def test_a_motion_that_waits_at_a_side_neither_leads_nor_follows(monkeypatch, value):
    monkeypatch.setattr(full_search, "driven_tail", lambda run: pytest.fail(str(run.settings)))
    bound = search(INSIDE, 0.4)
    waiting = announced(value)
    follow_leaders([bound, waiting], CachedRunner())
    assert waiting.point[5] == -0.01
    assert waiting.swing == bound.swing


def test_the_run_at_the_finer_step_keeps_its_trim():
    descent = replace(announced(0.4).descent, step=5e-4)
    run = descent.confirming_run(0.9)
    assert "manoeuvre.trim_angle=-0.01" in run.settings
    assert "manoeuvre.level_1=0.081" in run.settings
    assert not [one for one in search().descent.run(0.9).settings if "trim" in one]


def announced(value):
    """The search of a motion that waits at a side, with a trim of -0.01 rad."""
    one = search(INSIDE, value)
    result = one.descent.result | {"steering": [*STEERING, -0.01]}
    return FullSearch.from_descent(replace(one.descent, result=result), 0.9)


def test_a_search_starts_with_wheels_within_their_limit():
    one = search(share=9.0)
    limit = one.descent.max_angle
    assert one.point[:3] == pytest.approx([limit, 0.45, -0.18])


@pytest.mark.parametrize(("value", "follows"), [(0.3, True), (0.5, False)])
def test_a_motion_begins_where_a_better_candidate_of_its_case_ends(monkeypatch, value, follows):
    tail = [-0.5, *np.linspace(0.1, 0.9, 9)]
    monkeypatch.setattr(full_search, "driven_tail", lambda run: tail)
    leader = search(value=0.4)
    bound = search(INSIDE, value)
    before = bound.swing
    follow_leaders([leader, bound], CachedRunner())
    assert leader.swing is None
    if follows:
        assert bound.swing.knots.roll_position_rad == pytest.approx([0.0, *tail[1:]])
        assert set(bound.swing.knots.pitch_position_rad) == {-0.5}
        assert bound.point == pytest.approx([*leader.point, *NO_CHANGE])
    else:
        assert bound.swing is before


def test_a_car_without_tail_leads_no_motion(monkeypatch):
    """It goes further than the bound, and has no tail whose motion could be taken."""
    monkeypatch.setattr(full_search, "driven_tail", lambda run: pytest.fail(str(run.settings)))
    bound = search(INSIDE, 0.3)
    before = bound.swing
    follow_leaders([search(value=0.4, candidate=NO_TAIL), bound], CachedRunner())
    assert bound.swing is before


def test_the_tail_of_a_full_run_is_read_at_the_knots_with_its_sign():
    """In a turn to the left the inside is the left."""
    (case,) = ensemble_cases("physical", "test", 1, "built", [1.0])
    driver = ("manoeuvre.speed=4.0", "manoeuvre.level_1=0.02", *step_settings(CLIMB_STEP))
    inside = NAMED_CANDIDATES["held"].settings
    _, *rolls = driven_tail(FullRun((*case.settings(), *inside, *driver), "aside-0.5"))
    assert len(rolls) == 9
    assert rolls[0] > rolls[1] > rolls[2]
    assert rolls[4:] == pytest.approx([-np.pi / 2] * 5, abs=0.1)


def test_every_motion_that_keeps_its_range_has_a_swing_file():
    """The file is checked at more instants than its knots, and had been refused."""
    swing = read_swing(INSIDE)
    most = swing.limits.roll_position_rad - KNOT_ROUNDING - ROLL_MARGIN
    rolls = np.random.default_rng(8).uniform(-9.0, 9.0, (300, len(KNOTS) - 1))
    for kept in within_reach(rolls, most):
        written = with_tail(swing, np.array([-0.4, *kept])).knots.roll_position_rad
        assert np.array(written[1:]) == pytest.approx(kept, abs=1e-8)


def test_a_tail_that_runs_into_its_stop_has_a_swing_file():
    """It arrives fast, and the cubic between the knots goes beyond the stop; so does the pitch."""
    swing = read_swing(INSIDE)
    rolls = np.array([-0.25, -0.72, -1.32, *[-1.571] * 6])
    knots = with_tail(swing, np.array([-1.6, *rolls])).knots
    assert np.array(knots.roll_position_rad[1:]) == pytest.approx(rolls, abs=0.05)
    assert min(knots.pitch_position_rad) >= -swing.limits.pitch_position_rad
