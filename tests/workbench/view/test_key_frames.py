"""Five moments: those that a reader wants to see, in order, inside the log."""

from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench.view.filmstrip import key_frames
from tests.workbench.made_up_runs import made_up_run, times


def run_with(**signals):
    """A left turn from 2 s to 2.64 s; the yaw rate passes the trigger of 1 rad/s at 2.1 s."""
    yaw_rate = np.where((times() >= 2.1) & (times() < 2.7), 1.5, 0.0)
    run = made_up_run({"gyro_z_truth_rad_per_s": yaw_rate, **signals}, tail_mode="held")
    return replace(run, scenario={**run.scenario, "controller": {"trigger_yaw_rate": 1.0}})


def hump(peak_time, height, width=0.2):
    return height * np.exp(-0.5 * ((times() - peak_time) / width) ** 2)


def told(run):
    return {label: float(run.time[row]) for label, row in key_frames(run).items()}


def test_turn_that_is_survived():
    moments = told(run_with(roll_truth_rad=hump(2.6, 0.2)))
    assert list(moments) == [
        "before the turn",
        "turning in",
        "peak roll",
        "recovering",
        "after the turn",
    ]
    half = 2.6 + 0.2 * np.sqrt(2 * np.log(2))  # where the hump has half its height
    assert list(moments.values()) == pytest.approx([1.75, 2.1, 2.6, half, half + 0.75], abs=0.003)


def test_peak_is_that_of_the_roll_outwards():
    roll = hump(2.6, 0.2, 0.05) - hump(
        3.2, 0.5, 0.05
    )  # leans to the right first, then more, to the left
    assert told(run_with(roll_truth_rad=roll))["peak roll"] == pytest.approx(2.6, abs=0.003)


def test_swing_shows_the_tail_on_top():
    angle = np.radians(np.clip((times() - 2.2) * 450.0, 0.0, 180.0) - 90.0)  # upright at 2.4 s
    moments = told(run_with(roll_truth_rad=hump(2.6, 0.05), tail_roll_angle_rad=angle))
    assert list(moments) == [
        "before the turn",
        "turning in",
        "tail over the top",
        "peak roll",
        "after the turn",
    ]
    assert moments["tail over the top"] == pytest.approx(2.4, abs=0.004)


@pytest.mark.parametrize(
    "angle",
    [np.radians(5.0 * np.sin(30.0 * times())), hump(2.4, 1.2) - 0.05],
    ids=["about the middle", "to one side and back"],
)
def test_a_tail_that_does_not_change_sides_does_not_go_over_the_top(angle):
    moments = told(run_with(roll_truth_rad=hump(2.6, 0.2), tail_roll_angle_rad=angle))
    assert list(moments)[2:4] == ["peak roll", "recovering"]


def test_rollover():
    tilt = np.clip((times() - 2.2) * np.radians(90.0), 0.0, np.pi)  # 90 deg/s from 2.2 s on
    moments = told(run_with(tilt_truth_rad=tilt, roll_truth_rad=tilt))
    assert list(moments) == ["before the turn", "turning in", "tipping", "on its side", "after"]
    assert moments["tipping"] == pytest.approx(2.2 + 35 / 90, abs=0.003)
    assert moments["on its side"] == pytest.approx(3.2, abs=0.003)


def test_moments_are_in_order_inside_the_log_even_when_they_coincide():
    still_growing = run_with(roll_truth_rad=hump(4.0, 0.2))
    rows = list(key_frames(still_growing).values())
    assert rows == sorted(set(rows))
    assert rows[-1] <= times().size - 1


def test_log_that_ends_before_its_turn_is_shown_evenly():
    run = run_with()
    moments = key_frames(replace(run, table=run.table.iloc[:401]))
    assert list(moments.values()) == [0, 100, 200, 300, 400]
    assert next(iter(moments)) == "start"
