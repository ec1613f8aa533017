"""Runs of the full car in a search: a straight is driven once for all frictions and swings that share it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from aerodima.optimisation.sweep.study_engine import SerialRunEngine, nearest_start
from aerodima.optimisation.swing import full_car
from aerodima.optimisation.swing.full_car import DriveOutcome, drive, outcome_of
from aerodima.optimisation.swing.search_state import SearchOptions, SwingSearch
from aerodima.optimisation.swing.swing_construction import changed, changes, constant_rate_swing
from aerodima.optimisation.swing.swing_search import _Work
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.swing_tracker_law import SwingTracker
from aerodima.workbench.errors import SwingError
from aerodima.workbench.simulate import car_run

SPEEDS = ("manoeuvre.speed=3.0", "controller.trigger_yaw_rate=0.7")


def turn(*settings: str) -> Scenario:
    return load_scenario("turn_designed", [*SPEEDS, *settings])


def swing(rate: float = 8.0) -> SwingFile:
    scenario = turn(f"controller.swing_speed={rate}")
    return constant_rate_swing("even", scenario, length=1.0, knots=41, provenance={"source": "test"})


@pytest.fixture
def straights(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Frictions at which a straight is driven; the car is taken to be restless at its end."""
    driven: list[float] = []
    monkeypatch.setattr(car_run, "rolling_start", lambda scenario, _law: driven.append(scenario.car.tyre_friction))
    return driven


def test_frictions_and_swings_that_wait_alike_share_two_straights(straights: list[float]) -> None:
    scenario = full_car.played_turn(turn("car.mass=7.01"))  # a car that no other test drives
    laws = [
        SwingTracker.from_scenario(changed(swing(rate), 0.1 * rate * np.eye(changes(1))[0]), scenario)
        for rate in (7.0, 8.0)
    ]
    for friction in (0.61, 0.64, 0.7, 0.79):
        for law in laws:
            assert nearest_start(scenario.varied(car={"tyre_friction": friction}), law, 0.2) is None
    assert straights == [0.6, 0.8]
    other = replace(laws[0], settings=laws[0].settings.model_copy(update={"ready_angle": 0.2}))
    nearest_start(scenario.varied(car={"tyre_friction": 0.7}), other, 0.2)
    assert straights == [0.6, 0.8, 0.6, 0.8]


class Counted(SerialRunEngine):
    """Runs come to what a function of (friction, from rest) says."""

    def __init__(self, clean: Callable[[float, bool], bool]) -> None:
        super().__init__()
        self._clean = clean
        self.driven: list[tuple[float, bool]] = []

    def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
        at_rest = function is outcome_of
        self.driven += [(round(friction, 6), at_rest) for _, _, friction in items]
        outcomes = [self._clean(friction, at_rest) for _, _, friction in items]
        return [DriveOutcome(clean, clean, 0.1, 0.7, 2.1) for clean in outcomes]


def work(engine: Counted, objective: Any = "friction") -> _Work:
    options = SearchOptions(objective=objective)
    cars = (turn("car.tyre_friction=0.5"),)
    return _Work(cars, options, None, "x", {}, 0.0, engine, lambda _line: None)  # type: ignore[arg-type]


def test_round_drives_upwards_from_a_rolling_start_until_the_first_run_that_is_not_clean() -> None:
    engine = Counted(lambda friction, _rest: friction < 0.525)
    search = SwingSearch(0.5, 3.0)
    work(engine)._drive(search, swing(), {})
    assert engine.driven == [(0.5, False), (0.51, False), (0.52, False), (0.53, False)]
    assert search.friction == pytest.approx(0.52)


def test_what_a_search_claims_is_driven_from_rest_and_lowered_until_it_is_clean_there() -> None:
    engine = Counted(lambda friction, rest: friction < (0.515 if rest else 0.525))
    search = SwingSearch(0.5, 3.0)
    work(engine)._drive(search, swing(), {})
    engine.driven.clear()
    assert search.swing is not None
    found = work(engine).proved(search, search.swing).provenance.found
    assert engine.driven == [(0.52, True), (0.5096, True)]
    assert found["survived_friction"] == pytest.approx(0.5096)
    with pytest.raises(SwingError, match=r"no run from rest is clean .* from 0\.520 down to 0\.447; allowed"):
        work(Counted(lambda _friction, _rest: False)).proved(search, search.swing)


def test_search_for_speed_drives_from_rest_and_each_place_once() -> None:
    engine = Counted(lambda _friction, rest: rest)
    search = SwingSearch(0.5, 3.0)
    work(engine, "speed")._drive(search, swing(), {})
    assert search.swing is not None
    work(engine, "speed").proved(search, search.swing)
    assert engine.driven == [(0.5, True)] * 5
    assert search.speed == pytest.approx(3.24)


def test_car_that_begins_rolling_comes_to_the_same_end() -> None:
    rest, rolling = (full_car.outcome(drive(turn(), swing(), 0.5, rolling=begun)) for begun in (False, True))
    assert (rest.clean, rest.survived) == (rolling.clean, rolling.survived) == (True, True)
    assert rolling.heading == pytest.approx(rest.heading, rel=0.01)
    assert rolling.peak_roll == pytest.approx(rest.peak_roll, rel=0.05)
