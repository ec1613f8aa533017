"""The map of the tail's range of motion, against geometry done by hand."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from aerodima.workbench.car.clearance import (
    PARTS,
    RangeOfMotion,
    TailQuery,
    ground_clearance,
    make_range_of_motion,
)
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

LIMIT = math.pi / 2


@pytest.fixture(scope="module")
def motion():
    joints = ["tail.mount_x=-0.03", "tail.mount_height=0.24"]
    return make_range_of_motion(load_scenario("turn_swing", joints), 13, 13)


@pytest.mark.parametrize("height", [0.15, 0.19, 0.24])
def test_the_rear_deck_leaves_the_tail_room_however_low_its_joints_are(height):
    """A lower deck than the drawn one would else stand in the tail at every angle."""
    query = TailQuery(load_scenario("turn_swing", [f"tail.mount_height={height}"]))
    for pitch in (-1.1, -0.5):
        deck = query.clearances(pitch, 0.0)[PARTS.index("deck")]
        assert deck > 0.01


def test_an_upright_tail_swings_freely_in_roll_and_backwards(motion):
    assert np.all(motion.clearance(0.0, motion.roll) > 0.02)
    assert np.all(motion.clearance(-0.7, motion.roll) > 0.02)


def test_a_tail_pitched_forwards_meets_the_rear_bar_of_the_cage(motion):
    """The bar is 80 mm ahead of and 80 mm above the joints, 6 mm thick like the rod: it is met near
    45 degrees.
    """
    cage = motion.clearance(np.radians([0.0, 15.0, 30.0, 45.0]), 0.0, ("cage",))
    by_hand = [
        math.hypot(0.08, 0.08) * math.sin(math.radians(45 - pitch)) - 0.012
        for pitch in (0, 15, 30, 45)
    ]
    assert_allclose(cage, by_hand, atol=2e-3)
    assert motion.clearance(0.8, 0.0) < 0.0 < motion.clearance(-0.8, 0.0), "forwards is positive"


def test_the_map_is_that_of_a_car_with_two_equal_sides(motion):
    for part in ("cage", "wheels"):
        there = motion.clearance(0.3, motion.roll, (part,))
        assert_allclose(there, there[::-1], atol=0.03)  # the drawn sail stands out to one side only


def test_ground_under_a_car_on_its_wheels_and_under_one_that_leans(motion):
    scenario = load_scenario("turn_swing")
    mount = scenario.tail.mount_height
    half_track = scenario.car.outer_half_track
    # A sail that turns sweeps 0.15 m about the rod: half of the shell and the board are behind the
    # bearing.
    assert scenario.tail.sail_reach == pytest.approx(
        (0.5 + scenario.tail.sail_board_share) * scenario.tail.sail_width - scenario.tail.sail_front
    )
    assert ground_clearance(scenario, 0.0, -LIMIT) == pytest.approx(
        mount - scenario.tail.sail_reach, abs=1e-6
    )
    flat = load_scenario("turn_swing", ["tail.sail=locked"])
    assert ground_clearance(flat, 0.0, -LIMIT) == pytest.approx(mount)
    assert ground_clearance(flat, LIMIT, LIMIT) == pytest.approx(
        mount - scenario.tail.sail_width / 2
    )
    assert motion.clearance(0.0, -LIMIT, ("ground",)) == pytest.approx(
        0.24 - scenario.tail.sail_reach, abs=5e-3
    ), "mounted at 0.24 m"
    scenario = flat
    leaning = float(ground_clearance(scenario, 0.0, LIMIT, 0.2))
    tip = (half_track - scenario.tail.length) * math.sin(0.2) + mount * math.cos(0.2)
    assert leaning == pytest.approx(tip), "a car that leans to the right lowers a tail on its right"
    assert float(ground_clearance(scenario, 0.0, -LIMIT, 0.2)) > leaning
    assert float(ground_clearance(scenario, 0.0, -LIMIT, -0.2)) == pytest.approx(leaning)


def test_between_the_nodes_it_is_linear_and_beyond_them_held():
    nodes = np.array([0.0, 1.0, 2.0])
    values = np.array([[0.0, 1.0, 2.0], [2.0, 3.0, 4.0], [4.0, 5.0, 6.0]])
    motion = RangeOfMotion(nodes, nodes, np.repeat(values[:, :, None], len(PARTS), axis=2))
    assert float(motion.clearance(0.5, 1.25)) == pytest.approx(2.25)
    assert float(motion.clearance(9.0, -9.0)) == 4.0
    assert motion.clearance(nodes[:, None], nodes[None, :]).shape == (3, 3)


def test_a_grid_of_too_few_nodes_is_refused():
    scenario = load_scenario("turn_swing")
    assert_refused(lambda: make_range_of_motion(scenario, 5, 2), UserError, "roll", "2", "3")
