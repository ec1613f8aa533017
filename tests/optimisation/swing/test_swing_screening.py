"""Swings on reduced cars: in the order of the full car, or left alone, in words, where the model does not know them."""

from __future__ import annotations

import numpy as np
import pytest

from aerodima.optimisation.swing.full_car import Car, Reference
from aerodima.optimisation.swing.swing_construction import changed, changes, constant_rate_swing
from aerodima.optimisation.swing.swing_screening import SwingScreen
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.swing_file import SwingFile

SHORT = ("manoeuvre.duration=3.4",)


def swing() -> SwingFile:
    scenario = load_scenario("turn_designed", ["controller.swing_speed=8.0"])
    return constant_rate_swing("even", scenario, length=1.0, knots=41, provenance={"source": "test"})


def car(*settings: str) -> Car:
    return Car(load_scenario("turn_designed", [*SHORT, *settings]).resolved(), Reference(0.475, 0.30))


def test_swing_ranks_before_a_tail_that_stays_where_it_is() -> None:
    """Full car of `optimisation/swing/README.md`: clean to 0.4875 with the tail held, to 0.8875 at 8 rad/s."""
    screen = SwingScreen.of([car()], swing(), pytest.fail)
    assert screen is not None
    never = swing().model_copy(update={"trigger": swing().trigger.model_copy(update={"threshold_rad_per_s": 50.0})})
    swung, held = screen.costs([swing(), never], 0.75)
    assert swung < 1.0 < held


def test_swing_that_pitches_and_free_sail_are_refused_in_one_line() -> None:
    lines: list[str] = []
    pitched = changed(swing(), 0.5 * np.eye(changes(2))[-1], dof=2)
    assert SwingScreen.of([car()], pitched, lines.append) is None
    assert SwingScreen.of([car("tail.sail=free")], swing(), lines.append) is None
    assert [line.startswith("refinement: without screening, every candidate is driven") for line in lines] == [True] * 2
    assert "pitch" in lines[0]
    assert "tail.sail" in lines[1]
