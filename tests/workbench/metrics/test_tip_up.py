"""Lifts and yaw rates made by hand, whose largest values and means are known."""

import numpy as np
import pytest

from aerodima.workbench.config.signal_table import WHEELS
from aerodima.workbench.metrics.tip_up import LIFT_COLUMNS, side_lift, steered_yaw_rate, tip_up
from tests.workbench.made_up_runs import made_up_run, times

LEFT_FRONT, RIGHT_FRONT, LEFT_REAR, RIGHT_REAR = range(4)


@pytest.mark.parametrize("side", [(LEFT_FRONT, LEFT_REAR), (RIGHT_FRONT, RIGHT_REAR)])
def test_a_side_is_as_high_as_its_lower_wheel_at_the_best_instant(side):
    lifts = np.full((3, 4), -0.001)
    front, rear = side
    lifts[1, front], lifts[1, rear] = 0.004, 0.009
    lifts[2, front], lifts[2, rear] = 0.030, 0.002
    assert side_lift(lifts) == 0.004


@pytest.mark.parametrize("axle_or_diagonal", [(0, 1), (2, 3), (0, 3), (1, 2)])
def test_two_wheels_of_two_sides_are_no_tip_up(axle_or_diagonal):
    lifts = np.full((2, 4), -0.001)
    lifts[1, axle_or_diagonal] = 0.05
    assert side_lift(lifts) == -0.001


def test_yaw_rate_counts_into_each_turn_and_by_its_length():
    time = np.arange(0.0, 4.0, 0.01)
    yaw_rate = np.select([time <= 1.0, (time >= 2.0) & (time <= 2.5)], [2.0, -1.0], 9.0)
    assert steered_yaw_rate(time, yaw_rate, [(0.0, 1.0, 1), (2.0, 2.5, -1)]) == pytest.approx(2.5 / 1.5)
    assert steered_yaw_rate(time, yaw_rate, [(0.0, 1.0, -1)]) == pytest.approx(-2.0)
    assert steered_yaw_rate(time, yaw_rate, [(3.5, 9.0, 1)]) == pytest.approx(9.0), "as far as the samples go"
    assert steered_yaw_rate(time, yaw_rate, [(5.0, 6.0, 1)]) is None


@pytest.mark.parametrize(("direction", "side"), [("left", 1.0), ("right", -1.0)])
def test_a_run_counts_from_the_start_of_its_steering(direction, side):
    steered = times() >= 2.0
    yaw_rate = side * np.where((times() >= 2.0) & (times() <= 2.64), 1.5, -7.0)
    run = made_up_run({"gyro_z_truth_rad_per_s": yaw_rate}, direction)
    assert tip_up(run).side_lift_m is None
    assert tip_up(run).touched_when_steered == ""
    for column in LIFT_COLUMNS:
        run.table[column] = np.where(steered, 0.003, 0.5)
    run.table["ground_contact_tail_truth_n"] = np.where(steered, 0.0, 5.0)
    found = tip_up(run)
    assert (found.side_lift_m, found.touched_when_steered) == (0.003, "")
    assert found.steered_yaw_rate_rad_per_s == pytest.approx(1.5)
    run.table["ground_contact_tail_truth_n"] = 5.0
    assert tip_up(run).touched_when_steered == "tail"


def test_the_board_counts_while_the_car_is_steered_and_the_tail_always():
    run = made_up_run({"gyro_z_truth_rad_per_s": np.zeros_like(times())}, "left")
    after = np.where(times() > 3.0, 5.0, 0.0)
    run.table["ground_contact_board_truth_n"] = after
    assert tip_up(run, [(2.0, 2.6, 1)]).touched_when_steered == ""
    assert tip_up(run, [(2.0, 3.5, 1)]).touched_when_steered == "board"
    run.table["ground_contact_tail_truth_n"] = after
    assert tip_up(run, [(2.0, 2.6, 1)]).touched_when_steered == "tail"
    assert tip_up(run, []).touched_when_steered == "tail", "a car that is never steered"


def test_the_last_yaw_rate_is_that_of_the_end_where_nothing_is_steered():
    end = times()[-1]
    run = made_up_run({"gyro_z_truth_rad_per_s": np.where(times() > end - 0.201, -0.3, 2.0)}, "left")
    assert tip_up(run).last_yaw_rate_rad_per_s == pytest.approx(-0.3)
    assert tip_up(run, [(end - 0.5, end - 0.1, 1)]).last_yaw_rate_rad_per_s is None


def test_columns_of_the_lifts_are_in_the_order_of_the_wheels():
    assert [name.removeprefix("wheel_lift_").removesuffix("_truth_m") for name in LIFT_COLUMNS] == list(WHEELS)
