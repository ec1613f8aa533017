"""A logged run: a plant, its positions over time, and the signals of its log.

All replays are made from it.

The plant of a car is rebuilt from the scenario in its log, that of any other diagram from the
shapes in its log.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.ndimage import gaussian_filter1d

from aerodima.workbench.car.car_plant import add_car_plant, add_plant
from aerodima.workbench.car.ground_truth import air_columns, pose_columns
from aerodima.workbench.core.array_types import FloatArray, NamedArrays
from aerodima.workbench.core.errors import LogError, ScenarioError
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import (
    check_signals,
    check_time,
    checked_table,
    median_step,
    naming,
)
from aerodima.workbench.scenario.scenario import scenario_from_dict
from aerodima.workbench.scenario.signal_table import PLANT_POSITION_PREFIX
from aerodima.workbench.view.dead_reckoning import (
    DEAD_RECKONING,
    replayable,
    with_turning_sail,
)
from aerodima.workbench.view.force_arrows import ForceArrow, air_arrow, wheel_arrows
from aerodima.workbench.view.scene_shapes import (
    WORLD_BODY,
    add_shapes,
    point_paths,
    shape_points,
)

SCENE = "scene"
"""Key in `extra` of a `plant_run`: the shapes that its replay draws."""
AIR_SCALE_KEY = "air_scale_m_per_n"
"""Key in `extra` of a `plant_run`: the length of arrows of the air, m per N."""
AIR_SCALE = 0.10
"""Length of the arrow for the air on a tail, m per N, unless the run gives another scale: the air
on the car's tail exerts a few newtons."""
_SAIL_POSITION = f"{PLANT_POSITION_PREFIX}tail_tail_sail_turn_q"
_FLOOR_TOLERANCE = 0.02
"""Depth below z = 0 (m) beyond which a plant that reaches there, such as a pendulum, is drawn above
a lower floor."""
_SAMPLED_ROWS = 40
"""Number of rows that show how large the plant is and how low it reaches."""
MIN_SIZE = 0.15
"""Radius below which a plant no longer brings the camera nearer, m."""
_FOLLOW_TIME = 0.15
"""Width (s) of the smoothing of the camera's path, so that it does not shake with the car."""
_CAMERA_SIDE = 0.45
"""Angle between the car's heading and the direction to the camera, rad."""


Place = tuple[float, float, float]
"""Distance and height of a camera, and height of the point that it looks at, m."""


@dataclass(frozen=True)
class LoggedRun:
    """A run whose plant can be put where it was in each row of its log.

    Attributes:
        run_log: log of the run, with what a replay reads; for a real car see `replayable`.
        plant: plant of the run, which is moved, not simulated.
        scene_graph: scene graph with the shapes of the plant.
        positions: positions of the plant, shape (n, nq), one row per row of the log.
        path: path of the plant in W, m, shape (n, 3); the floor is drawn about it.
        tips: path of the tip of each tail in W, m, shape (n, 3), by name.
        arrows: forces of ground and air; none for a real car, which logs no forces.
        air_scale: length of an arrow of the air, m per N.
        camera_place: distance and height of the camera, and height of the point that it looks at,
            over the floor, m.
        floor: height of the floor, m.
    """

    run_log: RunLog
    plant: MultibodyPlant
    scene_graph: SceneGraph
    positions: FloatArray
    path: FloatArray
    tips: NamedArrays
    arrows: list[ForceArrow]
    air_scale: float
    camera_place: Place
    floor: float = 0.0

    def move(self, plant_context: Context, row: int) -> None:
        """Puts the plant where it was in one row of the log."""
        self.plant.SetPositions(plant_context, self.positions[row])

    @property
    def camera_path(self) -> FloatArray:
        """Smooths the point of the floor that stays in the middle of the picture, W, m, shape (n,
        3).
        """
        com = self.run_log.vector("com", "truth_m")
        com[:, 2] = self.floor
        width = _FOLLOW_TIME / median_step(self.run_log.time)
        reach = min(int(np.ceil(3.0 * width)), len(com) - 1)
        straight_on = np.pad(com, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
        return gaussian_filter1d(straight_on, width, axis=0, truncate=3.0)[reach : reach + len(com)]

    @property
    def camera_azimuth(self) -> float:
        """Chooses the direction (rad about z) from the robot to the camera: ahead, to the outside
        of the turn, halfway through it.

        A plant without a base has no heading: the camera looks along y then, a little from the
        side.
        """
        if "yaw_truth_rad" not in self.run_log.table:
            return -0.5 * np.pi + _CAMERA_SIDE
        yaw = self.run_log.signal("yaw_truth_rad")
        quarter = np.pi / 2
        final = float(np.clip(yaw[-1] - yaw[0], -quarter, quarter))
        side = -_CAMERA_SIDE if final >= 0 else _CAMERA_SIDE
        return float(yaw[0] + 0.5 * final + side)


def add_logged_run(builder: DiagramBuilder, run_log: RunLog) -> LoggedRun:
    """Adds the plant of a run log to a diagram.

    Raises:
        LogError: the log cannot be replayed (see `replayable`): its scenario cannot be read; it has
            other plant positions than the car of its scenario; it lacks shapes, or the columns of a
            body or a tail; a value is not finite.
    """
    check_time(run_log.time)
    if run_log.kind == PLANT_RUN:
        return _add_plant(builder, run_log)
    return _add_car(builder, replayable(run_log))


def _add_car(builder: DiagramBuilder, run_log: RunLog) -> LoggedRun:
    """Adds the plant of a car's scenario, with the positions of its log."""
    name = run_log.name
    try:
        scenario = scenario_from_dict(run_log.scenario)
    except ScenarioError as error:
        raise LogError(f"{name}: the scenario in its metadata cannot be read: {error}") from None
    car = add_car_plant(builder, with_turning_sail(scenario))
    plant = car.plant
    table = run_log.table
    if scenario.tail.sail == "facing" and car.tail is not None and _SAIL_POSITION not in table:
        # Its simulation has no such joint.
        table = table.assign(**{_SAIL_POSITION: run_log.signal("sail_angle_rad")})
    columns = [PLANT_POSITION_PREFIX + position for position in plant.GetPositionNames()]
    logged = {column for column in table.columns if column.startswith(PLANT_POSITION_PREFIX)}
    if set(columns) != logged:
        missing = ", ".join(sorted(set(columns) - logged))
        unknown = ", ".join(sorted(logged - set(columns)))
        raise LogError(
            f"{name}: its plant positions are not those of the car of its scenario; "
            f"missing: {missing or 'none'}; unknown: {unknown or 'none'}"
        )
    positions = table[columns].to_numpy(float)
    with naming(name):
        signals = dict(zip(columns, positions.T, strict=True))
        check_signals(run_log.time, signals, largest_step=np.inf)
    path = run_log.vector("position", "truth_m")
    place = (2.0, 0.9, 0.25)
    tips = {}
    reckoned = DEAD_RECKONING in run_log.extra
    arrows = [] if reckoned else wheel_arrows(run_log)
    if car.tail is not None:
        tip = run_log.vector("tail_tip", "truth_m")
        place = (3.0, 1.3, 0.5)  # a tail needs room
        tips = {"tail_tip": tip}
        if "tail_force_x_truth_n" in table and not reckoned:
            force = run_log.vector("tail_force", "truth_n")
            moment = run_log.vector("tail_force_moment", "truth_n_m")
            root = point_paths(plant, "tail_rod", np.zeros((1, 3)), positions)[:, 0]
            arrows.append(air_arrow("tail", AIR_SCALE, force, moment, root, tip))
    for name, parts in _logged_air(run_log).items():
        arrows.append(air_arrow(name, AIR_SCALE, *parts))
    return LoggedRun(
        run_log, plant, car.scene_graph, positions, path, tips, arrows, AIR_SCALE, place
    )


def _add_plant(builder: DiagramBuilder, run_log: RunLog) -> LoggedRun:
    """Adds each body that had visible shapes as a free body."""
    extra = run_log.extra
    if not extra.get(SCENE):
        raise LogError(
            f"{run_log.name}: has no shapes to be drawn; its plant was not registered with a scene "
            "graph, or its meshes could not be read"
        )
    plant, scene_graph = add_plant(builder, 0.0)
    bodies = add_shapes(plant, extra[SCENE], run_log.name)
    plant.Finalize()
    path = checked_table(run_log, [f"com_{axis}_truth_m" for axis in "xyz"])
    positions = np.zeros((len(path), plant.num_positions()))
    for body in bodies:
        start = plant.GetBodyByName(body).floating_positions_start()
        positions[:, start : start + 7] = checked_table(run_log, pose_columns(body))
    scale = float(extra.get(AIR_SCALE_KEY, AIR_SCALE))
    arrows = wheel_arrows(run_log)
    tips = {}
    for tail, parts in _logged_air(run_log).items():
        arrows.append(air_arrow(tail, scale, *parts))
        tips[tail] = parts[3]
    rows = np.unique(np.linspace(0, len(path) - 1, _SAMPLED_ROWS).astype(int))
    com = path[rows, None]
    paths = [com, *(tip[rows, None] for tip in tips.values())]
    for shape in extra[SCENE]:
        if shape["body"] != WORLD_BODY:
            paths.append(point_paths(plant, shape["body"], shape_points(shape), positions[rows]))
    points = np.concatenate(paths, axis=1)
    size = max(MIN_SIZE, float(np.max(np.linalg.norm(points - com, axis=2))))
    lowest = float(np.min(points[:, 1:, 2], initial=0.0))
    floor = lowest if lowest < -_FLOOR_TOLERANCE else 0.0
    height = path[:, 2]
    target = float(np.mean([np.min(height), np.max(height)])) - floor
    reach = size + 0.5 * float(np.ptp(height))  # a plant that falls stays in the picture
    place = (3.6 * reach, target + 0.9 * reach, target)
    return LoggedRun(
        run_log, plant, scene_graph, positions, path, tips, arrows, scale, place, floor
    )


def _logged_air(run_log: RunLog) -> dict[str, list[FloatArray]]:
    """Reads for each force of the air, by its name, the force, N, its moment about Wo, N m, and
    root and tip of its sections, m, each (n, 3).
    """
    names = run_log.table.columns.str.extract("(.*)_root_x_truth_m$", expand=False).dropna()
    return {name: np.split(checked_table(run_log, air_columns(name)), 4, axis=1) for name in names}
