import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from aerodima.workbench.car.turn_signals import (
    settled_row,
    steered_windows,
    turn_sign,
    turn_signals,
    turn_window,
)
from aerodima.workbench.car.verdict import CALM
from aerodima.workbench.control.manoeuvre import make_schedule
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.scenario.scenario import load_scenario
from tests.workbench.made_up_runs import both_sides, made_up_run, times

STEER = math.radians(30.0)


def commanded(name, *settings):
    """Steering commands of a schedule at the rows of a made-up run."""
    schedule = make_schedule(load_scenario(name, settings))
    return np.array([schedule.at(time).steering_angle for time in times()])


def fishhook():
    t = times()
    return np.select([t < 0.3, t < 0.8, t < 2.0], [0.0, STEER, -STEER], 0.0)


@pytest.mark.parametrize(
    ("steering", "expected", "error"),
    [
        (commanded("entry_twice"), [(0.3, 0.8, 1.0), (1.8, 2.3, 1.0)], 1e-9),
        (fishhook(), [(0.3, 0.8, 1.0), (0.8, 2.0, -1.0)], 1e-9),
        (
            commanded("entry_slalom"),
            [(0.3, 1.3, 1.0), (1.3, 2.3, -1.0), (2.3, 3.3, 1.0), (3.3, 4.0, -1.0)],
            0.0021,
        ),
    ],
    ids=["two turns", "fishhook", "slalom"],
)
def test_windows_are_the_steered_times_with_their_sides(steering, expected, error):
    """Half waves of a slalom last 1 s from 0.3 s on; a row of 2 ms may belong to either side of a
    zero, and the log ends at 4 s.
    """
    windows = steered_windows(times(), steering)
    assert_allclose(windows, expected, atol=error)


def test_a_trembling_hand_is_no_steering_and_a_straight_run_has_no_window():
    time = np.arange(100) * 0.01
    assert steered_windows(time, 0.009 * np.sin(20.0 * time)) == []
    assert steered_windows(time, np.zeros(100)) == []
    assert steered_windows(np.zeros(0), np.zeros(0)) == []
    assert steered_windows(time, np.full(100, -0.2)) == [(0.0, 0.99, -1.0)], "all the time"


def test_window_of_two_turns_reaches_until_the_wheels_are_straight_after_the_second():
    """0.5 s twice with 1 s in between from 2.0 s on would end behind the log, from 0.3 s on at 2.3
    s + 0.14 s.
    """
    run = made_up_run(
        {"steering_command_rad": commanded("entry_twice")}, turn_start=0.3, turns=2, turn_gap=1.0
    )
    assert turn_window(run) == pytest.approx((0.3, 2.44))


def test_window_of_a_fishhook_ends_with_straight_wheels_after_the_logged_command():
    """The last steered row is 2 ms before 2.0 s; the servo needs 0.14 s."""
    run = made_up_run({"steering_command_rad": fishhook()}, kind="fishhook", turn_start=0.3)
    assert turn_window(run) == pytest.approx((0.3, 1.998 + 0.14))
    held = np.where(times() >= 0.3, STEER, 0.0)
    run = made_up_run({"steering_command_rad": held}, kind="fishhook", turn_start=0.3)
    assert turn_window(run) == pytest.approx((0.3, 4.0)), (
        "never counter-steered: to the end of the log"
    )


@pytest.mark.parametrize("kind", ["path", "rising"])
def test_window_of_a_path_or_a_rising_angle_is_the_run_from_its_start(kind):
    assert turn_window(made_up_run(kind=kind, turn_start=0.3)) == pytest.approx((0.3, 4.0))


@pytest.mark.parametrize("kind", ["turn", "fishhook", "path", "rising"])
def test_sign_is_that_of_the_first_steering(kind):
    assert turn_sign(made_up_run(kind=kind)) == 1.0
    assert turn_sign(made_up_run(kind=kind, direction="right")) == -1.0


TURN_END = 2.64
"""Of a made-up run, s."""


def settled_at(**signals):
    """When a car with these signals has settled, s."""
    table = made_up_run(signals).table
    row = settled_row(table, TURN_END)
    return None if row is None else table["time_s"][row]


def until(time, value, after=0.0):
    return np.where(times() < time, value, after)


@pytest.mark.parametrize(
    "restless",
    [
        *({name: until(3.0, 1.01 * limit)} for name, limit in CALM.items()),
        *({name: until(3.0, -1.01 * limit)} for name, limit in CALM.items()),
        {"controller_state": until(3.0, SwingState.DELAY, SwingState.HOLD)},
        {"controller_state": until(3.0, SwingState.SWING, SwingState.HOLD)},
        {"wheel_force_rear_left_z_truth_n": until(3.0, 0.05, 15.0)},
        {"gyro_x_truth_rad_per_s": until(2.9, 1.0) + np.where(np.isclose(times(), 2.998), 1, 0)},
    ],
)
def test_a_car_has_settled_when_nothing_moved_for_a_tenth_of_a_second(restless):
    """The last restless row is 2 ms before 3 s: whatever moves, whichever wheel lifts, and also
    while the law swings or is about to.
    """
    assert settled_at(**restless) == pytest.approx(2.998 + 0.1)


def test_a_calm_car_has_settled_a_tenth_after_its_turn_and_not_before():
    assert settled_at() == pytest.approx(TURN_END + 0.1)
    assert settled_at(gyro_x_truth_rad_per_s=until(9.0, 0.16)) is None
    assert settled_at(gyro_x_truth_rad_per_s=until(9.0, 0.14)) == pytest.approx(TURN_END + 0.1)
    assert settled_row(made_up_run(truth=False).table, TURN_END) is None, "a real car"


@both_sides
def test_the_bias_of_the_gyro_is_that_of_the_straight_driving_before_the_turn(direction, side):
    """What the car did in the first half of it, while it gathered speed, is no bias."""
    rolling = np.where(times() >= 2.1, 0.3, 0.0)
    rate = rolling + 0.05 + until(0.9, 0.4)
    run = made_up_run({"imu_gyro_x_rad_per_s": side * rate}, direction, truth=False)
    found = turn_signals(run).roll_rate
    assert_allclose(found[times() >= 1.0], rolling[times() >= 1.0], atol=1e-12)


def test_tilt_from_the_sensors_is_that_of_roll_and_pitch_together():
    run = made_up_run({"imu_roll_rad": 0.6, "imu_pitch_rad": -0.8}, truth=False)
    assert_allclose(turn_signals(run).tilt, math.acos(math.cos(0.6) * math.cos(0.8)))
