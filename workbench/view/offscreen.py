"""Pictures of logged runs without a display: Drake's VTK draws the robot, NumPy floor and shadow.

VTK needs an EGL driver (Mesa's draws in software). Without one it takes the whole process down, so
a separate process tries first. VTK's own floor lines flicker far away, and its shadows cost ten
times as much as the robot (README.md of this folder has the figures): a second picture of the
robot, from the sun, shows where its shadow falls.
"""

import math
import subprocess
import sys
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo
from scipy.ndimage import map_coordinates

from aerodima.workbench.core.array_types import ArrayPair, FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.logged_run import Place, add_logged_run
from aerodima.workbench.view.recording import camera_pose, traces

Pixels = NDArray[np.uint8]
"""Red, green, blue; shape (height, width, 3)."""

_RENDERER = "vtk"
_CLEAR = np.array((232, 235, 237), dtype=np.uint8)
"""Colour that VTK leaves where there is no robot: the floor's, so that smooth edges blend in."""
_CLIPPING = ClippingRange(0.05, 100.0)
"""Nearest and farthest distance that is drawn, m."""
_SUNLIGHT = 0.9
"""Light from above, relative."""
_LAMP = 0.7
"""Light from the camera, relative."""
_SUN = np.array([0.25, -0.35, 1.0]) / np.linalg.norm([0.25, -0.35, 1.0])
"""Direction to the sun in W."""
_SUN_DISTANCE = 40.0
"""Distance of the camera that sees the car from the sun, m."""
_SUN_PIXELS = 512
"""Width and height of that camera's picture, pixels."""
_SHADOW = 0.72
"""Brightness of the floor in full shadow, relative."""
# Colours: red, green, blue from 0 to 1.
_SKY = (0.93, 0.95, 0.97)
_FLOOR = (0.91, 0.92, 0.93)
_FINE = (0.82, 0.84, 0.86)
_METRE = (0.52, 0.56, 0.62)
_METRE_WIDTH = 0.012
"""Half width of the lines on the floor at each metre, m."""
_FINE_WIDTH = 0.006
"""Half width of the lines between them, m."""
_FIELD_OF_VIEW = math.radians(34.0)
"""Angle that the height of a picture spans, rad."""
_HEAD = 9.0
"""Length of the head of an arrow, pixels."""
_RENDERER_TEST = "from aerodima.workbench.view.offscreen import try_renderer; try_renderer()"


@dataclass(frozen=True)
class Camera:
    """A camera without roll.

    Attributes:
        p_WC: position of the camera in W, m, shape (3,).
        target: point in W that the camera looks at, m, shape (3,).
        focal_length: focal length, pixels.
        width: width of the picture, pixels.
        height: height of the picture, pixels.
    """

    p_WC: FloatArray
    target: FloatArray
    focal_length: float
    width: int
    height: int

    @property
    def axes(self) -> FloatArray:
        """Gives the rows right, down and forward in W, shape (3, 3)."""
        forward = self.target - self.p_WC
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(forward, right), forward])

    def project(self, points: FloatArray) -> FloatArray:
        """Projects points (..., 3) in W, m, to column, row (pixels), inverse depth (1/m), shape
        (..., 3).
        """
        p_C = (points - self.p_WC) @ self.axes.T
        inverse = 1.0 / np.maximum(p_C[..., 2:], 1e-3)
        middle = 0.5 * np.array([self.width, self.height])
        pixels = middle + self.focal_length * p_C[..., :2] * inverse
        return np.concatenate([pixels, inverse], axis=-1)

    def rays(self) -> FloatArray:
        """Gives the direction in W through each pixel with unit depth, shape (height, width, 3)."""
        right, down, forward = self.axes
        columns = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal_length
        rows = (np.arange(self.height) + 0.5 - 0.5 * self.height) / self.focal_length
        return forward + columns[None, :, None] * right + rows[:, None, None] * down

    @property
    def render_camera(self) -> ColorRenderCamera:
        """Makes the same camera for VTK."""
        focal_lengths = (self.focal_length, self.focal_length)
        centre = (0.5 * self.width - 0.5, 0.5 * self.height - 0.5)
        info = CameraInfo(self.width, self.height, *focal_lengths, *centre)
        return ColorRenderCamera(RenderCameraCore(_RENDERER, info, _CLIPPING, RigidTransform()))


def floor_picture(camera: Camera, height: float) -> ArrayPair:
    """Draws floor at a height (m) and sky: colours from 0 to 1, shape (rows, columns, 3), and
    points of the floor in W.

    The camera has no roll: there are rows of sky, then rows of floor, whose points (m) have the
    shape (n, columns, 3).
    """
    rays = camera.rays()
    horizon = int(np.count_nonzero(rays[:, 0, 2] >= -1e-6))
    rays = rays[horizon:]
    distance = (camera.p_WC[2] - height) / -rays[..., 2]
    points = camera.p_WC + rays * distance[..., None]
    pixel = distance / camera.focal_length / np.clip(-rays[..., 2], 0.05, 1.0)
    fine = _line_share(points, 0.25, _FINE_WIDTH, pixel)
    metre = _line_share(points, 1.0, _METRE_WIDTH, pixel)
    clear = 1.0 - np.clip(distance / 40.0, 0.0, 1.0)
    lines = _blend(_blend(_FLOOR, _FINE, fine), _METRE, metre)
    picture = np.full((camera.height, camera.width, 3), _SKY)
    picture[horizon:] = _blend(_SKY, lines, clear)
    return picture, points


def _blend(below: ArrayLike, above: ArrayLike, share: FloatArray) -> FloatArray:
    """Covers colours with others by a share of each pixel, (m, n)."""
    lower = np.asarray(below, float)
    return lower + share[..., None] * (np.asarray(above, float) - lower)


def _line_share(points: FloatArray, step: float, half: float, pixel: FloatArray) -> FloatArray:
    """Computes the share of each pixel that is covered by lines every `step` with the half width
    `half`, all in m.
    """
    place = points[..., :2]
    nearest = step * np.round(place / step)
    to_line = np.min(np.abs(place - nearest), axis=-1)
    cover = np.clip((half + pixel - to_line) / (2 * pixel), 0.0, 1.0)
    return np.minimum(cover, 2 * half / np.maximum(pixel, 2 * half))


@cache
def check_renderer() -> None:
    """Lets a separate process draw one picture, unless that has succeeded already.

    Raises:
        UserError: the process failed, since there is no EGL driver.
    """
    done = subprocess.run([sys.executable, "-c", _RENDERER_TEST], capture_output=True, check=False)
    if done.returncode != 0:
        raise UserError(
            "no off-screen renderer: Drake's VTK finds no OpenGL through EGL here; install Mesa's "
            "(libegl1, libgl1-mesa-dri), or use `aerodima replay --html`, which needs none"
        )


def try_renderer() -> None:
    """Draws an empty picture; a process without an EGL driver dies."""
    from pydrake.geometry import SceneGraph

    scene = SceneGraph()
    scene.AddRenderer(_RENDERER, MakeRenderEngineVtk(RenderEngineVtkParams()))
    query: Any = scene.get_query_output_port().Eval(scene.CreateDefaultContext())
    camera = Camera(np.ones(3), np.zeros(3), 8.0, 8, 8).render_camera
    query.RenderColorImage(camera, scene.world_frame_id(), RigidTransform())


class OffscreenRun:
    """The robot of a run log in front of a camera; see `add_logged_run` for the errors.

    Attributes:
        logged: logged run with its plant and positions.
    """

    def __init__(self, run_log: RunLog) -> None:
        check_renderer()
        builder = DiagramBuilder()
        logged = add_logged_run(builder, run_log)
        self.logged = logged
        light = partial(LightParameter, type="directional")
        sun = light(direction=-_SUN, frame="world", intensity=_SUNLIGHT)
        lamp = light(direction=np.array([0.0, 0.0, 1.0]), frame="camera", intensity=_LAMP)
        parameters = RenderEngineVtkParams(default_clear_color=_CLEAR / 255.0, lights=[sun, lamp])
        logged.scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(parameters))
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = logged.plant.GetMyMutableContextFromRoot(self._context)
        self._scene_context = logged.scene_graph.GetMyContextFromRoot(self._context)
        self._path = logged.camera_path
        self._traces = traces(logged)

    def camera(self, row: int, azimuth: float, place: Place, size: tuple[int, int]) -> Camera:
        """Places the camera that follows the robot in one row of the log; see `camera_pose`.

        Args:
            row: index of the row of the log.
            azimuth: direction to the camera, rad about z.
            place: distance and heights as in `LoggedRun.camera_place`, m.
            size: width and height of the picture, pixels.
        """
        eye, target = camera_pose(azimuth, place)
        focal_length = 0.5 * size[1] / math.tan(0.5 * _FIELD_OF_VIEW)
        point = self._path[row]
        return Camera(point + eye, point + target, focal_length, *size)

    def picture(self, row: int, camera: Camera) -> Image.Image:
        """Draws the robot in one row of the log on its floor, with its shadow, paths so far and
        forces of the moment.
        """
        self.logged.move(self._plant_context, row)
        picture, floor = floor_picture(camera, self.logged.floor)
        if floor.size:
            picture[-len(floor) :] *= 1.0 - (1.0 - _SHADOW) * self._shadow(row, floor)[..., None]
        pixels = np.round(255.0 * picture).astype(np.uint8)
        drawn = self._robot(camera)
        seen = np.any(drawn != _CLEAR, axis=-1)
        pixels[seen] = drawn[seen]
        image = Image.fromarray(pixels)
        draw = ImageDraw.Draw(image)
        for _, colour, points in self._traces:
            _draw_line(draw, camera, points[: row + 1], colour, 2)
        for arrow in self.logged.arrows:
            if arrow.shown[row]:
                foot = arrow.points[row]
                ends = np.array([foot, foot + arrow.lengths[row]])
                _draw_line(draw, camera, ends, arrow.colour, 3, head=True)
        return image

    def _robot(self, camera: Camera) -> Pixels:
        """Draws the robot alone."""
        query: Any = self.logged.scene_graph.get_query_output_port().Eval(self._scene_context)
        X_WC = RigidTransform(RotationMatrix(camera.axes.T), camera.p_WC)
        world = self.logged.scene_graph.world_frame_id()
        return query.RenderColorImage(camera.render_camera, world, X_WC).data[..., :3]

    def _shadow(self, row: int, floor: FloatArray) -> FloatArray:
        """Computes how much of the sun the robot takes from points of the floor (m, n, 3), from 0
        to 1, shape (m, n).
        """
        middle = self.logged.run_log.vector("com", "truth_m")[row]
        radius = 0.5 * self.logged.camera_place[0]
        focal_length = 0.5 * _SUN_PIXELS * _SUN_DISTANCE / radius
        sun = Camera(middle + _SUN_DISTANCE * _SUN, middle, focal_length, _SUN_PIXELS, _SUN_PIXELS)
        hidden = np.any(self._robot(sun) != _CLEAR, axis=-1).astype(float)
        columns, rows, _ = np.moveaxis(sun.project(floor), -1, 0)
        return np.asarray(map_coordinates(hidden, [rows - 0.5, columns - 0.5], order=1, cval=0.0))


def _draw_line(
    draw: ImageDraw.ImageDraw, camera: Camera, points: FloatArray, colour: tuple[float, ...],
    width: int,
    head: bool = False,
) -> None:  # fmt: skip
    """Draws a line through points (n, 3) in W, m, in front of the camera; an arrow has a head."""
    before = (points - camera.p_WC) @ camera.axes[2] > _CLIPPING.near()
    seen = camera.project(points[before])[:, :2]
    if len(seen) < 2:
        return
    fill = tuple(round(255 * part) for part in colour)
    if head:
        tip = seen[-1].copy()
        along = tip - seen[-2]
        along *= _HEAD / max(float(np.linalg.norm(along)), 1e-9)
        across = 0.45 * np.array([-along[1], along[0]])
        foot = tip - along
        seen[-1] = foot
        draw.polygon([*tip, *(foot + across), *(foot - across)], fill)
    draw.line(seen.ravel().tolist(), fill, width, joint="curve")
