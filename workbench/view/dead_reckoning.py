"""The motion of a real car, reckoned from its sensors, so that its log is replayed like that of a
simulated one.

The heading is that of the IMU, the path is the speed integrated along it; roll and pitch are the
IMU's, and the car is lifted so that no wheel and no corner of its box is below the ground. No slip,
and the errors add up: a picture of what happened, not a measurement of where. Forces are not known
and not drawn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder
from scipy.integrate import cumulative_trapezoid

from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.car.tail_plant import tail_geometry
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError, ScenarioError
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import check_signals
from aerodima.workbench.scenario.scenario import Scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import PLANT_POSITION_PREFIX

RECKONED = "reckoned"
"""Key in the `extra` of a log whose motion was reckoned."""
_BOX_HEIGHT = 0.25
"""Height (m) of the box whose corners stay above ground; the roof of an overturned 1:10 car."""
_JOINTS = {
    "tail_tail_pitch_q": "tail_pitch_angle_rad",
    "tail_tail_roll_q": "tail_roll_angle_rad",
    "car_front_left_steering_q": "steering_command_rad",
    "car_front_right_steering_q": "steering_command_rad",
}
"""Plant position -> the signal that it is taken from, where it was logged."""


def replayable(run_log: RunLog) -> RunLog:
    """The log itself if it holds the motion of every joint, otherwise one with the motion reckoned
    from the sensors.

    Needed are `speed_m_per_s`, a heading (`imu_yaw_rad`, or `imu_gyro_z_rad_per_s` to integrate)
    and the scenario. Roll and pitch count as zero, a tail joint as at rest in its first position,
    when they were not logged.

    Raises:
        LogError: one of these is missing, NaN, gap or unsorted time in a column that is used.
    """
    if run_log.kind == PLANT_RUN or any(
        name.startswith(PLANT_POSITION_PREFIX) for name in run_log.table.columns
    ):
        return run_log
    name = run_log.name
    if not run_log.scenario:
        raise LogError(
            f"{name}: a replay needs the car's scenario, and the log has none; state it in the "
            "mapping"
        )
    try:
        scenario = scenario_from_dict(run_log.scenario)
    except ScenarioError as error:
        raise LogError(
            f"{name}: a replay needs the car's scenario; state it in the mapping ({error})"
        ) from None
    columns = _motion(scenario, run_log.time, _signals(run_log, name))
    added = pd.DataFrame(
        {key: values for key, values in columns.items() if key not in run_log.table.columns}
    )
    table = pd.concat([run_log.table.reset_index(drop=True), added], axis=1)
    return replace(run_log, table=table, extra={**run_log.extra, RECKONED: True})


def with_turning_sail(scenario: Scenario) -> Scenario:
    """The scenario with a joint for a sail that faces the wind, so that it can be drawn turned."""
    if scenario.tail.sail != "facing":
        return scenario
    return scenario.model_copy(update={"tail": scenario.tail.model_copy(update={"sail": "free"})})


def _signals(run_log: RunLog, name: str) -> dict[str, FloatArray]:
    """Speed, heading, roll, pitch, joint angles, (n,) each; what may be missing is left out."""
    time = run_log.time
    present = set(run_log.table.columns)
    if "speed_m_per_s" not in present or not {"imu_yaw_rad", "imu_gyro_z_rad_per_s"} & present:
        raise LogError(
            f"{name}: a replay needs columns {PLANT_POSITION_PREFIX}*, or speed_m_per_s with "
            "imu_yaw_rad or imu_gyro_z_rad_per_s"
        )
    heading = "imu_yaw_rad" if "imu_yaw_rad" in present else "imu_gyro_z_rad_per_s"
    wanted = dict.fromkeys(
        ("speed_m_per_s", heading, "imu_roll_rad", "imu_pitch_rad", *_JOINTS.values())
    )
    used = {key: run_log.signal(key) for key in wanted if key in present}
    check_signals(time, used)
    if heading == "imu_gyro_z_rad_per_s":
        used["imu_yaw_rad"] = cumulative_trapezoid(used[heading], time, initial=0.0)
    used["imu_yaw_rad"] = np.unwrap(used["imu_yaw_rad"])
    return used


def _motion(
    scenario: Scenario, time: FloatArray, signals: dict[str, FloatArray]
) -> dict[str, FloatArray]:
    """Every column that a replay reads: plant positions and the motion of chassis, centre of mass
    and tail tip.
    """
    zero = np.zeros(time.size)
    roll = signals.get("imu_roll_rad", zero)
    pitch = signals.get("imu_pitch_rad", zero)
    yaw = signals["imu_yaw_rad"] - signals["imu_yaw_rad"][0]
    speed = signals["speed_m_per_s"]
    ahead = cumulative_trapezoid(speed * np.cos(yaw), time, initial=0.0)
    left = cumulative_trapezoid(speed * np.sin(yaw), time, initial=0.0)
    position = np.column_stack([ahead, left, zero])
    builder = DiagramBuilder()  # it owns the plant
    car = add_car_plant(builder, with_turning_sail(scenario))
    plant = car.plant
    tail = car.tail
    context = plant.CreateDefaultContext()
    names = list(plant.GetPositionNames())
    chassis = [
        names.index(f"car_chassis_{part}") for part in ("qw", "qx", "qy", "qz", "x", "y", "z")
    ]
    positions = np.tile(plant.GetPositions(context), (time.size, 1))
    for name, source in _JOINTS.items():
        if name in names and source in signals:
            positions[:, names.index(name)] = signals[source]
    com = np.zeros((time.size, 3))
    tip = np.zeros((time.size, 3))
    corners = _corners(scenario)
    p_ToTip_T = tail_geometry(scenario.tail).arm.points[-1]
    bodies = [car.car]
    if tail is not None:
        bodies.append(tail)
    for row in range(time.size):
        R_WB = RollPitchYaw(roll[row], pitch[row], yaw[row]).ToRotationMatrix()
        position[row, 2] = max(0.0, -float(np.min(R_WB.matrix()[2] @ corners)))
        positions[row, chassis] = [*R_WB.ToQuaternion().wxyz(), *position[row]]
        plant.SetPositions(context, positions[row])
        com[row] = plant.CalcCenterOfMassPositionInWorld(context, bodies)
        if tail is not None:
            X_WT: RigidTransform = plant.EvalBodyPoseInWorld(
                context, plant.GetBodyByName("tail_rod")
            )
            tip[row] = X_WT.multiply(p_ToTip_T)
    columns = {
        f"{PLANT_POSITION_PREFIX}{name}": positions[:, index] for index, name in enumerate(names)
    }
    vectors = {"position": position, "com": com}
    tail_roll = zero
    if tail is not None:
        vectors["tail_tip"] = tip
        tail_roll = positions[:, names.index("tail_tail_roll_q")]
    for stem, values in vectors.items():
        columns |= {f"{stem}_{axis}_truth_m": values[:, index] for index, axis in enumerate("xyz")}
    return columns | {
        "tail_roll_angle_rad": tail_roll,
        "roll_truth_rad": roll,
        "pitch_truth_rad": pitch,
        "yaw_truth_rad": yaw,
        "velocity_x_truth_m_per_s": speed,
        "velocity_y_truth_m_per_s": zero,
    }


def _corners(scenario: Scenario) -> FloatArray:
    """Corners of the car's box in B, m, shape (3, 8); its lower face touches the ground at nominal
    ride height.
    """
    half = scenario.car.outer_half_track
    length = scenario.car.wheelbase
    return np.array(
        [(x, y, z) for x in (0.0, length) for y in (-half, half) for z in (0.0, _BOX_HEIGHT)]
    ).T
