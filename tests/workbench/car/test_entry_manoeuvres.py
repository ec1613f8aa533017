"""The manoeuvres that begin rolling, on the full car."""

import numpy as np
import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.termination import turn_end
from aerodima.workbench.car.tip_up import path_row
from aerodima.workbench.car.turn_signals import steered_windows, turn_window
from aerodima.workbench.metrics.turn_metrics import outcome_of
from aerodima.workbench.scenario.scenario import load_scenario

SLIPPING = ("tail.mode=none", "car.tyre_slip_angle=0.2")
"""Tyres of a published 1:10 car (cornering stiffness of 5 per rad and load)."""


@pytest.mark.parametrize("name", ["entry_lane_change", "entry_corner"])
def test_full_car_without_tail_keeps_the_path_at_2_m_per_s(name):
    """With tyres that slip.

    Measured: by 10 mm in the lane change, which leaves the car 27 mm to either side, and by 26 in
    the corner.
    """
    scenario = load_scenario(name, SLIPPING)
    run = simulate(scenario, record="outcome")
    assert outcome_of(run).result == "survived"
    row = path_row(run, scenario)
    assert row["path_end_reached"]
    assert -0.04 < row["off_path_m"] < 0.0
    assert turn_window(run) == pytest.approx((0.3, scenario.manoeuvre.duration))
    assert steered_windows(run.time, run.signal("steering_command_rad"))[0].side == 1.0


@pytest.mark.parametrize("record", ["all", "outcome"])
@pytest.mark.parametrize(("mode", "jolt"), [("none", 1e-4), ("held", 0.2)])
def test_a_rolling_start_has_its_speed_at_time_0_and_no_jolt(record, mode, jolt):
    """Springs stand as at rest and no wheel slips, so that a car without tail is in equilibrium
    (measured: 3e-6 m/s2).

    The tail's motors take up its weight in the first steps, as in a run from rest (measured: 0.11
    m/s2). A start at rest with this throttle would accelerate by several m/s2.
    """
    scenario = load_scenario("entry_turn", [f"tail.mode={mode}", "manoeuvre.duration=0.25"])
    run = simulate(scenario, record=record)
    speed = run.signal("velocity_x_truth_m_per_s")
    assert speed[0] == scenario.manoeuvre.speed
    assert np.max(np.abs(speed - speed[0])) < 0.01 * speed[0]
    assert np.max(np.abs(run.signal("acceleration_x_truth_m_per_s2"))) < jolt


def test_the_tail_waits_where_it_does_before_a_turn_from_rest():
    at_rest, rolling = (
        simulate(load_scenario(name, ["manoeuvre.duration=0.02"]))
        for name in ("turn_swing", "entry_turn")
    )
    for column in ("tail_roll_angle_rad", "tail_pitch_angle_rad", "tail_roll_rate_rad_per_s"):
        assert rolling.signal(column)[0] == pytest.approx(at_rest.signal(column)[0], abs=1e-9)


def test_two_turns_end_after_the_second_and_other_kinds_with_their_run():
    """0.3 + 0.5 + 1 + 0.5 s, 0.14 s of the servo, a frame of 10 ms and a row of 2 ms."""
    assert turn_end(load_scenario("entry_twice")) == pytest.approx(2.3 + 0.14 + 0.012)
    for name in (
        "entry_fishhook",
        "entry_corner",
        "entry_lane_change",
        "entry_slalom",
        "entry_rising_steer",
    ):
        scenario = load_scenario(name)
        assert turn_end(scenario) == scenario.manoeuvre.duration
