"""A car rebuilt from its log stands where the log says, and a log that cannot be replayed is
refused in one line.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.view.logged_run import add_logged_run
from tests.refusals import assert_refused


def logged_car(run):
    return add_logged_run(DiagramBuilder(), run)


def test_body_stands_where_the_log_says(tailed):
    logged = logged_car(tailed)
    plant = logged.plant
    context = plant.CreateDefaultContext()
    row = len(tailed.time) - 1
    logged.move(context, row)
    X_WB = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("chassis"))
    # The same numbers went through the same plant: rounding of the quaternion only.
    assert X_WB.translation() == pytest.approx(tailed.vector("position", "truth_m")[row], abs=1e-9)
    yaw = np.arctan2(X_WB.rotation().matrix()[1, 0], X_WB.rotation().matrix()[0, 0])
    assert yaw == pytest.approx(tailed.signal("yaw_truth_rad")[row], abs=1e-9)


def test_order_of_columns_does_not_matter(tailed):
    backwards = replace(tailed, table=tailed.table[list(reversed(tailed.table.columns))])
    assert np.array_equal(logged_car(backwards).positions, logged_car(tailed).positions)


def test_camera_of_a_right_turn_mirrors_that_of_a_left_turn(tailed):
    mirrored = tailed.table.copy()
    mirrored["yaw_truth_rad"] *= -1
    assert tailed.signal("yaw_truth_rad")[-1] > 0.0
    right = logged_car(replace(tailed, table=mirrored))
    assert right.camera_azimuth == pytest.approx(-logged_car(tailed).camera_azimuth)


OLD, NEW = "plant_position_tail_tail_roll_q", "plant_position_wing_q"


def lost_position(table):
    return table.plant_position_car_chassis_x.where(table.time_s != table.time_s[5])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (lambda run: {"table": run.table.rename(columns={OLD: NEW})}, (OLD, NEW)),
        (
            lambda run: {"table": run.table.assign(plant_position_car_chassis_x=lost_position)},
            ("plant_position_car_chassis_x", "0.01 s"),
        ),
        (lambda run: {"scenario": {**run.scenario, "gravitas": 1.0}}, ("gravitas",)),
    ],
    ids=["another car", "not finite", "scenario"],
)
def test_log_that_cannot_be_replayed_is_refused_by_name(tailed, changes, named):
    wrong = replace(tailed, source="x.parquet", **changes(tailed))
    assert_refused(lambda: logged_car(wrong), LogError, "x.parquet", *named)
