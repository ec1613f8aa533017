"""The log of a real car moves as its sensors say."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.car.car_plant import own_instances
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import run_log_from_metadata, run_metadata
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.view.dead_reckoning import replayable
from aerodima.workbench.view.filmstrip import key_frames
from aerodima.workbench.view.logged_run import add_logged_run
from tests.refusals import assert_refused

TIMES = np.arange(301) / 100.0
SPEED, YAW_RATE = 3.0, 1.5


def circle(scenario="turn_held", **signals):
    """A car that drives a circle to the left at 3 m/s and 1.5 rad/s, heading 0.7 rad at first."""
    columns = {
        "time_s": TIMES,
        "speed_m_per_s": SPEED,
        "imu_yaw_rad": 0.7 + YAW_RATE * TIMES,
        **signals,
    }
    table = pd.DataFrame({name: values for name, values in columns.items() if values is not None})
    resolved = load_scenario(scenario).model_dump(mode="json", by_alias=True)
    return run_log_from_metadata(
        table, run_metadata(resolved, 0, kind="car_log"), source="car.parquet"
    )


def test_a_circle_is_driven_with_the_radius_of_speed_over_yaw_rate():
    """Radius 2 m, centre to the left of the start; the path begins along x whatever the compass
    says.
    """
    run_log = replayable(circle())
    path = run_log.vector("position", "truth_m")
    radius = np.hypot(path[:, 0], path[:, 1] - SPEED / YAW_RATE)
    assert radius == pytest.approx(SPEED / YAW_RATE, abs=1e-3)  # trapezoids of 0.015 rad
    assert path[10, 1] > 0.0
    assert run_log.signal("yaw_truth_rad")[-1] == pytest.approx(YAW_RATE * 3.0)


def test_without_a_heading_the_yaw_rate_is_integrated():
    with_rate = circle(imu_yaw_rad=None, imu_gyro_z_rad_per_s=YAW_RATE)
    expected = replayable(circle()).vector("com", "truth_m")
    assert replayable(with_rate).vector("com", "truth_m") == pytest.approx(expected, abs=1e-9)


def test_the_plant_takes_the_reckoned_pose_and_joints():
    """Rolled 0.3 rad to the right, the car stands on its right wheels; the tail lies where it was
    logged.
    """
    run_log = replayable(
        circle(imu_roll_rad=0.3, tail_roll_angle_rad=0.5 * TIMES, tail_pitch_angle_rad=0.1)
    )
    logged = add_logged_run(DiagramBuilder(), run_log)
    plant = logged.plant
    context = plant.CreateDefaultContext()
    logged.move(context, 200)
    X_WB = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("chassis"))
    R_WB = X_WB.rotation().matrix()
    assert R_WB[2, 1] == pytest.approx(np.sin(0.3)), "left side up"
    half_track = scenario_from_dict(run_log.scenario).car.outer_half_track
    assert X_WB.translation()[2] == pytest.approx(half_track * np.sin(0.3))
    assert plant.GetJointByName("tail_roll").get_angle(context) == pytest.approx(1.0)
    assert plant.GetJointByName("tail_pitch").get_angle(context) == pytest.approx(0.1)
    tip = run_log.vector("tail_tip", "truth_m")
    reach = np.linalg.norm(tip[200] - tip[0])
    assert reach > 0.5
    assert run_log.vector("com", "truth_m")[200] == pytest.approx(
        plant.CalcCenterOfMassPositionInWorld(context, own_instances(plant))
    )


def test_a_reckoned_run_has_five_moments_and_no_arrows():
    for scenario in ("turn_none", "turn_held"):
        run_log = replayable(circle(scenario))
        assert add_logged_run(DiagramBuilder(), run_log).arrows == []
        assert len(key_frames(run_log)) == 5


def test_a_simulated_run_is_left_as_it_is(tailed):
    assert replayable(tailed) is tailed


LOST = np.where(TIMES > 1.0, np.nan, SPEED)


@pytest.mark.parametrize(
    ("run_log", "named"),
    [
        (
            circle(imu_yaw_rad=None),
            ["car.parquet", "speed_m_per_s", "imu_yaw_rad", "imu_gyro_z_rad_per_s"],
        ),
        (replace(circle(), scenario={"name": 3}), ["car.parquet", "scenario", "name", "3"]),
        (replace(circle(), scenario={}), ["car.parquet", "scenario"]),
        (circle(speed_m_per_s=LOST), ["speed_m_per_s", "200", "nan", "1.01 s"]),
    ],
)
def test_what_a_replay_needs_is_named(run_log, named):
    assert_refused(lambda: replayable(run_log), LogError, *named)
