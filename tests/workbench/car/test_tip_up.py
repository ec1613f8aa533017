"""Lifts and contacts made by hand, whose largest values are known."""

import numpy as np
import pytest

from aerodima.workbench.car.tip_up import LIFT_COLUMNS, tip_up
from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.car.verdict import side_lift
from tests.workbench.made_up_runs import made_up_run, times

LEFT_FRONT, RIGHT_FRONT, LEFT_REAR, RIGHT_REAR = range(4)


def tip_up_in_turn(run):
    signals = turn_signals(run, "truth")
    return tip_up(run, [(*signals.window, signals.sign)])


@pytest.mark.parametrize("side", [(LEFT_FRONT, LEFT_REAR), (RIGHT_FRONT, RIGHT_REAR)])
def test_a_side_is_as_high_as_its_lower_wheel_at_the_best_instant(side):
    lifts = np.full((4, 3), -0.001)
    lifts[side, 1] = 0.004, 0.009
    lifts[side, 2] = 0.030, 0.002
    assert np.max(side_lift(lifts)) == 0.004


@pytest.mark.parametrize("axle_or_diagonal", [(0, 1), (2, 3), (0, 3), (1, 2)])
def test_two_wheels_of_two_sides_are_no_tip_up(axle_or_diagonal):
    lifts = np.full((4, 2), -0.001)
    lifts[axle_or_diagonal, 1] = 0.05
    assert np.max(side_lift(lifts)) == -0.001


@pytest.mark.parametrize("direction", ["left", "right"])
def test_a_run_counts_from_the_start_of_its_steering(direction):
    steered = times() >= 2.0
    run = made_up_run({}, direction)
    assert tip_up_in_turn(run).side_lift_m is None
    assert tip_up_in_turn(run).touched_when_steered == ""
    for column in LIFT_COLUMNS:
        run.table[column] = np.where(steered, 0.003, 0.5)
    run.table["ground_contact_tail_truth_n"] = np.where(steered, 0.0, 5.0)
    found = tip_up_in_turn(run)
    assert (found.side_lift_m, found.touched_when_steered) == (0.003, "")
    run.table["ground_contact_tail_truth_n"] = 5.0
    assert tip_up_in_turn(run).touched_when_steered == "tail"


def test_the_board_counts_while_the_car_is_steered_and_the_tail_always():
    run = made_up_run({"gyro_z_truth_rad_per_s": np.zeros_like(times())}, "left")
    after = np.where(times() > 3.0, 5.0, 0.0)
    run.table["ground_contact_board_truth_n"] = after
    assert tip_up(run, [(2.0, 2.6, 1)]).touched_when_steered == ""
    assert tip_up(run, [(2.0, 3.5, 1)]).touched_when_steered == "board"
    run.table["ground_contact_tail_truth_n"] = after
    assert tip_up(run, [(2.0, 2.6, 1)]).touched_when_steered == "tail"
    assert tip_up(run, []).touched_when_steered == "tail", "a car that is never steered"
