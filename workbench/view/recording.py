"""A run log as a Meshcat animation: robot, floor, traces, forces, and a camera that follows.

Meshcat animates transforms, scale and visibility. So the camera stands still and the world moves
under it (a visitor can still turn and zoom), an arrow is a unit shaft that is stretched, and a
trace grows by short pieces that appear.
"""

from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, MeshcatAnimation, MeshcatVisualizer, Rgba
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.core.array_types import ArrayPair, FloatArray, IntArray
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.force_arrows import Colour, DrawnArrow, ForceArrow
from aerodima.workbench.view.logged_run import LoggedRun, Place, add_logged_run
from aerodima.workbench.view.viewer import WORLD, area_around, draw_ground

FRAMES_PER_SECOND = 50.0
"""Frames per second of the replay, whatever its rate."""
RATES = (0.02, 20.0)
"""Slowest and fastest replay, seconds of the run per second."""
MAX_FRAMES = 1000
"""Largest number of frames, with which a page has 7 MB; a replay of more than 20 s has fewer frames
per second."""

NEARER = 0.78
"""Factor on `LoggedRun.camera_place` for Meshcat: a visitor can zoom out, a picture cannot."""
TIP_COLOUR = (0.93, 0.60, 0.10)
"""Colour of the path of the tail's tip."""
COM_COLOUR = (0.25, 0.30, 0.75)
"""Colour of the path of the centre of mass."""
_TRACE_RADIUS = 0.006
"""Radius of a drawn path, m."""
_TRACE_PIECES = 200
"""Largest number of pieces of a path, which appear one after another."""


def record_run(run_log: RunLog, meshcat: Meshcat, rate: float = 1.0) -> LoggedRun:
    """Puts the replay of a run into a viewer and plays it there, again and again.

    Args:
        run_log: log of a run, simulated or `replayable`.
        meshcat: viewer from `open_meshcat`.
        rate: seconds of the run per second of the replay; 0.25 is slow motion.

    Raises:
        LogError: the log cannot be replayed, see `add_logged_run`.
        UserError: rate out of range.
    """
    check_rate(rate)
    builder = DiagramBuilder()
    logged = add_logged_run(builder, run_log)
    run_log = logged.run_log
    MeshcatVisualizer.AddToBuilder(builder, logged.scene_graph, meshcat)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = logged.plant.GetMyMutableContextFromRoot(context)
    rows, frames_per_second = frame_rows(run_log.time, rate)
    draw_ground(meshcat, area_around(logged.path), logged.floor)
    logged.move(plant_context, rows[0])
    diagram.ForcedPublish(context)
    meshcat.StartRecording(frames_per_second, set_visualizations_while_recording=False)
    for frame, row in enumerate(rows):
        context.SetTime((frame + 0.25) / frames_per_second)  # Drake rounds down to a frame
        logged.move(plant_context, row)
        diagram.ForcedPublish(context)
    meshcat.StopRecording()
    animation = meshcat.get_mutable_recording()
    _draw_traces(meshcat, animation, logged, rows)
    for arrow in logged.arrows:
        _draw_arrow(meshcat, animation, arrow, rows)
    _follow(meshcat, animation, logged, rows)
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(10_000)
    meshcat.PublishRecording()
    return logged


def check_rate(rate: float) -> None:
    """Raises UserError if a replay is to be slower or faster than `RATES`."""
    check_range("--rate", rate, *RATES, NO_UNIT)


def frame_rows(time: FloatArray, rate: float) -> tuple[IntArray, float]:
    """Finds the row of the log nearest to each frame, first and last included, and the frames per
    second of the replay.
    """
    length = float(time[-1] - time[0]) / rate
    steps = min(round(length * FRAMES_PER_SECOND), MAX_FRAMES)
    count = max(2, steps + 1)
    return nearest_rows(time, np.linspace(time[0], time[-1], count)), (count - 1) / length


def nearest_rows(time: FloatArray, wanted: FloatArray) -> IntArray:
    """Finds the row of the log nearest to each wanted time, s; the last one for times after its
    end.
    """
    return pd.Index(time).get_indexer(pd.Index(wanted), method="nearest")


def _follow(
    meshcat: Meshcat, animation: MeshcatAnimation, logged: LoggedRun, rows: IntArray
) -> None:
    """Moves the world so that the car stays at the origin, and looks at it from ahead, where roll
    is seen best.
    """
    offsets = -logged.camera_path[rows]
    for frame, offset in enumerate(offsets):
        animation.SetTransform(frame, WORLD, RigidTransform(offset))
    meshcat.SetTransform(WORLD, RigidTransform(offsets[0]))
    distance, height, target = logged.camera_place
    place = (NEARER * distance, NEARER * height, target)
    meshcat.SetCameraPose(*camera_pose(logged.camera_azimuth, place))


def camera_pose(azimuth: float, place: Place) -> ArrayPair:
    """Computes where a camera stands that follows a point of the floor, and what it looks at.

    Args:
        azimuth: direction to the camera, rad about z.
        place: distance and heights as in `LoggedRun.camera_place`, m.

    Returns:
        Eye and target, both relative to that point, m, shape (3,).
    """
    distance, height, target = place
    x = distance * np.cos(azimuth)
    y = distance * np.sin(azimuth)
    return np.array([x, y, height]), np.array([0.0, 0.0, target])


def traces(logged: LoggedRun) -> list[tuple[str, Colour, FloatArray]]:
    """Lists name, colour and points in W (n, 3), m, of the drawn paths: centre of mass and tail
    tip.
    """
    tips = [(name, TIP_COLOUR, points) for name, points in logged.tips.items()]
    return [("com", COM_COLOUR, logged.run_log.vector("com", "truth_m")), *tips]


def _draw_traces(
    meshcat: Meshcat, animation: MeshcatAnimation, logged: LoggedRun, rows: IntArray
) -> None:
    """Draws the paths as pieces that appear one after another."""
    last = len(rows) - 1
    edges = _whole_steps(0, last, min(_TRACE_PIECES, last) + 1)
    for name, colour, points in traces(logged):
        for index, (start, end) in enumerate(pairwise(edges)):
            path = f"{WORLD}/trace/{name}/{index}"
            fine = _whole_steps(rows[start], rows[end], 4 * (end - start) + 1)
            vertices, faces = tube(points[fine])
            meshcat.SetTriangleMesh(path, vertices, faces, Rgba(*colour))
            animation.SetProperty(0, path, "visible", False)
            animation.SetProperty(int(end), path, "visible", True)
            # Every track has the same length, for the loop.
            animation.SetProperty(last, path, "visible", True)


def _whole_steps(first: int, last: int, count: int) -> IntArray:
    """Spreads at most `count` different whole numbers evenly from the first to the last."""
    return np.unique(np.linspace(first, last, count).round().astype(int))


def tube(points: FloatArray) -> tuple[FloatArray, NDArray[np.int32]]:
    """Wraps a square tube about a line of points (n, 3): vertices (3, 4 n) and faces (3, m); WebGL
    draws lines a pixel wide.
    """
    along = np.ones_like(points)
    if len(points) > 1:
        along = np.gradient(points, axis=0)
    side = _unit(np.cross(along, [0.0, 0.0, 1.0]), [0.0, 1.0, 0.0])
    up = _unit(np.cross(side, along), [0.0, 0.0, 1.0])
    rings = points[:, None, :] + _TRACE_RADIUS * np.stack([side, up, -side, -up], axis=1)
    corner = np.arange(4)
    first = 4 * np.arange(len(points) - 1)[:, None]
    a = first + corner
    b = first + (corner + 1) % 4
    next_b = b + 4
    faces = np.stack([a, a + 4, next_b, a, next_b, b], axis=-1).reshape(-1, 3)
    return np.asfortranarray(rings.reshape(-1, 3).T), np.asfortranarray(faces.T.astype(np.int32))


def _unit(vectors: FloatArray, otherwise: list[float]) -> FloatArray:
    """Scales vectors (n, 3) to unit length; those of length zero are replaced."""
    norm = np.linalg.norm(vectors, axis=1, keepdims=True)
    usable = norm > 1e-9
    return np.where(usable, vectors / np.where(usable, norm, 1.0), otherwise)


def _draw_arrow(
    meshcat: Meshcat, animation: MeshcatAnimation, arrow: ForceArrow, rows: IntArray
) -> None:
    """Draws a force as an arrow that moves, and is hidden where it is short."""
    drawn = DrawnArrow(meshcat, arrow.name, arrow.colour)
    shown = arrow.shown[rows].tolist()
    for frame, row in enumerate(rows):
        changes = shown[frame] != shown[frame - 1]
        if changes or frame in (0, len(rows) - 1):
            animation.SetProperty(frame, drawn.path, "visible", shown[frame])
        if shown[frame]:
            drawn.move(animation, arrow.points[row], arrow.lengths[row], frame)
    meshcat.SetProperty(drawn.path, "visible", shown[0])
