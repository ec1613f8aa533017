"""One swing for several cars, and gains that are made with the swing: what the cars are, and that both come out."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest

from aerodima.optimisation.sweep.study_engine import SerialRunEngine
from aerodima.optimisation.swing import feedback_gains, full_car
from aerodima.optimisation.swing.full_car import DriveOutcome, drive_all, varied
from aerodima.optimisation.swing.search_state import SearchOptions, cars_of
from aerodima.optimisation.swing.swing_search import optimise_swing
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.swing_file import SwingFile, read_swing
from aerodima.workbench.errors import SwingError
from aerodima.workbench.resources import model_path

SETTINGS = ("manoeuvre.speed=4.5", "manoeuvre.turn_start=1.6", "manoeuvre.duration=3.2", "simulation.step=0.004")


def turn(*settings: str) -> Scenario:
    return load_scenario("turn_designed", [*SETTINGS, "simulation.log_rate=250", *settings])


def test_every_car_has_as_many_times_its_own_friction() -> None:
    own = turn().car.tyre_friction
    scenario = turn(f"car.tyre_friction={1.2 * own!r}")
    cars = cars_of(scenario, SearchOptions(members=3))
    members = load_ensemble().drawn(3)
    assert len(cars) == 1 + len(members)
    for car, member in zip(cars[1:], members, strict=True):
        assert car.car.tyre_friction == pytest.approx(1.2 * float(member.values["car.tyre_friction"]))
        assert car.car.com_height == pytest.approx(float(member.values["car.com_height"]))
        assert car.manoeuvre == scenario.manoeuvre


def test_a_swing_for_several_cars_is_as_good_as_on_the_worst_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    cars = [varied(turn(), car={"tyre_friction": friction}) for friction in (0.6, 0.9)]
    driven = []

    def drive(_scenario: Scenario, _swing: Any, friction: float) -> DriveOutcome:
        driven.append(friction)
        return DriveOutcome(friction < 1.0, True, friction, 1.0 - friction / 10, 2.0 + friction)

    monkeypatch.setattr(full_car, "drive", drive)
    monkeypatch.setattr(full_car, "outcome", lambda found: found)
    engine = SerialRunEngine()
    worst, other = islice(drive_all(cars, None, [(0.7, 4.5), (0.6, 4.5), (0.5, 4.5)], engine), 2)
    assert driven == pytest.approx([0.7, 1.05, 0.6, 0.9])  # nobody asked for the third
    assert other.clean
    assert (worst.clean, worst.survived) == (False, True)
    assert (worst.peak_roll, worst.heading, worst.released) == pytest.approx((1.05, 0.895, 2.7))


def with_figures(**found: float) -> SwingFile:
    swing = read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))
    return swing.model_copy(update={"provenance": swing.provenance.model_copy(update={"found": found})})


def test_gains_are_made_where_the_swing_was_seen_to_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Scenario] = []

    def make(swing: SwingFile, scenario: Scenario) -> SwingFile:
        asked.append(scenario)
        return swing.model_copy(update={"name": "with gains"})

    monkeypatch.setattr(feedback_gains, "with_feedback", make)
    swing = with_figures(survived_friction=0.72, survived_speed_m_per_s=4.2)
    assert feedback_gains.with_gains(swing, turn(), print).name == "with gains"
    assert (asked[0].car.tyre_friction, asked[0].manoeuvre.speed) == (0.72, 4.2)


def test_a_swing_without_gains_is_kept_and_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> SwingFile:
        raise SwingError("the car rolls over")

    monkeypatch.setattr(feedback_gains, "with_feedback", refuse)
    told: list[str] = []
    swing = with_figures()
    assert feedback_gains.with_gains(swing, turn(), told.append) == swing
    assert told == ["no feedback: the car rolls over"]


@pytest.mark.slow
def test_two_cars_get_one_swing_with_gains_that_both_survive() -> None:
    scenario = turn("controller.swing_speed=6.0", "car.tyre_friction=0.65")
    options = SearchOptions(members=1, rounds=1, starts=1, knots=21, threshold=0.5, bound=0.02, feedback=True)
    swing = optimise_swing(scenario, options, name="both")
    cars = cars_of(varied(scenario, tail={"mode": "swing"}), options)
    assert len(cars) == 2
    facts = swing.provenance.found
    place = float(facts["survived_friction"]), float(facts["survived_speed_m_per_s"])
    (found,) = drive_all(cars, swing, [place], SerialRunEngine())
    assert found.clean
    assert found.peak_roll == pytest.approx(float(swing.provenance.found["peak_roll_rad"]), abs=0.02)
    gains = swing.gains.feedback
    assert gains is not None
    assert np.all(np.isfinite(gains.roll_gains))
