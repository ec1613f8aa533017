"""A robot as a picture: triangles of its visible shapes, perspective camera, depth buffer, one sun, metre lines.

Plain NumPy and the same bits everywhere: Drake's own offscreen renderer (`offscreen`, for video) needs an EGL driver,
which a container or a car's computer may not have.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from pydrake.geometry import (
    Box,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    Mesh,
    ReadObjToTriangleSurfaceMesh,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import ModelError
from aerodima.workbench.logs.schema import RunLog


@dataclass(frozen=True)
class Camera:
    """A camera without roll.

    Attributes:
        p_WC: its position in W, m, shape (3,).
        target: the point of W that it looks at, m, shape (3,).
        focal_length: pixels.
        width, height: of the picture, pixels.
    """

    p_WC: FloatArray
    target: FloatArray
    focal_length: float
    width: int
    height: int

    @property
    def axes(self) -> FloatArray:
        """Rows: right, down and forward in W, shape (3, 3)."""
        forward = (self.target - self.p_WC) / np.linalg.norm(self.target - self.p_WC)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(forward, right), forward])

    def project(self, points: FloatArray) -> FloatArray:
        """Points (..., 3) in W, m, as column, row (pixels) and inverse depth (1/m), shape (..., 3)."""
        p_C = (points - self.p_WC) @ self.axes.T
        inverse = 1.0 / np.maximum(p_C[..., 2], 1e-3)
        column = 0.5 * self.width + self.focal_length * p_C[..., 0] * inverse
        row = 0.5 * self.height + self.focal_length * p_C[..., 1] * inverse
        return np.stack([column, row, inverse], axis=-1)

    def rays(self) -> FloatArray:
        """Direction in W through each pixel with unit depth, shape (height, width, 3)."""
        right, down, forward = self.axes
        columns = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal_length
        rows = (np.arange(self.height) + 0.5 - 0.5 * self.height) / self.focal_length
        return forward + columns[None, :, None] * right + rows[:, None, None] * down


_FOLLOW_TIME = 0.15
"""Width (s) of the smoothing of the camera's path: it does not shake with the car."""
_CAMERA_SIDE = 0.45
"""Angle between the car's heading and the direction to the camera, rad."""


def camera_path(run_log: RunLog) -> FloatArray:
    """The point of the floor that stays in the middle of the picture, W, m, shape (n, 3)."""
    return _smooth(run_log.time, run_log.vector("com", "truth_m") * [1.0, 1.0, 0.0])


def camera_pose(azimuth: float, place: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    """Where a camera stands that follows a point of the floor, and what it looks at.

    Args:
        azimuth: direction to the camera, rad about z.
        place: `LoggedRun.camera_place`.

    Returns:
        Eye and target, both from that point, m, shape (3,).
    """
    distance, height, target = place
    eye = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    return eye, np.array([0.0, 0.0, target])


def camera_azimuth(run_log: RunLog) -> float:
    """Direction (rad about z) from the robot to the camera: ahead and to the outside of the turn, halfway through it.

    A plant without a base has no heading: the camera looks along y then, a little from the side.
    """
    if "yaw_truth_rad" not in run_log.table:
        return -0.5 * np.pi + _CAMERA_SIDE
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


_SUN = np.array([0.25, -0.35, 1.0]) / np.linalg.norm([0.25, -0.35, 1.0])
"""Direction to the sun in the picture's axes: x to the right, y away from the camera, z up."""
_AMBIENT, _SHADOW = 0.5, 0.72
_SKY, _FLOOR, _FINE, _METRE = (0.93, 0.95, 0.97), (0.91, 0.92, 0.93), (0.82, 0.84, 0.86), (0.52, 0.56, 0.62)
_METRE_WIDTH, _FINE_WIDTH = 0.012, 0.006
"""Half widths of the lines on the floor, m."""


def draw_picture(camera: Camera, triangles: FloatArray, colours: FloatArray, finer: int = 2) -> FloatArray:
    """Draws triangles that stand on the floor z = 0.

    Args:
        camera: of the finished picture.
        triangles: corners in W, m, shape (n, 3, 3).
        colours: red, green, blue from 0 to 1, shape (n, 3).
        finer: each pixel is the mean of finer x finer.

    Returns:
        Colours from 0 to 1, shape (height, width, 3).
    """
    fine = Camera(camera.p_WC, camera.target, finer * camera.focal_length, finer * camera.width, finer * camera.height)
    sun = _sun_in_world(fine)
    picture = floor_picture(camera).repeat(finer, axis=0).repeat(finer, axis=1)  # its lines are smooth by themselves
    inverse_depth = np.maximum(-fine.rays()[..., 2] / camera.p_WC[2], 0.0)
    shadow = np.zeros(inverse_depth.shape, dtype=bool)
    for window, corners in _windows(fine, _on_floor(triangles, sun)):
        inside, _ = _covered(window, corners)
        shadow[window] |= inside
    picture[shadow] *= _SHADOW
    shaded = colours * _brightness(triangles, sun, fine.p_WC)[:, None]
    for (window, corners), colour in zip(_windows(fine, triangles), shaded, strict=True):
        inside, depth = _covered(window, corners)
        nearer = inside & (depth > inverse_depth[window])
        inverse_depth[window][nearer] = depth[nearer]
        picture[window][nearer] = colour
    pixels = picture.reshape(camera.height, finer, camera.width, finer, 3)
    return np.clip(pixels.mean(axis=(1, 3)), 0.0, 1.0)


def draw_shadow(picture: FloatArray, camera: Camera, triangles: FloatArray) -> None:
    """Darkens a picture of `floor_picture` where triangles (n, 3, 3; W, m) throw their shadow, with hard edges."""
    mask = Image.new("1", (camera.width, camera.height))
    draw = ImageDraw.Draw(mask)
    flat = _on_floor(triangles, _sun_in_world(camera))
    before = ((flat - camera.p_WC) @ camera.axes[2]).min(axis=1) > 0.0
    for corners in camera.project(flat[before])[..., :2].reshape(-1, 6).tolist():
        draw.polygon(corners, fill=1)
    picture[np.asarray(mask)] *= _SHADOW


def _on_floor(triangles: FloatArray, sun: FloatArray) -> FloatArray:
    """Where the sun throws them, shape (n, 3, 3)."""
    return triangles - sun * (np.maximum(triangles[..., 2:], 0.0) / sun[2])


def _sun_in_world(camera: Camera) -> FloatArray:
    right = camera.axes[0]
    away = np.cross([0.0, 0.0, 1.0], right)
    return _SUN[0] * right + _SUN[1] * away + _SUN[2] * np.array([0.0, 0.0, 1.0])


def _brightness(triangles: FloatArray, sun: FloatArray, eye: FloatArray) -> FloatArray:
    """Flat shading of the side that faces the eye, shape (n,)."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(length > 0.0, length, 1.0)
    facing = np.einsum("ij,ij->i", normal, eye - triangles.mean(axis=1))
    towards_sun = np.einsum("ij,j->i", normal, sun) * np.sign(facing)
    return _AMBIENT + (1.05 - _AMBIENT) * np.clip(0.55 * towards_sun + 0.45, 0.0, 1.0)


def floor_picture(camera: Camera) -> FloatArray:
    """Floor and sky, colours from 0 to 1, shape (height, width, 3)."""
    rays = camera.rays()
    horizon = int(np.count_nonzero(rays[:, 0, 2] >= -1e-6))  # the camera has no roll: rows of sky, then rows of floor
    rays = rays[horizon:].astype(np.float32)
    distance = camera.p_WC[2] / -rays[..., 2]
    pixel = distance / camera.focal_length / np.clip(-rays[..., 2], 0.05, 1.0)
    x, y = (camera.p_WC[axis] + rays[..., axis] * distance for axis in range(2))
    fine, metre = (
        np.maximum(_line_share(x, step, half, pixel), _line_share(y, step, half, pixel))
        for step, half in ((0.25, _FINE_WIDTH), (1.0, _METRE_WIDTH))
    )
    clear = 1.0 - np.clip(distance / 40.0, 0.0, 1.0)
    shares = np.stack([(1 - fine) * (1 - metre) * clear, fine * (1 - metre) * clear, metre * clear, 1 - clear], axis=-1)
    picture = np.empty((camera.height, camera.width, 3))
    picture[:horizon] = _SKY
    picture[horizon:] = shares @ np.array([_FLOOR, _FINE, _METRE, _SKY])
    return picture


def _line_share(place: FloatArray, step: float, half: float, pixel: FloatArray) -> FloatArray:
    """Share of each pixel that lines every `step` with that half width cover, all in m."""
    to_line = np.abs(place - step * np.round(place / step))
    cover = np.clip((half + pixel - to_line) / (2 * pixel), 0.0, 1.0)
    return np.minimum(cover, 2 * half / np.maximum(pixel, 2 * half))


Window = tuple[slice, slice]


def _windows(camera: Camera, triangles: FloatArray) -> Iterator[tuple[Window, list[list[float]]]]:
    """For each triangle the rows and columns about it, and column, row and inverse depth of its corners."""
    seen = camera.project(triangles)
    most = [camera.width, camera.height]
    low = np.clip(np.floor(seen[..., :2].min(axis=1)), 0, most).astype(int).tolist()
    high = np.clip(np.ceil(seen[..., :2].max(axis=1)), 0, most).astype(int).tolist()
    for (left, top), (right, bottom), corners in zip(low, high, seen.tolist(), strict=True):
        yield (slice(top, bottom), slice(left, right)), corners


def _covered(window: Window, corners: list[list[float]]) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which pixels of a window have their centre in a triangle, and the inverse depth there, which is linear in it."""
    rows, columns = window
    y = np.arange(rows.start, rows.stop)[:, None] + 0.5
    x = np.arange(columns.start, columns.stop)[None, :] + 0.5
    (xa, ya, wa), (xb, yb, wb), (xc, yc, wc) = corners
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if abs(area) < 1e-9:
        nothing = np.zeros((y.size, x.size))
        return nothing.astype(bool), nothing
    b = ((x - xa) * (yc - ya) - (xc - xa) * (y - ya)) / area
    c = ((xb - xa) * (y - ya) - (x - xa) * (yb - ya)) / area
    inside = (b >= 0.0) & (c >= 0.0) & (b + c <= 1.0)
    return inside, wa + b * (wb - wa) + c * (wc - wa)


_ROUND = 28
"""Corners of a circle."""


@dataclass(frozen=True)
class Surface:
    """One visible shape.

    Attributes:
        body: that it is fixed to.
        triangles: corners in the body frame, m, shape (n, 3, 3): triangle, corner, axis.
        colour: red, green, blue from 0 to 1.
    """

    body: RigidBody
    triangles: FloatArray
    colour: tuple[float, float, float]


class PlantWithShapes(Protocol):
    """A plant whose shapes are in a scene graph: a car, a logged run."""

    @property
    def plant(self) -> MultibodyPlant:
        """With the bodies."""

    @property
    def scene_graph(self) -> SceneGraph:
        """With their shapes."""


def visible_surfaces(shown: PlantWithShapes) -> list[Surface]:
    """Every shape with the illustration role.

    Raises:
        ModelError: a shape of another kind than box, cylinder, ellipsoid, sphere, convex hull or OBJ mesh.
    """
    inspector = shown.scene_graph.model_inspector()
    surfaces = []
    for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
        corners = shape_triangles(inspector.GetShape(geometry), inspector.GetName(geometry))
        X_BG = inspector.GetPoseInFrame(geometry)
        moved = corners @ X_BG.rotation().matrix().T + X_BG.translation()
        body = shown.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
        surfaces.append(Surface(body, moved, colour_of(inspector, geometry)))
    return surfaces


def posed_triangles(
    surfaces: list[Surface], plant: MultibodyPlant, plant_context: Context
) -> tuple[FloatArray, FloatArray]:
    """Triangles (n, 3, 3) in W, m, and their colours (n, 3) in one pose of the plant."""
    corners, colours = [], []
    for surface in surfaces:
        X_WB = plant.EvalBodyPoseInWorld(plant_context, surface.body)
        corners.append(surface.triangles @ X_WB.rotation().matrix().T + X_WB.translation())
        colours.append(np.tile(surface.colour, (len(surface.triangles), 1)))
    return np.concatenate(corners), np.concatenate(colours)


def shape_triangles(shape: Shape, name: str) -> FloatArray:
    """Surface of a shape in its own frame, shape (n, 3, 3), m."""
    if isinstance(shape, Box):
        return _box() * [shape.width(), shape.depth(), shape.height()]
    if isinstance(shape, Cylinder):
        return _cylinder() * [shape.radius(), shape.radius(), shape.length()]
    if isinstance(shape, Ellipsoid):
        return _sphere() * [shape.a(), shape.b(), shape.c()]
    if isinstance(shape, Sphere):
        return _sphere() * shape.radius()
    if isinstance(shape, Mesh) and shape.extension() == ".obj":
        mesh = ReadObjToTriangleSurfaceMesh(shape.source().path(), shape.scale3())
        vertices = np.array([mesh.vertex(i) for i in range(mesh.num_vertices())])
        return vertices[[[face.vertex(i) for i in range(3)] for face in mesh.triangles()]]
    if isinstance(shape, Convex):
        hull = shape.GetConvexHull()
        corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        faces = [hull.element(i) for i in range(hull.num_faces())]
        fans = [[face.vertex(i) for i in (0, k, k + 1)] for face in faces for k in range(1, face.num_vertices() - 1)]
        return np.asarray(corners[fans])
    raise ModelError(
        f"visual {name!r}: a {type(shape).__name__} cannot be drawn; "
        "allowed: box, cylinder, ellipsoid, convex hull, OBJ"
    )


def colour_of(inspector: SceneGraphInspector, geometry: GeometryId) -> tuple[float, float, float]:
    """Red, green and blue of a visible shape, from 0 to 1."""
    properties = inspector.GetIllustrationProperties(geometry)
    colour = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(0.7, 0.7, 0.7))
    assert isinstance(colour, Rgba)
    return colour.r(), colour.g(), colour.b()


def _box() -> FloatArray:
    """Cube of side 1 about the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return np.concatenate([[corners[[a, b, c]], corners[[a, c, d]]] for a, b, c, d in sides])


def _cylinder() -> FloatArray:
    """Radius 1, length 1 along z."""
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND + 1)
    rim = np.column_stack([np.cos(angle), np.sin(angle)])
    low, high = (np.column_stack([rim, np.full(len(rim), z)]) for z in (-0.5, 0.5))
    triangles = []
    for i in range(_ROUND):
        triangles += [[low[i], low[i + 1], high[i + 1]], [low[i], high[i + 1], high[i]]]
        triangles += [[high[i], high[i + 1], [0, 0, 0.5]], [low[i + 1], low[i], [0, 0, -0.5]]]
    return np.array(triangles)


def _sphere() -> FloatArray:
    """Radius 1."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, _ROUND + 1)
    polar = np.linspace(0.0, np.pi, _ROUND // 2 + 1)
    grid = np.stack(
        [
            np.outer(np.sin(polar), np.cos(azimuth)),
            np.outer(np.sin(polar), np.sin(azimuth)),
            np.outer(np.cos(polar), np.ones_like(azimuth)),
        ],
        axis=-1,
    )
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    upper, lower = np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)
    return np.concatenate([upper.reshape(-1, 3, 3), lower.reshape(-1, 3, 3)])
