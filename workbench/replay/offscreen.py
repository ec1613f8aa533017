"""Pictures of logged runs without a display: Drake's VTK renderer draws the robot, NumPy the floor and the shadow.

VTK needs an EGL driver (Mesa's draws in software). Without one it takes the whole process down, so that a process of
its own tries first. Floor and shadow come from `picture`: VTK's own lines flicker far away, and its shadows cost ten
times as much as the robot (README.md of this folder has the figures).
"""

import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
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

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.replay.force_arrows import force_arrows
from aerodima.workbench.replay.logged_plant import add_logged_run
from aerodima.workbench.replay.picture import Camera, draw_shadow, floor_picture, posed_triangles, visible_surfaces
from aerodima.workbench.replay.recording import traces

Pixels = NDArray[np.uint8]
"""Red, green, blue; shape (height, width, 3)."""

_RENDERER = "vtk"
_CLEAR = (232, 235, 237)
"""What VTK leaves where no robot is: the floor's colour, so that its smooth edges pass into it."""
_CLIPPING = ClippingRange(0.05, 100.0)
_SUN, _LAMP = 0.9, 0.35
"""Light from above and from the camera, relative."""
_TRY = "from aerodima.workbench.replay.offscreen import try_renderer; try_renderer()"


def check_renderer() -> None:
    """Lets a process of its own draw one picture.

    Raises:
        UserError: it did not come through: no EGL driver.
    """
    if not _renderer_works():
        raise UserError(
            "--video: no off-screen renderer: Drake's VTK finds no OpenGL through EGL here; install Mesa's (libegl1, "
            "libgl1-mesa-dri), or write --html or --strip, which need none"
        )


@cache
def _renderer_works() -> bool:
    done = subprocess.run([sys.executable, "-c", _TRY], capture_output=True, check=False)
    return done.returncode == 0


def try_renderer() -> None:
    """Draws a picture of nothing; a process without EGL driver dies of it."""
    from pydrake.geometry import SceneGraph

    scene = SceneGraph()
    scene.AddRenderer(_RENDERER, MakeRenderEngineVtk(RenderEngineVtkParams()))
    query: Any = scene.get_query_output_port().Eval(scene.CreateDefaultContext())
    query.RenderColorImage(_render_camera(8, 8, 8.0), scene.world_frame_id(), RigidTransform())


def _render_camera(width: int, height: int, focal_length: float) -> ColorRenderCamera:
    info = CameraInfo(width, height, focal_length, focal_length, 0.5 * width - 0.5, 0.5 * height - 0.5)
    return ColorRenderCamera(RenderCameraCore(_RENDERER, info, _CLIPPING, RigidTransform()))


class OffscreenRun:
    """The robot of a run log before the camera; see `add_logged_run` for the errors.

    Attributes:
        logged: run, plant and its positions.
    """

    def __init__(self, run_log: RunLog) -> None:
        builder = DiagramBuilder()
        self.logged = logged = add_logged_run(builder, run_log)
        sun = LightParameter(type="directional", direction=np.array([-0.25, 0.35, -1.0]), frame="world", intensity=_SUN)
        lamp = LightParameter(type="directional", direction=np.array([0.0, 0.0, 1.0]), frame="camera", intensity=_LAMP)
        clear = np.array(_CLEAR) / 255.0
        engine = MakeRenderEngineVtk(RenderEngineVtkParams(default_clear_color=clear, lights=[sun, lamp]))
        logged.scene_graph.AddRenderer(_RENDERER, engine)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = logged.plant.GetMyMutableContextFromRoot(self._context)
        self._scene_context = logged.scene_graph.GetMyContextFromRoot(self._context)
        self._surfaces = visible_surfaces(logged)
        self._arrows, self._traces = force_arrows(self.logged), traces(self.logged)

    def picture(self, row: int, camera: Camera) -> Pixels:
        """The robot in one row of the log on its floor, with its shadow, paths and forces."""
        logged = self.logged
        logged.move(self._plant_context, row)
        floor = floor_picture(camera)
        triangles, _ = posed_triangles(self._surfaces, logged.plant, self._plant_context)
        draw_shadow(floor, camera, triangles)
        pixels = np.round(255.0 * floor).astype(np.uint8)
        query: Any = logged.scene_graph.get_query_output_port().Eval(self._scene_context)
        X_WC = RigidTransform(RotationMatrix(camera.axes.T), camera.p_WC)
        render_camera = _render_camera(camera.width, camera.height, camera.focal_length)
        drawn = query.RenderColorImage(render_camera, logged.scene_graph.world_frame_id(), X_WC).data[..., :3]
        robot = np.any(drawn != np.array(_CLEAR, dtype=np.uint8), axis=-1)
        pixels[robot] = drawn[robot]
        return self._with_lines(pixels, row, camera)

    def _with_lines(self, pixels: Pixels, row: int, camera: Camera) -> Pixels:
        """Paths so far, and forces of this moment, over everything else."""
        image = Image.fromarray(pixels)
        draw = ImageDraw.Draw(image)
        for _, colour, points in self._traces:
            _draw_line(draw, camera, points[: row + 1], (colour.r(), colour.g(), colour.b()), 2)
        for arrow in self._arrows:
            if arrow.shown[row]:
                ends = np.array([arrow.points[row], arrow.points[row] + arrow.lengths[row]])
                _draw_line(draw, camera, ends, arrow.colour, 3)
        return np.asarray(image)


def _draw_line(
    draw: ImageDraw.ImageDraw, camera: Camera, points: FloatArray, colour: tuple[float, float, float], width: int
) -> None:
    """A line through points (n, 3) in W, m, as far as they lie before the camera."""
    before = (points - camera.p_WC) @ camera.axes[2] > _CLIPPING.near()
    seen = camera.project(points[before])[:, :2]
    if len(seen) > 1:
        red, green, blue = (round(255 * part) for part in colour)
        draw.line([(float(x), float(y)) for x, y in seen], (red, green, blue), width, joint="curve")
