"""A logged run of any plant, from its log alone: bodies are put where they were, with the shapes that they had."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import check_signals, check_time
from aerodima.workbench.metrics.run_summary import tails_of
from aerodima.workbench.replay.logged_car import AIR_SCALE, AirOnTail, LoggedRun, add_logged_car
from aerodima.workbench.replay.picture import Surface, posed_triangles, visible_surfaces
from aerodima.workbench.replay.scene_shapes import add_shapes
from aerodima.workbench.stations.ground_truth import air_columns, pose_columns

SCENE, AIR_SCALE_KEY = "scene", "air_scale_m_per_n"
"""Keys in `extra` of a `plant_run`: the shapes that its replay draws, and the length of arrows of the air."""
_BELOW = 0.02
"""A plant that reaches further below z = 0 than this (m), such as a pendulum, is drawn above a lower floor."""
_LOOKS = 40
"""Rows that say how large the plant is and how low it reaches."""
_LEAST_SIZE = 0.15
"""The camera does not come nearer than to a plant of this radius, m."""


def add_logged_run(builder: DiagramBuilder, run_log: RunLog) -> LoggedRun:
    """Adds the plant of a run log to a diagram: of any plant from its shapes, of the car from its scenario.

    Raises:
        LogError: the log has no shapes or poses, or see `add_logged_car`.
    """
    return add_logged_plant(builder, run_log) if run_log.kind == PLANT_RUN else add_logged_car(builder, run_log)


@dataclass(frozen=True)
class LoggedPlant:
    """A run of any plant.

    Attributes:
        run_log: the run; heights are raised if the plant reached below z = 0, so that it is above the floor.
        plant: a free body for each that had visible shapes.
        scene_graph: with these shapes.
        positions: of that plant, shape (n, nq), one row per row of the log.
        size: radius about the centre of mass that the shapes stay in, m.
    """

    run_log: RunLog
    plant: MultibodyPlant
    scene_graph: SceneGraph
    positions: FloatArray
    size: float = _LEAST_SIZE

    @property
    def path(self) -> FloatArray:
        """Positions of the centre of mass in W, m, shape (n, 3)."""
        return self.run_log.vector("com", "truth_m")

    @property
    def tips(self) -> dict[str, FloatArray]:
        """Paths of the tips of the tails in W, m, shape (n, 3) each."""
        return {name: self.run_log.vector(f"{name}_tip", "truth_m") for name, _ in tails_of(self.run_log)}

    @property
    def air(self) -> list[AirOnTail]:
        """The air on each tail, as logged."""
        found = []
        for name, _ in tails_of(self.run_log):
            columns = self.run_log.table[air_columns(name)].to_numpy(dtype=np.float64)
            force, moment, root, tip = np.split(columns, 4, axis=1)
            found.append(AirOnTail(name, force, moment, root, tip))
        return found

    @property
    def air_scale(self) -> float:
        """m per N."""
        return float(self.run_log.extra.get(AIR_SCALE_KEY, AIR_SCALE))

    @property
    def camera_place(self) -> tuple[float, float, float]:
        """Distance, height and height looked at, m: so far away that the whole plant is seen."""
        target = float(np.median(self.path[:, 2]))
        return 3.2 * self.size, target + 0.9 * self.size, target

    def move(self, plant_context: Context, row: int) -> None:
        """Puts the bodies where they were in one row of the log."""
        self.plant.SetPositions(plant_context, self.positions[row])


def add_logged_plant(builder: DiagramBuilder, run_log: RunLog) -> LoggedPlant:
    """Adds the bodies of a `plant_run` to a diagram.

    Raises:
        LogError: the log has no shapes, lacks the columns of a body or of a tail, or one of them is not finite.
    """
    name = run_log.name
    check_time(run_log.time)
    if not run_log.extra.get(SCENE):
        raise LogError(f"{name}: has no shapes to be drawn; its plant was not registered with a scene graph")
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    bodies = add_shapes(plant, run_log.extra[SCENE], name)
    plant.Finalize()
    wanted = [column for body in bodies for column in pose_columns(body)]
    wanted += [column for tail, _ in tails_of(run_log) for column in air_columns(tail)]
    wanted += [f"com_{axis}_truth_m" for axis in "xyz"]
    check_signals(run_log.time, {column: run_log.signal(column) for column in wanted})
    logged = _posed(run_log, plant, scene_graph, bodies)
    surfaces = [surface for surface in visible_surfaces(logged) if surface.body is not plant.world_body()]
    size, lowest = _extent(logged, surfaces)
    if lowest < -_BELOW:
        logged = _posed(_raised(run_log, -lowest, bodies), plant, scene_graph, bodies)
    return replace(logged, size=max(size, _LEAST_SIZE))


def _posed(run_log: RunLog, plant: MultibodyPlant, scene_graph: SceneGraph, bodies: list[str]) -> LoggedPlant:
    positions = np.zeros((len(run_log.table), plant.num_positions()))
    for body in bodies:
        start = plant.GetBodyByName(body).floating_positions_start()
        positions[:, start : start + 7] = run_log.table[pose_columns(body)].to_numpy(dtype=np.float64)
    return LoggedPlant(run_log, plant, scene_graph, positions)


def _extent(logged: LoggedPlant, surfaces: list[Surface]) -> tuple[float, float]:
    """Largest distance of a corner from the centre of mass, and the lowest corner, m; tips of tails count."""
    if not surfaces:
        return 0.0, 0.0
    context, size, lowest = logged.plant.CreateDefaultContext(), 0.0, np.inf
    for row in np.unique(np.linspace(0, len(logged.positions) - 1, _LOOKS).astype(int)):
        logged.move(context, int(row))
        triangles, _ = posed_triangles(surfaces, logged.plant, context)
        points = np.vstack([triangles.reshape(-1, 3), *(tip[row] for tip in logged.tips.values())])
        size = max(size, float(np.max(np.linalg.norm(points - logged.path[row], axis=1))))
        lowest = min(lowest, float(np.min(points[:, 2])))
    return size, lowest


def _raised(run_log: RunLog, height: float, bodies: list[str]) -> RunLog:
    """The log of a plant that was higher by `height`, m: heights of what is drawn, and moments about the same Wo."""
    table = run_log.table.copy()
    heights = ["com_z_truth_m", *(pose_columns(body)[-1] for body in bodies)]
    for name, _ in tails_of(run_log):
        heights += [f"{name}_root_z_truth_m", f"{name}_tip_z_truth_m"]
        table[f"{name}_moment_x_truth_n_m"] -= height * table[f"{name}_y_truth_n"]
        table[f"{name}_moment_y_truth_n_m"] += height * table[f"{name}_x_truth_n"]
    table[heights] += height
    return replace(run_log, table=table)
