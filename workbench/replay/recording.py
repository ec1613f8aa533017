"""A run log as an animation in Meshcat: car, floor, traces and forces, with a camera that stays with the car.

Meshcat animates transforms, scale and visibility. So the camera stands still and the world moves under it (a visitor
can still turn and zoom), an arrow is a unit shaft that is stretched, and a trace grows by short pieces that appear.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Cylinder, Meshcat, MeshcatAnimation, MeshcatCone, MeshcatVisualizer, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import WHEELS
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.replay.logged_car import RECKONED, LoggedCar, add_logged_car
from aerodima.workbench.replay.viewer import WORLD, area_around, draw_ground

WHEEL_COLOUR = (0.10, 0.55, 0.25)
AIR_COLOUR = (0.85, 0.25, 0.10)
WHEEL_SCALE = 0.02
"""Length of the arrow of a wheel, m per N: a wheel at rest carries about 15 N."""
AIR_SCALE = 0.10
"""Length of the arrow of the tail, m per N: the air gives a few newtons."""
SHOWN_LENGTH = 0.015
"""Arrows shorter than this (m) are left out."""


@dataclass(frozen=True)
class ForceArrow:
    """One force over the run.

    Attributes:
        name: of the force.
        colour: red, green, blue from 0 to 1.
        points: where it acts in W, m, shape (n, 3).
        lengths: the arrow, force times scale, W axes, m, shape (n, 3).
    """

    name: str
    colour: tuple[float, float, float]
    points: FloatArray
    lengths: FloatArray

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Whether the arrow is long enough to be drawn, shape (n,)."""
        return np.linalg.norm(self.lengths, axis=1) > SHOWN_LENGTH


def force_arrows(logged: LoggedCar) -> list[ForceArrow]:
    """Every arrow of a run, one row per row of the log; none for a real car, whose log holds no forces."""
    run_log = logged.run_log
    if RECKONED in run_log.extra:
        return []
    arrows = [_wheel_arrow(run_log, wheel) for wheel in WHEELS]
    if logged.car.tail is not None:
        force = run_log.vector("tail_force", "truth_n")
        root, tip = tail_axis(logged)
        points = point_on_axis(force, run_log.vector("tail_force_moment", "truth_n_m"), root, tip)
        arrows.append(ForceArrow("air_on_tail", AIR_COLOUR, points, AIR_SCALE * force))
    return arrows


def _wheel_arrow(run_log: RunLog, wheel: str) -> ForceArrow:
    force = run_log.vector(f"wheel_force_{wheel}", "truth_n")
    points = run_log.vector(f"wheel_contact_{wheel}", "truth_m")
    return ForceArrow(f"ground_on_{wheel}", WHEEL_COLOUR, points, WHEEL_SCALE * force)


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


def point_on_axis(force: FloatArray, moment: FloatArray, root: FloatArray, tip: FloatArray) -> FloatArray:
    """The point of the tail's axis that is nearest to the line of action of a force.

    The line of action is q + s F with q = F x M / F.F, where M is the moment about the world origin. A point r + t u of
    the axis is nearest to it where (r + t u - q) is perpendicular to both lines. Without a force, or where it acts
    along the axis, it is the middle of the tail; beyond the ends it is the end.

    Args:
        force: F in W, N, shape (n, 3).
        moment: M about Wo, W axes, N m, shape (n, 3).
        root, tip: ends of the tail in W, m, shape (n, 3).
    """
    axis = tip - root
    square = np.einsum("ij,ij->i", force, force)[:, None]
    safe = np.where(square > 0.0, square, 1.0)
    q = np.cross(force, moment) / safe
    across = axis - force * np.einsum("ij,ij->i", force, axis)[:, None] / safe
    weight = np.einsum("ij,ij->i", across, axis)
    usable = (square[:, 0] > 0.0) & (weight > 1e-9 * np.einsum("ij,ij->i", axis, axis))
    fraction = np.einsum("ij,ij->i", across, q - root) / np.where(usable, weight, 1.0)
    fraction = np.where(usable, np.clip(fraction, 0.0, 1.0), 0.5)
    return root + fraction[:, None] * axis


FRAMES_PER_SECOND = 50.0
"""Frames per second of the replay, whatever its rate."""
RATES = (0.02, 20.0)
"""Slowest and fastest replay, seconds of the run per second."""
MOST_FRAMES = 1000
"""A replay of more than 20 s has fewer frames per second: a page of so many has 7 MB."""

TIP_COLOUR, COM_COLOUR = Rgba(0.93, 0.60, 0.10), Rgba(0.25, 0.30, 0.75)
_TRACE_RADIUS = 0.006
_TRACE_PIECES = 200
_SHAFT_RADIUS, _HEAD_RADIUS, _HEAD_LENGTH = 0.007, 0.018, 0.05
_FOLLOW_TIME = 0.15
"""Width (s) of the smoothing of the camera's path: it does not shake with the car."""
_CAMERA_SIDE = 0.45
"""Angle between the car's heading and the direction to the camera, rad."""


def record_run(run_log: RunLog, meshcat: Meshcat, rate: float = 1.0) -> LoggedCar:
    """Puts the replay of a run into a viewer and plays it there, again and again.

    Args:
        run_log: of a simulated run.
        meshcat: from `open_meshcat`.
        rate: seconds of the run per second of the replay; 0.25 is slow motion.

    Raises:
        LogError: the log cannot be replayed, see `add_logged_car`.
        UserError: rate out of range.
    """
    if not RATES[0] <= rate <= RATES[1]:
        raise UserError(f"--rate: {rate:g}; allowed: {RATES[0]:g} to {RATES[1]:g}")
    builder = DiagramBuilder()
    logged = add_logged_car(builder, run_log)
    MeshcatVisualizer.AddToBuilder(builder, logged.car.scene_graph, meshcat)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = logged.car.plant.GetMyMutableContextFromRoot(context)
    rows, frames_per_second = frame_rows(run_log.time, rate)
    draw_ground(meshcat, area_around(run_log.vector("position", "truth_m")))
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
    for arrow in force_arrows(logged):
        _draw_arrow(meshcat, animation, arrow, rows)
    _follow(meshcat, animation, logged, rows)
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(10_000)
    meshcat.PublishRecording()
    return logged


def frame_rows(time: FloatArray, rate: float) -> tuple[NDArray[np.int64], float]:
    """Row of the log nearest to each frame, first and last included, and the frames per second of the replay."""
    length = float(time[-1] - time[0]) / rate
    count = max(2, min(round(length * FRAMES_PER_SECOND), MOST_FRAMES) + 1)
    wanted = np.linspace(time[0], time[-1], count)
    after = np.clip(np.searchsorted(time, wanted), 1, time.size - 1)
    rows = np.where(wanted - time[after - 1] < time[after] - wanted, after - 1, after)
    return rows.astype(np.int64), (count - 1) / length


def _follow(meshcat: Meshcat, animation: MeshcatAnimation, logged: LoggedCar, rows: NDArray[np.int64]) -> None:
    """Moves the world so that the car stays at the origin, and looks at it from ahead, where roll is seen best."""
    run_log = logged.run_log
    path = _smooth(run_log.time, run_log.vector("com", "truth_m") * [1.0, 1.0, 0.0])
    for frame, row in enumerate(rows):
        animation.SetTransform(frame, WORLD, RigidTransform(-path[row]))
    meshcat.SetTransform(WORLD, RigidTransform(-path[rows[0]]))
    azimuth = camera_azimuth(run_log)
    distance, height, target = (3.0, 1.3, 0.5) if logged.car.tail is not None else (2.0, 0.9, 0.25)
    eye = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    meshcat.SetCameraPose(eye, np.array([0.0, 0.0, target]))


def camera_azimuth(run_log: RunLog) -> float:
    """Direction (rad about z) from the car to the camera: ahead and to the outside of the turn, halfway through it."""
    yaw = run_log.signal("yaw_truth_rad")
    final = float(np.clip(yaw[-1] - yaw[0], -np.pi / 2, np.pi / 2))
    side = -_CAMERA_SIDE if final >= 0 else _CAMERA_SIDE
    return float(yaw[0]) + 0.5 * final + side


def _smooth(time: FloatArray, path: FloatArray) -> FloatArray:
    """Path (n, 3) averaged with a Gaussian of `_FOLLOW_TIME`; its ends are continued straight on."""
    width = _FOLLOW_TIME / float(np.median(np.diff(time)))
    reach = min(int(np.ceil(3 * width)), len(path) - 1)
    if reach < 1:
        return path
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    kernel /= kernel.sum()
    padded = np.concatenate([2 * path[0] - path[reach:0:-1], path, 2 * path[-1] - path[-2 : -reach - 2 : -1]])
    return np.column_stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in range(3)])


def traces(logged: LoggedCar) -> list[tuple[str, Rgba, FloatArray]]:
    """Name, colour and points in W (n, 3), m, of the paths that are drawn: centre of mass and tail tip."""
    drawn = [("com", COM_COLOUR)] + ([("tail_tip", TIP_COLOUR)] if logged.car.tail is not None else [])
    return [(name, colour, logged.run_log.vector(name, "truth_m")) for name, colour in drawn]


def _draw_traces(meshcat: Meshcat, animation: MeshcatAnimation, logged: LoggedCar, rows: NDArray[np.int64]) -> None:
    last = len(rows) - 1
    edges = np.unique(np.linspace(0, last, min(_TRACE_PIECES, last) + 1).round().astype(int))
    for name, colour, points in traces(logged):
        for index, (start, end) in enumerate(pairwise(edges)):
            path = f"{WORLD}/trace/{name}/{index}"
            fine = np.unique(np.linspace(rows[start], rows[end], 4 * (end - start) + 1).round().astype(int))
            vertices, faces = tube(points[fine], _TRACE_RADIUS)
            meshcat.SetTriangleMesh(path, vertices, faces, colour)
            animation.SetProperty(0, path, "visible", False)
            animation.SetProperty(int(end), path, "visible", True)
            animation.SetProperty(last, path, "visible", True)  # every track has the same length, for the loop


def tube(points: FloatArray, radius: float) -> tuple[FloatArray, NDArray[np.int32]]:
    """A line of points (n, 3) as a square tube: vertices (3, 4 n) and faces (3, m); WebGL draws lines a pixel wide."""
    along = np.gradient(points, axis=0) if len(points) > 1 else np.ones_like(points)
    side = np.cross(along, [0.0, 0.0, 1.0])
    norm = np.linalg.norm(side, axis=1, keepdims=True)
    side = np.where(norm > 1e-9, side / np.where(norm > 1e-9, norm, 1.0), [0.0, 1.0, 0.0])
    up = np.cross(side, along)
    norm = np.linalg.norm(up, axis=1, keepdims=True)
    up = np.where(norm > 1e-9, up / np.where(norm > 1e-9, norm, 1.0), [0.0, 0.0, 1.0])
    rings = points[:, None, :] + radius * np.stack([side, up, -side, -up], axis=1)
    faces = []
    for ring in range(len(points) - 1):
        for corner in range(4):
            a, b = 4 * ring + corner, 4 * ring + (corner + 1) % 4
            faces += [[a, a + 4, b + 4], [a, b + 4, b]]
    return np.asfortranarray(rings.reshape(-1, 3).T), np.asfortranarray(np.array(faces, dtype=np.int32).T)


def _draw_arrow(meshcat: Meshcat, animation: MeshcatAnimation, arrow: ForceArrow, rows: NDArray[np.int64]) -> None:
    path = f"{WORLD}/forces/{arrow.name}"
    colour = Rgba(*arrow.colour)
    meshcat.SetObject(f"{path}/shaft", Cylinder(_SHAFT_RADIUS, 1.0), colour)
    meshcat.SetObject(f"{path}/head", MeshcatCone(_HEAD_LENGTH, _HEAD_RADIUS, _HEAD_RADIUS), colour)
    turned = RotationMatrix.MakeXRotation(np.pi)  # the cone has its point at the origin and opens along z
    shown, last, was_shown = arrow.shown, len(rows) - 1, None
    for frame, row in enumerate(rows):
        if shown[row] != was_shown or frame == last:
            was_shown = shown[row]
            animation.SetProperty(frame, path, "visible", bool(was_shown))
        if not was_shown:
            continue
        length = float(np.linalg.norm(arrow.lengths[row]))
        shaft = max(length - _HEAD_LENGTH, 1e-3)
        X_WA = RigidTransform(shortest_turn(arrow.lengths[row] / length), arrow.points[row])
        animation.SetTransform(frame, path, X_WA)
        animation.SetProperty(frame, f"{path}/shaft", "scale", [1.0, 1.0, shaft])
        animation.SetTransform(frame, f"{path}/shaft", RigidTransform(np.array([0.0, 0.0, shaft / 2])))
        animation.SetTransform(
            frame, f"{path}/head", RigidTransform(turned, np.array([0.0, 0.0, shaft + _HEAD_LENGTH]))
        )
    meshcat.SetProperty(path, "visible", bool(shown[rows[0]]))


def shortest_turn(direction: FloatArray) -> RotationMatrix:
    """Rotation that turns z to a unit vector (3,) about the axis across both; half a turn about x for -z."""
    w = 1.0 + float(direction[2])
    if w < 1e-9:
        return RotationMatrix.MakeXRotation(np.pi)
    return RotationMatrix(Quaternion(np.array([w, -direction[1], direction[0], 0.0]) / np.sqrt(2.0 * w)))
