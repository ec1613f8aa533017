"""Threshold search on made-up survival: the step is bracketed, islands are reported."""

import math
from dataclasses import replace

import pytest

from aerodima.optimisation.studies.limit_search import LimitSearch
from aerodima.optimisation.studies.rollover_threshold import (
    FRICTION,
    TIPPED,
    critical_friction,
    find_threshold,
)
from aerodima.optimisation.studies.runs import CachedRunner, tipped_before_turn
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.core.errors import SweepError, UserError
from tests.certain_cars import HIGH_CAR
from tests.refusals import assert_refused


class MadeUp(Engine):
    """Survival, or a row, as a function of the friction instead of a run."""

    def __init__(self, survives):
        self.survives = survives
        self.runs = []

    def map(self, work, tasks, done=None, lost=None):
        for place, task in enumerate(tasks):
            value = float(dict(setting.split("=") for setting in task.settings)[FRICTION])
            self.runs.append(value)
            outcome = self.survives(value)
            done(place, outcome if isinstance(outcome, dict) else OUTCOMES[outcome])


OUTCOMES = {
    True: {"outcome": "survived", "error": ""},
    False: {"outcome": "flipped", "error": ""},
}
BROKEN = {"outcome": None, "error": "broken"}
SLOW = OUTCOMES[False] | {"speed_m_per_s": 0.5, "commanded_speed_m_per_s": 3.33}


def search(survives, **changes):
    engine = MadeUp(survives)
    settings = replace(LimitSearch(FRICTION, 0.4, 1.0, 0.1, 0.01), **changes)
    return find_threshold("turn_none", (), settings, CachedRunner(engine)), engine


def test_step_is_bracketed_within_the_tolerance_with_few_runs():
    found, engine = search(lambda friction: friction < 0.6537)
    assert found.found
    assert found.survived < 0.6537 <= found.lost
    assert found.lost - found.survived <= 0.01 + 1e-9
    assert found.value == pytest.approx(0.5 * (found.survived + found.lost))
    assert len(engine.runs) == len(set(engine.runs)) == 7 + 3 * 2
    assert found.islands == ()


def test_island_of_survivors_is_reported_and_not_taken_for_the_threshold():
    found, _ = search(lambda friction: friction < 0.55 or 0.75 < friction < 0.95)
    assert found.survived < 0.55 <= found.lost
    assert found.islands == ((0.8, 0.9),)


def test_threshold_outside_the_range_is_said_so():
    always, _ = search(lambda friction: True)
    never, _ = search(lambda friction: False)
    assert (always.lost, always.value, always.found) == (None, math.inf, False)
    assert (never.survived, never.value, never.found) == (None, -math.inf, False)


@pytest.mark.parametrize(("row", "words"), [(BROKEN, "failed: broken"), (SLOW, TIPPED)])
def test_a_run_that_failed_or_tipped_over_before_its_turn_is_counted_and_passed_over(row, words):
    found, _ = search(lambda friction: row if abs(friction - 0.5) < 1e-6 else friction < 0.72)
    assert found.survived < 0.72 <= found.lost
    assert found.outcomes[0.5] == words


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"low": 1.2}, ("low", "1.2")),
        ({"scan": 0.0}, ("scan", "0")),
        ({"tolerance": 0.2}, ("tolerance", "0.2")),
        ({"tolerance": math.nan}, ("tolerance", "nan")),
    ],
)
def test_impossible_search_is_refused(changes, named):
    assert_refused(lambda: search(lambda friction: True, **changes), SweepError, *named)


def test_scenario_that_cannot_be_resolved_is_refused_before_any_run():
    engine = MadeUp(lambda friction: True)
    assert_refused(
        lambda: critical_friction("turn_none", ["car.mass=-1"], engine), UserError, "car.mass", "-1"
    )
    assert engine.runs == []


@pytest.mark.parametrize(("speed", "tipped"), [(2.9, True), (3.1, False), (None, False)])
def test_a_car_that_has_not_reached_nine_tenths_of_its_speed_flipped_before_its_turn(speed, tipped):
    row = {"outcome": "flipped", "commanded_speed_m_per_s": 3.33, "speed_m_per_s": speed}
    assert tipped_before_turn(row) == tipped
    assert not tipped_before_turn(row | {"outcome": "survived"})


@pytest.mark.slow
def test_tailless_car_has_its_critical_friction_between_a_slippery_and_a_gripping_floor():
    settings = [*HIGH_CAR, "manoeuvre.speed=4.0"]
    found = critical_friction("turn_none", settings, low=0.5, high=0.8, scan=0.15, tolerance=0.05)
    assert found.found
    assert 0.5 <= found.survived < found.lost <= 0.8
