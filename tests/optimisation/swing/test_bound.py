"""Bound of the entry speed on a path: its motion reaches the tail, and its command names what it
cannot do.
"""

import numpy as np
import pytest

from aerodima.optimisation.judge.reduced_entries import gains_of, reduced_cars
from aerodima.optimisation.judge.suite import FEEDBACK, make_surfaces, select_manoeuvres
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swing import bound
from aerodima.optimisation.swing.bound import CANDIDATE_NAMES, paths, search_bound
from aerodima.workbench.car.reduced.entry_runs import (
    EntryRollout,
    PathMotion,
    at_speeds,
    interpolate_knots,
    simulate_entries,
)
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

CAR = load_ensemble("physical").split(1).test[0]
(CORNER,) = select_manoeuvres(["corner"], "designed")
SCENARIO = load_scenario(CORNER.scenario, (*CORNER.settings, *FEEDBACK.settings))


def motion_of(roll, pitch):
    one = np.ones(1)
    return PathMotion(
        0.28 * one, 1.2 * one, 0.1 * one, np.full((12, 1), roll), np.full((4, 1), pitch)
    )


def test_values_between_places_are_linear():
    places = np.array([[0.0], [2.0], [1.0]])
    assert [
        interpolate_knots(np.array([share]), places)[0] for share in (0.0, 0.25, 0.5, 0.75, 1.0)
    ] == [
        0.0,
        1.0,
        2.0,
        1.5,
        1.0,
    ]


@pytest.mark.slow
def test_the_tail_goes_where_the_motion_says_and_the_path_is_counted_from_its_end():
    car = at_speeds(
        reduced_cars(CORNER, [tuple(CAR.settings_on(CORNER.scenario))], FEEDBACK), np.array([1.6])
    )
    gains = gains_of([{}], SCENARIO)
    entering = EntryRollout(car, SCENARIO, gains, np.ones(1), motion_of(0.5, -0.4))
    for step in range(300):
        if step % 5 == 0:
            entering.tick(0.002 * step, 0.0)
        entering.step(0.002 * step, 0.0, 1.0, 0.0)
    assert entering.state[6:8, 0] == pytest.approx([-0.4, 0.5], abs=0.2)
    assert entering.whole - entering.to_go == pytest.approx(1.6 * 0.6, rel=0.05)
    slow = simulate_entries(car, SCENARIO, gains, np.ones(1), motion_of(0.0, -1.0))
    fast = simulate_entries(
        at_speeds(car, np.array([4.0])), SCENARIO, gains, np.ones(1), motion_of(0.0, -1.0)
    )
    assert slow.completed[0]
    assert slow.progress[0] > 0.95
    assert not fast.completed[0]
    assert 0.1 < fast.progress[0] < 0.9


@pytest.mark.slow
def test_the_bound_is_never_below_the_law_and_repeats():
    cases = make_surfaces([CAR], [1.2])
    table = search_bound(["corner"], cases, "designed", 1, 1, CachedRunner())
    assert list(table) == ["manoeuvre", "car", "floor", *CANDIDATE_NAMES]
    (row,) = table.to_dict("records")
    assert row["bound"] >= row["feedback"] > 1.5
    assert row["low-ballast"] > 2.0
    assert table.equals(search_bound(["corner"], cases, "designed", 1, 1, CachedRunner()))


def test_starts_differ_by_their_seed_and_the_bound_is_no_lower_than_the_law(monkeypatch):
    """A bound that was searched worse than the law counts as the law's; every start is run once."""

    def speed(start):
        return {"bound": 1.0 + start.seed, "feedback": 2.5}.get(start.candidate, 2.0)

    monkeypatch.setattr(bound, "best_speed", speed)
    runs = CachedRunner()
    cases = make_surfaces([CAR], [1.2])
    (one,), (three,) = (
        search_bound(["corner"], cases, "designed", starts, 1, runs).to_dict("records")
        for starts in (1, 3)
    )
    assert (one["bound"], three["bound"], three["feedback"]) == (2.5, 3.0, 2.5)
    again = CachedRunner()
    search_bound(["corner"], cases, "designed", 3, 1, again)
    assert again.ran == runs.ran, "what is there of one start is not run again for three"


def test_a_manoeuvre_without_a_path_has_no_bound():
    assert paths() == ["lane-change", "corner"]
    assert_refused(lambda: paths(["turn"]), SweepError, "turn", "lane-change", "corner")
