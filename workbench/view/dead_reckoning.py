"""The motion of a real car, reckoned from its sensors, so that its log can be replayed.

The heading is that of the IMU, the path is the speed integrated along it; roll and pitch are the
IMU's, and the car is lifted so that no wheel and no corner of its box is below the ground. Slip is
left out, and the errors add up: a picture of what happened, not a measurement of where. Forces are
not known and not drawn.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
from pydrake.systems.framework import DiagramBuilder
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.car.tail_plant import tail_geometry
from aerodima.workbench.core.array_types import FloatArray, NamedArrays
from aerodima.workbench.core.errors import LogError, ScenarioError
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import checked_signals
from aerodima.workbench.scenario.scenario import Scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import PLANT_POSITION_PREFIX
from aerodima.workbench.view.scene_shapes import contexts_at, point_paths

DEAD_RECKONING = "reckoned"
"""Key in the `extra` of a log whose motion was reckoned."""
_BOX_HEIGHT = 0.25
"""Height (m) of the box whose corners stay above ground; the roof of an overturned 1:10 car."""
_JOINTS = {
    "tail_tail_pitch_q": "tail_pitch_angle_rad",
    "tail_tail_roll_q": "tail_roll_angle_rad",
    "car_front_left_steering_q": "steering_command_rad",
    "car_front_right_steering_q": "steering_command_rad",
}
"""Signal from which each of these plant positions is taken, where it was logged."""


def replayable(run_log: RunLog) -> RunLog:
    """Returns the log itself if it holds the motion of every joint, otherwise one with the motion
    reckoned from the sensors.

    This needs `speed_m_per_s`, a heading (`imu_yaw_rad`, or `imu_gyro_z_rad_per_s` to integrate)
    and the scenario. If not logged, roll and pitch count as zero, and a tail joint counts as at
    rest in its first position.

    Raises:
        LogError: one of these is missing; NaN, a gap or unsorted time in a column that is used.
    """
    columns = run_log.table.columns
    if run_log.kind == PLANT_RUN or columns.str.startswith(PLANT_POSITION_PREFIX).any():
        return run_log
    try:
        if not run_log.scenario:
            raise ScenarioError("the log has none")
        scenario = scenario_from_dict(run_log.scenario)
    except ScenarioError as error:
        raise LogError(
            f"{run_log.name}: a replay needs the car's scenario; state it in the mapping ({error})"
        ) from None
    motion = _motion(scenario, run_log.time, _signals(run_log))
    added = motion[motion.columns.difference(columns, sort=False)]
    table = pd.concat([run_log.table.reset_index(drop=True), added], axis=1)
    return replace(run_log, table=table, extra={**run_log.extra, DEAD_RECKONING: True})


def with_turning_sail(scenario: Scenario) -> Scenario:
    """Gives the scenario a joint for a sail that faces the wind, so that it can be drawn turned."""
    if scenario.tail.sail != "facing":
        return scenario
    return scenario.model_copy(update={"tail": scenario.tail.model_copy(update={"sail": "free"})})


def _signals(run_log: RunLog) -> NamedArrays:
    """Reads speed, heading, roll, pitch and joint angles, (n,) each; leaves out what is missing."""
    present = set(run_log.table.columns)
    headings = [name for name in ("imu_yaw_rad", "imu_gyro_z_rad_per_s") if name in present]
    if "speed_m_per_s" not in present or not headings:
        raise LogError(
            f"{run_log.name}: a replay needs columns {PLANT_POSITION_PREFIX}*, or speed_m_per_s "
            "with imu_yaw_rad or imu_gyro_z_rad_per_s"
        )
    optional = {"imu_roll_rad", "imu_pitch_rad", *_JOINTS.values()} & present
    names = ("speed_m_per_s", headings[0], *sorted(optional))
    signals = checked_signals(run_log, names)
    heading = signals[headings[0]]
    if headings[0] != "imu_yaw_rad":
        heading = cumulative_trapezoid(heading, run_log.time, initial=0.0)
    signals["imu_yaw_rad"] = np.unwrap(heading)
    return signals


def _motion(scenario: Scenario, time: FloatArray, signals: NamedArrays) -> pd.DataFrame:
    """Makes every column that a replay reads: plant positions and the motion of chassis, centre of
    mass and tail tip.
    """
    zero = np.zeros(time.size)
    roll = signals.get("imu_roll_rad", zero)
    pitch = signals.get("imu_pitch_rad", zero)
    yaw = signals["imu_yaw_rad"] - signals["imu_yaw_rad"][0]
    speed = signals["speed_m_per_s"]
    builder = DiagramBuilder()  # it owns the plant
    car = add_car_plant(builder, with_turning_sail(scenario))
    names = list(car.plant.GetPositionNames())
    positions = np.tile(car.plant.GetPositions(car.plant.CreateDefaultContext()), (time.size, 1))
    for name, source in _JOINTS.items():
        if name in names and source in signals:
            positions[:, names.index(name)] = signals[source]
    start = car.plant.GetBodyByName("chassis").floating_positions_start()
    pose = positions[:, start : start + 7]
    velocity = speed * np.array([np.cos(yaw), np.sin(yaw)])
    pose[:, 4:6] = cumulative_trapezoid(velocity, time, initial=0.0).T
    half = scenario.car.outer_half_track
    box = ((0.0, scenario.car.wheelbase), (-half, half), (0.0, _BOX_HEIGHT))
    corners = np.array([*product(*box)]).T  # of the car in B, m, (3, 8)
    R_WB = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    heights = R_WB.as_matrix()[:, 2] @ corners
    pose[:, :4] = R_WB.as_quat(canonical=True, scalar_first=True)
    pose[:, 6] = np.maximum(0.0, -np.min(heights, axis=1))
    com = [
        car.plant.CalcCenterOfMassPositionInWorld(context, car.instances)
        for context in contexts_at(car.plant, positions)
    ]
    vectors = {"position": pose[:, 4:], "com": np.array(com)}
    tail_roll = zero
    if car.tail is not None:
        p_ToTip_T = tail_geometry(scenario.tail).arm.points[-1:]
        vectors["tail_tip"] = point_paths(car.plant, "tail_rod", p_ToTip_T, positions)[:, 0]
        tail_roll = positions[:, names.index("tail_tail_roll_q")]
    motion = pd.DataFrame(positions, columns=[PLANT_POSITION_PREFIX + name for name in names])
    for stem, values in vectors.items():
        motion[[f"{stem}_{axis}_truth_m" for axis in "xyz"]] = values
    return motion.assign(
        tail_roll_angle_rad=tail_roll,
        roll_truth_rad=roll,
        pitch_truth_rad=pitch,
        yaw_truth_rad=yaw,
        velocity_x_truth_m_per_s=speed,
        velocity_y_truth_m_per_s=zero,
    )
