"""The tip of the tail stands where the joints put it."""

from __future__ import annotations

import numpy as np
import pytest

from aerodima.optimisation.swing.verification_report import plot_tip_path, tip_position
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.law_of_scenario import find_swing

QUARTER = np.pi / 2


@pytest.mark.parametrize(
    ("roll", "pitch", "direction"),
    [(0.0, 0.0, (0, 0, 1)), (-QUARTER, 0.7, (0, 1, 0)), (QUARTER, 0.0, (0, -1, 0)), (0.0, QUARTER, (1, 0, 0))],
)
def test_roll_is_to_the_right_and_pitch_forwards(roll: float, pitch: float, direction: tuple[int, int, int]) -> None:
    scenario = load_scenario("turn_swing")
    tail = scenario.tail
    joints = np.array([tail.mount_x, 0.0, tail.mount_height])
    assert tip_position(roll, pitch, scenario) == pytest.approx(joints + tail.length * np.array(direction))


def test_a_swing_over_the_top_is_drawn_from_left_to_right_and_mirrored_for_a_right_turn() -> None:
    swing = find_swing("thesis_8_rad_per_s")
    for direction, sign in (("left", 1.0), ("right", -1.0)):
        scenario = load_scenario("turn_swing", [f"manoeuvre.direction={direction}"])
        image, length = plot_tip_path(swing, scenario), scenario.tail.length
        behind = image.axes[0]
        path = behind.get_lines()[2].get_xdata()
        assert sign * path[0] == pytest.approx(-length, abs=0.01)
        assert sign * path[-1] == pytest.approx(length, abs=0.01)
        assert behind.get_ylim()[1] > length + scenario.tail.mount_height
