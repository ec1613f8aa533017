"""Search on the full car: what is varied, and that it stays possible."""

import numpy as np
import pytest

from aerodima.optimisation.swerve.suite import BOUND, FOLDED, ensemble_cases
from aerodima.optimisation.swing.full_runs import Descent
from aerodima.optimisation.swing.full_search import (
    NO_CHANGE,
    ROUND,
    TAIL_RANGES,
    FullSearch,
    varied_swing,
)
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.swing_file import read_swing, swing_at

INSIDE = model_path("swings/inside_8_rad_per_s.yaml")
STEERING = [0.1, 0.05, -0.02, 0.2, 0.4]


def search(motion=None):
    (case,) = ensemble_cases("physical", "test", 1, "built", [1.2])
    result = {"score": 0.4, "steering": STEERING, "variant": 0}
    candidate = FOLDED if motion is None else BOUND
    descent = Descent(candidate, case, 6.0, "aside-0.5", (), result, motion=motion)
    return FullSearch.from_descent(descent, 0.9)


def test_a_swing_is_scaled_in_roll_and_time_and_moved_in_pitch():
    swing = read_swing(INSIDE)
    times = np.linspace(0.0, 0.5, 11)
    varied = varied_swing(swing, np.array([0.5, 2.0, -0.3]))
    before = swing_at(swing, times / 2.0)
    after = swing_at(varied, times)
    assert after.roll_position == pytest.approx(0.5 * before.roll_position)
    assert after.pitch_position == pytest.approx(before.pitch_position - 0.3)
    assert swing_at(varied_swing(swing, np.array(NO_CHANGE)), times).roll_position == pytest.approx(
        swing_at(swing, times).roll_position
    )
    beyond = varied_swing(swing, np.array([1.5, 1.0, 0.0])).knots.roll_position_rad
    assert min(beyond) == pytest.approx(-swing.limits.roll_position_rad)


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
