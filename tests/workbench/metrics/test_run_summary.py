"""What a summary says of a run, its rows, and the published figures beside the runs that the thesis
made.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import PLANT_RUN, run_log_from_metadata, run_metadata
from aerodima.workbench.metrics.run_summary import (
    metrics_of_runs,
    plant_air,
    plant_metrics,
    plant_speed,
    published_for,
    summarise,
    tail_mode_of,
)
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import both_sides, made_up_run, times


def test_swing_times_come_from_the_state_of_the_controller():
    state = 1.0 + 2.0 * ((times() >= 2.2) & (times() < 2.5))  # 3 is SWING, 1 is HOLD
    summary = summarise(made_up_run({"controller_state": state}), "run")
    assert summary.trigger_time == pytest.approx(2.2)
    assert summary.swing_end_time == pytest.approx(2.498)  # the last row in which it still swings
    assert (SUMMARY.trigger_time, SUMMARY.swing_end_time) == (None, None)
    cut_off = summarise(made_up_run({"controller_state": 3.0 * (times() >= 3.0)}), "run")
    assert cut_off.trigger_time == pytest.approx(3.0)
    assert cut_off.swing_end_time is None


@both_sides
def test_peak_of_the_gyro_counts_into_the_turn(direction, side):
    # Into the turn 0.8 rad/s within the window, out of it 2 rad/s, and 5 rad/s after the window.
    gyro = side * (
        0.8 * (times() < 2.3) - 2.0 * ((times() >= 2.3) & (times() < 2.6)) + 5.0 * (times() > 2.7)
    )
    summary = summarise(made_up_run({"imu_gyro_z_rad_per_s": gyro}, direction=direction), "run")
    assert summary.peak_gyro == pytest.approx(0.8)


SUMMARY = summarise(made_up_run(), "run")


def driven(mode, speed):
    """Summary of a run with this tail mode and commanded speed, m/s."""
    return replace(SUMMARY, tail_mode=mode, commanded_speed=speed)


def test_only_the_runs_of_the_thesis_have_published_figures():
    # Commanded 12 km/h without tail: Tables 7.1 and 7.3; 16 km/h with the swing: Table 7.2.
    sources = {
        (mode, whole): {row.source for row in published_for(driven(mode, whole / 3.6)).values()}
        for mode in ("none", "held", "swing")
        for whole in range(12, 19)
    }
    assert sources.pop(("none", 12)) == {"Table 7.1", "Table 7.3"}
    assert sources.pop(("swing", 16)) == {"Table 7.2"}
    assert not any(sources.values())
    assert published_for(driven("none", 3.33))  # as the thesis rounds it
    assert not published_for(driven("none", 3.40))


def test_a_swing_from_a_file_is_a_mode_of_its_own_and_has_no_published_figures():
    played = {"swing_file": "thesis_8_rad_per_s"}
    assert tail_mode_of({"tail": {"mode": "swing"}, "controller": played}) == "optimised"
    assert tail_mode_of({"tail": {"mode": "swing", "name": "mine"}}) == "designed"
    assert tail_mode_of({"tail": {"mode": "held"}, "controller": played}) == "held"
    assert (
        tail_mode_of({"tail": {"mode": "swing"}, "controller": {"swing_file": "none"}}) == "swing"
    )
    assert not published_for(driven("optimised", 16 / 3.6))


def plant_log():
    """A body that goes round a quarter of a circle of 2 m in 1 s while it climbs 3 m, turned to the
    right, with two tails in the air.
    """
    time = np.arange(1001) / 1000.0
    angle = 0.5 * np.pi * time
    com = 2.0 * np.column_stack([np.cos(angle), np.sin(angle), 1.5 * time])
    velocity = np.column_stack([-np.pi * np.sin(angle), np.pi * np.cos(angle), np.full(1001, 3.0)])
    columns = {"time_s": time, "tilt_truth_rad": 0.2 * np.sin(np.pi * time)}
    columns["yaw_truth_rad"] = np.mod(-4.0 * time + np.pi, 2.0 * np.pi) - np.pi
    parts = {"com": (com, "m"), "com_velocity": (velocity, "m_per_s")}
    parts["left"] = (np.column_stack([6.0 * time, 0.0 * time, 8.0 * time]), "n")
    parts["right"] = (np.column_stack([np.cos(2 * np.pi * time), 0 * time, 0 * time]), "n")
    for stem, (values, unit) in parts.items():
        columns |= {f"{stem}_{a}_truth_{unit}": values[:, n] for n, a in enumerate("xyz")}
    tails = [{"name": name, "body": f"{name}_tail"} for name in ("left", "right")]
    metadata = run_metadata({"name": "plant"}, 0, kind=PLANT_RUN, extra={"tails": tails})
    return run_log_from_metadata(pd.DataFrame(columns), metadata, source="plant.parquet")


def test_metrics_of_a_plant_are_those_of_its_motion():
    expected = {
        "outcome": "survived",
        "duration_s": 1.0,
        "path_m": np.pi,  # over the ground
        "max_speed_m_per_s": np.hypot(np.pi, 3.0),
        "max_height_m": 3.0,
        "min_height_m": 0.0,
        "start_tilt_rad": 0.0,
        "max_tilt_rad": 0.2,
        "end_tilt_rad": 0.0,
        "run_heading_change_rad": -4.0,
        "left_max_n": 10.0,
        "left_impulse_n_s": 5.0,
        "right_max_n": 1.0,
        "right_impulse_n_s": 0.0,  # it pushes forwards as long as backwards
    }
    found = plant_metrics(plant_log())
    assert set(found) == set(expected)
    assert found.pop("outcome") == expected.pop("outcome")
    assert found == pytest.approx(expected, abs=1e-6)
    np.testing.assert_allclose(plant_speed(plant_log()), np.hypot(np.pi, 3.0))
    air = plant_air(plant_log())
    assert air[[0, 250, 1000]] == pytest.approx([1.0, 2.5, 11.0])


def test_runs_of_a_car_and_of_a_plant_are_told_apart():
    plant = plant_log()
    assert_refused(lambda: metrics_of_runs([plant, made_up_run()]), LogError, "plant.parquet")
    assert_refused(lambda: plant_metrics(made_up_run()), LogError, "'car_run'", "'plant_run'")
