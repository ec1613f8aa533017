"""The car of a run log: its plant, rebuilt from the scenario in the log, and its positions over time.

A simulated run logs the motion of every joint. That of a real car is reckoned from its sensors alone: the heading is
that of the IMU, the path is the speed integrated along it; roll and pitch are the IMU's, and the car is lifted so that
no wheel and no corner of its box is below the ground. No slip, and the errors add up: a picture of what happened, not a
measurement of where. Forces are not known and not drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import pandas as pd
from pydrake.geometry import SceneGraph
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.integrate import cumulative_trapezoid

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.config.signal_table import PLANT_POSITION_PREFIX
from aerodima.workbench.errors import LogError, ScenarioError
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import check_signals, check_time
from aerodima.workbench.plants.car import CarPlant, add_car_plant
from aerodima.workbench.plants.tail import tail_geometry

AIR_SCALE = 0.10
"""Length of the arrow of the air on a tail, m per N, unless the run says another: the car's gives a few newtons."""


@dataclass(frozen=True)
class AirOnTail:
    """The force of the air on one tail over a run, W axes, shape (n, 3) each.

    Attributes:
        name: of the tail.
        force: N.
        moment: about Wo, N m.
        root, tip: ends of its sections in W, m.
    """

    name: str
    force: FloatArray
    moment: FloatArray
    root: FloatArray
    tip: FloatArray


class LoggedRun(Protocol):
    """A run whose plant can be put where it was; see `aerodima.workbench.replay.logged_plant.add_logged_run`."""

    @property
    def run_log(self) -> RunLog:
        """The run, with what a replay reads."""

    @property
    def plant(self) -> MultibodyPlant:
        """Moved, not simulated."""

    @property
    def scene_graph(self) -> SceneGraph:
        """Shapes of the plant."""

    @property
    def path(self) -> FloatArray:
        """Where it went, W, m, shape (n, 3); the floor is drawn about it."""

    @property
    def tips(self) -> dict[str, FloatArray]:
        """Name -> path of the tip of a tail in W, m, shape (n, 3)."""

    @property
    def air(self) -> list[AirOnTail]:
        """The air on each tail; none where the log holds no forces."""

    @property
    def air_scale(self) -> float:
        """Length of an arrow of the air, m per N."""

    @property
    def camera_place(self) -> tuple[float, float, float]:
        """Distance and height of the camera, and height of the point that it looks at, m."""

    def move(self, plant_context: Context, row: int) -> None:
        """Puts the plant where it was in one row of the log."""


SAIL_POSITION = f"{PLANT_POSITION_PREFIX}tail_tail_sail_turn_q"


@dataclass(frozen=True)
class LoggedCar:
    """A run and the car that made it.

    Attributes:
        run_log: the run.
        scenario: its scenario.
        car: plant and scene graph; they are moved, not simulated.
        positions: plant positions, shape (n, nq), one row per row of the log.
    """

    run_log: RunLog
    scenario: Scenario
    car: CarPlant
    positions: FloatArray

    @property
    def plant(self) -> MultibodyPlant:
        """Of the car."""
        return self.car.plant

    @property
    def scene_graph(self) -> SceneGraph:
        """Of the car."""
        return self.car.scene_graph

    @property
    def path(self) -> FloatArray:
        """Positions of Bo in W, m, shape (n, 3)."""
        return self.run_log.vector("position", "truth_m")

    @property
    def tips(self) -> dict[str, FloatArray]:
        """Path of the tail's tip in W, m, shape (n, 3)."""
        return {} if self.car.tail is None else {"tail_tip": self.run_log.vector("tail_tip", "truth_m")}

    @property
    def air(self) -> list[AirOnTail]:
        """The air on the tail, as logged."""
        if self.car.tail is None:
            return []
        force, moment = (
            self.run_log.vector(stem, suffix)
            for stem, suffix in (("tail_force", "truth_n"), ("tail_force_moment", "truth_n_m"))
        )
        return [AirOnTail("tail", force, moment, *tail_axis(self))]

    @property
    def air_scale(self) -> float:
        """m per N."""
        return AIR_SCALE

    @property
    def camera_place(self) -> tuple[float, float, float]:
        """Distance, height and height looked at, m: a tail needs room."""
        return (3.0, 1.3, 0.5) if self.car.tail is not None else (2.0, 0.9, 0.25)

    def move(self, plant_context: Context, row: int) -> None:
        """Puts the car where it was in one row of the log."""
        self.car.plant.SetPositions(plant_context, self.positions[row])


def tail_axis(logged: LoggedCar) -> tuple[FloatArray, FloatArray]:
    """Root and tip of the tail in W, m, each of shape (n, 3)."""
    plant = logged.car.plant
    context = plant.CreateDefaultContext()
    rod = plant.GetBodyByName("tail_rod")
    roots = []
    for row in range(len(logged.positions)):
        logged.move(context, row)
        roots.append(plant.EvalBodyPoseInWorld(context, rod).translation())
    return np.array(roots), logged.run_log.vector("tail_tip", "truth_m")


def add_logged_car(builder: DiagramBuilder, run_log: RunLog) -> LoggedCar:
    """Adds the car of a run log to a diagram.

    Raises:
        LogError: the log has no plant positions (a run of the real car: see `replayable`), others than the car of its
            scenario has, a value that is not finite, or a scenario that cannot be read.
    """
    name = run_log.name
    check_time(run_log.time)
    logged = [column for column in run_log.table.columns if column.startswith(PLANT_POSITION_PREFIX)]
    if not logged:
        raise LogError(f"{name}: has no columns {PLANT_POSITION_PREFIX}*; only a simulated run can be replayed")
    try:
        scenario = scenario_from_dict(run_log.scenario)
    except ScenarioError as error:
        raise LogError(f"{name}: the scenario in its metadata cannot be read: {error}") from None
    car = add_car_plant(builder, with_turning_sail(scenario))
    wanted = [PLANT_POSITION_PREFIX + position for position in car.plant.GetPositionNames()]
    table = _with_sail_angle(run_log, scenario)
    logged = [column for column in table.columns if column.startswith(PLANT_POSITION_PREFIX)]
    if set(wanted) != set(logged):
        missing, foreign = sorted(set(wanted) - set(logged)), sorted(set(logged) - set(wanted))
        raise LogError(
            f"{name}: its plant positions are not those of the car of its scenario; "
            f"missing: {', '.join(missing) or 'none'}; unknown: {', '.join(foreign) or 'none'}"
        )
    positions = table[wanted].to_numpy(dtype=np.float64)
    if not np.all(np.isfinite(positions)):
        row, column = np.argwhere(~np.isfinite(positions))[0]
        raise LogError(f"{name}: {wanted[column]} is not finite at {run_log.time[row]:g} s")
    return LoggedCar(run_log, scenario, car, positions)


def with_turning_sail(scenario: Scenario) -> Scenario:
    """The scenario with a joint for a sail that faces the wind, so that it can be drawn turned."""
    if scenario.tail.sail != "facing":
        return scenario
    return scenario.model_copy(update={"tail": scenario.tail.model_copy(update={"sail": "free"})})


def _with_sail_angle(run_log: RunLog, scenario: Scenario) -> pd.DataFrame:
    """The log with the encoder's angle as position of the joint that a facing sail does not have in its simulation."""
    table = run_log.table
    if scenario.tail.sail != "facing" or scenario.tail.mode == "none" or SAIL_POSITION in table.columns:
        return table
    return table.assign(**{SAIL_POSITION: run_log.signal("sail_angle_rad")})


RECKONED = "reckoned"
"""Key in the `extra` of a log whose motion was reckoned."""
_BOX_HEIGHT = 0.25
"""Height (m) of the box whose corners stay above the ground; the roof of a 1:10 car on its side or back."""


def replayable(run_log: RunLog) -> RunLog:
    """The log itself if it holds the motion of every joint, otherwise one with the motion reckoned from the sensors.

    Needed are `speed_m_per_s`, a heading (`imu_yaw_rad`, or `imu_gyro_z_rad_per_s` to integrate) and the scenario. Roll
    and pitch count as zero, a tail joint as at rest in its first position, when they were not logged.

    Raises:
        LogError: one of these is missing, NaN, gap or unsorted time in a column that is used.
    """
    if run_log.kind == PLANT_RUN or any(name.startswith(PLANT_POSITION_PREFIX) for name in run_log.table.columns):
        return run_log
    name = run_log.name
    if not run_log.scenario:
        raise LogError(f"{name}: a replay needs the car's scenario, and the log has none; state it in the mapping")
    try:
        scenario = scenario_from_dict(run_log.scenario)
    except ScenarioError as error:
        raise LogError(f"{name}: a replay needs the car's scenario; state it in the mapping ({error})") from None
    signals = _signals(run_log, name)
    columns = _motion(scenario, run_log.time, signals)
    added = pd.DataFrame({key: values for key, values in columns.items() if key not in run_log.table.columns})
    table = pd.concat([run_log.table.reset_index(drop=True), added], axis=1)
    return replace(run_log, table=table, extra={**run_log.extra, RECKONED: True})


def _signals(run_log: RunLog, name: str) -> dict[str, FloatArray]:
    """Speed, heading, roll, pitch and joint angles, shape (n,) each; what may be missing is left out."""
    time, present = run_log.time, set(run_log.table.columns)
    if "speed_m_per_s" not in present or not {"imu_yaw_rad", "imu_gyro_z_rad_per_s"} & present:
        raise LogError(
            f"{name}: a replay needs columns {PLANT_POSITION_PREFIX}*, or speed_m_per_s with imu_yaw_rad or "
            "imu_gyro_z_rad_per_s"
        )
    heading = "imu_yaw_rad" if "imu_yaw_rad" in present else "imu_gyro_z_rad_per_s"
    optional = ("imu_roll_rad", "imu_pitch_rad", "tail_pitch_angle_rad", "tail_roll_angle_rad", "steering_command_rad")
    used = {key: run_log.signal(key) for key in ("speed_m_per_s", heading, *optional) if key in present}
    check_signals(time, used)
    if heading == "imu_gyro_z_rad_per_s":
        used["imu_yaw_rad"] = cumulative_trapezoid(used[heading], time, initial=0.0)
    used["imu_yaw_rad"] = np.unwrap(used["imu_yaw_rad"])
    return used


def _motion(scenario: Scenario, time: FloatArray, signals: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Every column that a replay reads: plant positions and the motion of chassis, centre of mass and tail tip."""
    zero = np.zeros(time.size)
    roll, pitch = signals.get("imu_roll_rad", zero), signals.get("imu_pitch_rad", zero)
    yaw, speed = signals["imu_yaw_rad"] - signals["imu_yaw_rad"][0], signals["speed_m_per_s"]
    ahead, left = (cumulative_trapezoid(speed * part, time, initial=0.0) for part in (np.cos(yaw), np.sin(yaw)))
    position = np.column_stack([ahead, left, zero])
    builder = DiagramBuilder()  # it owns the plant
    car = add_car_plant(builder, with_turning_sail(scenario))
    plant = car.plant
    context = plant.CreateDefaultContext()
    names = list(plant.GetPositionNames())
    joints = _joints(names, signals)
    instances = [car.car] if car.tail is None else [car.car, car.tail]
    com, tip = np.zeros((time.size, 3)), np.zeros((time.size, 3))
    positions = np.tile(plant.GetPositions(context), (time.size, 1))
    corners, p_ToTip_T = _corners(scenario), tail_geometry(scenario.tail).arm.points[-1]
    for row in range(time.size):
        rotation = RollPitchYaw(roll[row], pitch[row], yaw[row]).ToRotationMatrix()
        position[row, 2] = max(0.0, -float(np.min(rotation.matrix()[2] @ corners)))
        _place(positions[row], names, rotation, position[row])
        for index, values in joints.items():
            positions[row, index] = values[row]
        plant.SetPositions(context, positions[row])
        com[row] = plant.CalcCenterOfMassPositionInWorld(context, instances)
        if car.tail is not None:
            tip[row] = _tail_tip(plant, context, p_ToTip_T)
    columns = {f"{PLANT_POSITION_PREFIX}{name}": positions[:, index] for index, name in enumerate(names)}
    columns |= _vector("position", position) | _vector("com", com)
    if car.tail is not None:
        columns |= _vector("tail_tip", tip)
    rest = zero if car.tail is None else positions[:, names.index("tail_tail_roll_q")]
    return columns | {
        "tail_roll_angle_rad": signals.get("tail_roll_angle_rad", rest),
        "roll_truth_rad": roll,
        "pitch_truth_rad": pitch,
        "yaw_truth_rad": yaw,
        "velocity_x_truth_m_per_s": speed,
        "velocity_y_truth_m_per_s": zero,
    }


def _joints(names: list[str], signals: dict[str, FloatArray]) -> dict[int, FloatArray]:
    """Index of a plant position -> its values, for the joints that were logged."""
    sources = {
        "tail_tail_pitch_q": "tail_pitch_angle_rad",
        "tail_tail_roll_q": "tail_roll_angle_rad",
        "tail_tail_sail_turn_q": "sail_angle_rad",
        "car_front_left_steering_q": "steering_command_rad",
        "car_front_right_steering_q": "steering_command_rad",
    }
    return {names.index(name): signals[key] for name, key in sources.items() if name in names and key in signals}


def _corners(scenario: Scenario) -> FloatArray:
    """Corners of the car's box in B, m, shape (3, 8); its lower face touches the ground at nominal ride height."""
    half, length = scenario.car.outer_half_track, scenario.car.wheelbase
    return np.array([(x, y, z) for x in (0.0, length) for y in (-half, half) for z in (0.0, _BOX_HEIGHT)]).T


def _place(positions: FloatArray, names: list[str], rotation: RotationMatrix, position: FloatArray) -> None:
    """Writes the pose of the chassis into a row of plant positions."""
    values = [*rotation.ToQuaternion().wxyz(), *position]
    for suffix, value in zip(("qw", "qx", "qy", "qz", "x", "y", "z"), values, strict=True):
        positions[names.index(f"car_chassis_{suffix}")] = value


def _tail_tip(plant: MultibodyPlant, context: Any, p_ToTip_T: FloatArray) -> FloatArray:
    X_WT = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("tail_rod"))
    return np.asarray(X_WT.translation() + X_WT.rotation().matrix() @ p_ToTip_T)


def _vector(stem: str, values: FloatArray) -> dict[str, FloatArray]:
    return {f"{stem}_{axis}_truth_m": values[:, index] for index, axis in enumerate("xyz")}
