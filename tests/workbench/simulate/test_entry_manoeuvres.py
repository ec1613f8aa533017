"""The manoeuvres that begin rolling, on the full car."""

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.paths import keeps_path, off_path, path_of
from aerodima.workbench.metrics.turn_metrics import outcome_of
from aerodima.workbench.metrics.turn_signals import steered_windows, turn_window
from aerodima.workbench.simulate.car_run import turn_end
from aerodima.workbench.simulate.simulation import simulate

SLIPPING = ("tail.mode=none", "car.tyre_slip_angle=0.2")
"""Tyres of a published 1:10 car (cornering stiffness of 5 per rad and load)."""
POSE = ("position_x_truth_m", "position_y_truth_m", "yaw_truth_rad")


@pytest.mark.parametrize("name", ["entry_lane_change", "entry_corner"])
def test_full_car_without_tail_keeps_the_path_at_2_m_per_s(name: str) -> None:
    """With tyres that slip; a bicycle with the same tyres keeps it by 10 and 22 mm, this car by 8 and 22 mm."""
    scenario = load_scenario(name, SLIPPING)
    run = simulate(scenario, record="outcome")
    assert outcome_of(run).result == "survived"
    path, car, pose = path_of(scenario), scenario.car, [run.signal(column) for column in POSE]
    half_width = 0.5 * (car.track + car.tyre_width)
    assert keeps_path(path, *pose, half_width, car.wheelbase)
    assert -0.04 < np.max(off_path(path, *pose, half_width, car.wheelbase)) < 0.0
    assert turn_window(run) == pytest.approx((0.3, scenario.manoeuvre.duration))
    assert steered_windows(run)[0].side == 1.0


@pytest.mark.parametrize("record", ["all", "outcome"])
def test_a_rolling_start_has_its_speed_at_time_0_and_no_jolt(record: str) -> None:
    """Both kinds of run begin so. The car stands on its springs as at rest and its wheels do not slip, so that forward
    acceleration stays below a hundredth of 1 m/s2; at rest with this throttle the governor would give 5 m/s2."""
    scenario = load_scenario("entry_turn", ["tail.mode=held", "manoeuvre.duration=0.25"])
    run = simulate(scenario, record=record)
    speed = run.signal("velocity_x_truth_m_per_s")
    assert speed[0] == scenario.manoeuvre.speed
    rows = run.time < 0.25
    assert np.max(np.abs(speed[rows] - speed[0])) < 0.01 * speed[0]
    assert np.max(np.abs(run.signal("acceleration_x_truth_m_per_s2")[rows])) < 0.3


def test_the_tail_waits_where_it_does_before_a_turn_from_rest() -> None:
    at_rest, rolling = (
        simulate(load_scenario(name, ["manoeuvre.duration=0.02"])) for name in ("turn_swing", "entry_turn")
    )
    for column in ("tail_roll_angle_rad", "tail_pitch_angle_rad", "tail_roll_rate_rad_per_s"):
        assert rolling.signal(column)[0] == pytest.approx(at_rest.signal(column)[0], abs=1e-9)


def test_two_turns_end_after_the_second_and_other_kinds_with_their_run() -> None:
    """0.3 + 0.5 + 1 + 0.5 s, 0.14 s of the servo, a frame of 10 ms and a row of 2 ms."""
    assert turn_end(load_scenario("entry_twice")) == pytest.approx(2.3 + 0.14 + 0.012)
    for name in ("entry_fishhook", "entry_corner", "entry_lane_change", "entry_slalom", "entry_rising_steer"):
        scenario = load_scenario(name)
        assert turn_end(scenario) == scenario.manoeuvre.duration
