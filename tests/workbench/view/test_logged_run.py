"""A car rebuilt from its log stands where the log says, and a log that cannot be replayed is
refused in one line.
"""

from dataclasses import replace
from functools import partial

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


def test_run_without_plant_positions_moves_as_its_sensors_say(tailed):
    plain = tailed.table[
        [name for name in tailed.table.columns if not name.startswith("plant_position_")]
    ]
    logged = logged_car(replace(tailed, table=plain))
    assert logged.run_log.extra["reckoned"] is True
    assert logged.positions.shape == logged_car(tailed).positions.shape


def test_camera_of_a_right_turn_mirrors_that_of_a_left_turn(tailed):
    mirrored = tailed.table.copy()
    mirrored["yaw_truth_rad"] *= -1
    assert tailed.signal("yaw_truth_rad")[-1] > 0.0
    right = logged_car(replace(tailed, table=mirrored))
    assert right.camera_azimuth == pytest.approx(-logged_car(tailed).camera_azimuth)


def test_positions_of_another_car_are_named(tailed):
    old = "plant_position_tail_tail_roll_q"
    renamed = replace(
        tailed,
        table=tailed.table.rename(columns={old: "plant_position_wing_q"}),
        source="x.parquet",
    )
    named = ("x.parquet", old, "plant_position_wing_q")
    assert_refused(lambda: logged_car(renamed), LogError, *named)


def test_position_that_is_not_finite_is_named_with_its_time(tailed):
    table = tailed.table.copy()
    table.loc[5, "plant_position_car_chassis_x"] = np.nan
    work = partial(logged_car, replace(tailed, table=table))
    assert_refused(work, LogError, "plant_position_car_chassis_x", "0.01 s")


def test_scenario_that_cannot_be_read_is_an_error_of_the_log(tailed):
    odd = replace(tailed, scenario={**tailed.scenario, "gravitas": 1.0})
    assert_refused(lambda: logged_car(odd), LogError, "gravitas")
