"""Drake's Meshcat as the workbench shows it: local only, light floor with metre grid, no axes.

Everything is drawn below the path `/drake`, so that a replay can move the world under a camera that
stays with the car.
"""

import ctypes
import logging
import math
from itertools import product

import numpy as np
from pydrake.geometry import Box, Meshcat, MeshcatParams, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, Diagram

from aerodima.workbench.car.car_station import simulated_car
from aerodima.workbench.core.array_types import ArrayPair, FloatArray, Pair
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.ranges import NO_UNIT, check_range

Area = tuple[float, float, float, float]
"""Extent of a floor: x from, x to, y from, y to, m."""
HOST = "127.0.0.1"
PORTS = (1024, 65535)
"""Lowest and highest port that Drake's Meshcat takes; a lower one ends the whole program."""

WORLD = "/drake"
GROUND = f"{WORLD}/ground"
_FLOOR = Rgba(0.90, 0.91, 0.92)
"""Colour of the floor."""
_FINE = Rgba(0.80, 0.82, 0.84)
"""Colour of the lines between the metres."""
_METRE = Rgba(0.42, 0.46, 0.52)
"""Colour of the lines at each metre."""
_FINE_STEP = 0.25
"""Distance of the lines between the metres, m."""
_SHADOW_BIAS = -0.01 / 500.0
"""Bias of the shadow: one centimetre of the 500 m that the shadow of Meshcat's lamp reaches."""
_LIVE_AREA = (-4.0, 16.0, -8.0, 10.0)
"""Floor of a live run (x from, x to, y from, y to; m): where the car will go is not known yet."""
_AREA = (-14.0, 14.0, -14.0, 14.0)
"""The floor that is drawn around the car, m."""


def open_meshcat(port: int | None = None) -> Meshcat:
    """Starts a viewer on 127.0.0.1, with a floor and a camera that sees a whole run from the side.

    Args:
        port: 1024 to 65535; None takes the first free one from 7000 on. Its address is
            `meshcat.web_url()`.

    Raises:
        UserError: the port is in use or not in that range, or none is free.
    """
    if port is not None:
        check_range("--port", port, *PORTS, NO_UNIT)
    meshcat = _start(port)
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    meshcat.SetProperty("/Background", "top_color", [0.78, 0.85, 0.93])
    meshcat.SetProperty("/Background", "bottom_color", [0.93, 0.94, 0.95])
    _set_lights(meshcat)
    draw_ground(meshcat, _LIVE_AREA)
    lens = Meshcat.PerspectiveCamera(fov=40.0, aspect=16 / 9, near=0.05, far=100.0)
    meshcat.SetCamera(lens)
    meshcat.SetCameraPose(np.array([4.5, -8.5, 4.5]), np.array([5.0, 1.0, 0.0]))
    return meshcat


def _start(port: int | None) -> Meshcat:
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # the caller prints the address where a visitor needs it
    try:
        meshcat = Meshcat(MeshcatParams(host=HOST, port=port))
    except RuntimeError as error:
        place = f"no free port on {HOST}"
        if port is not None:
            place = f"port {port} of {HOST} is in use"
        raise UserError(
            f"Meshcat: {place}; choose another --port ({PORTS[0]} to {PORTS[1]})"
        ) from error
    finally:
        log.setLevel(level)
    _keep_for_ever(meshcat)
    return meshcat


def _keep_for_ever(meshcat: Meshcat) -> None:
    """Holds one reference too many, so that nothing destroys the viewer before the process is gone.

    Drake aborts the process when a thread other than its maker's destroys a viewer. The garbage
    collector runs in whatever thread it is due; the interpreter, when it ends, clears modules in
    the main thread, and a Dask worker has made its replays in another one.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(meshcat))


def _set_lights(meshcat: Meshcat) -> None:
    """Sets one sun from above with soft light all around, so that the floor is even and the car
    throws a shadow.
    """
    for lamp in ("SpotLight", "PointLightNegativeX", "PointLightPositiveX"):
        meshcat.SetProperty(f"/Lights/{lamp}", "visible", False)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.6)
    sun = "/Lights/FillLight/<object>"
    meshcat.SetProperty(sun, "position", [2.0, -3.0, 9.0])
    meshcat.SetProperty(sun, "intensity", 2.2)
    for side in ("width", "height"):
        meshcat.SetProperty(sun, f"shadow.mapSize.{side}", 4096.0)
    meshcat.SetProperty(sun, "shadow.bias", _SHADOW_BIAS)
    meshcat.SetProperty(sun, "castShadow", True)


def area_around(points: FloatArray, margin: float = 3.0) -> Area:
    """Finds the smallest floor of whole metres (x from, x to, y from, y to) that leaves a margin
    (m) about points (n, 3).
    """
    on_floor = points[:, :2]
    x0, y0 = np.floor(np.min(on_floor, axis=0) - margin).tolist()
    x1, y1 = np.ceil(np.max(on_floor, axis=0) + margin).tolist()
    return x0, x1, y0, y1


def draw_ground(meshcat: Meshcat, area: Area, height: float = 0.0) -> None:
    """Draws the floor with a line every metre and a lighter one every quarter of a metre.

    Args:
        meshcat: Meshcat that shows the floor.
        area: extent of the floor: x from, x to, y from, y to, whole metres.
        height: height of the floor, m.
    """
    x0, x1, y0, y1 = area
    meshcat.SetTransform(GROUND, RigidTransform(np.array([0.0, 0.0, height])))
    meshcat.SetObject(f"{GROUND}/floor", Box(x1 - x0, y1 - y0, 0.01), _FLOOR)
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2, -0.012])
    meshcat.SetTransform(f"{GROUND}/floor", RigidTransform(middle))
    meshcat.SetLineSegments(f"{GROUND}/fine", *_grid_lines(area, _FINE_STEP, -0.004), 1.0, _FINE)
    meshcat.SetLineSegments(f"{GROUND}/metre", *_grid_lines(area, 1.0, -0.001), 1.0, _METRE)


def _grid_lines(area: Area, step: float, height: float) -> ArrayPair:
    """Gives the ends of the lines of a grid, each of shape (3, n), metre by metre: some browsers
    drop lines that pass the eye.
    """
    x0, x1, y0, y1 = area
    across_x = x0 + step * np.arange(round((x1 - x0) / step) + 1)
    across_y = y0 + step * np.arange(round((y1 - y0) / step) + 1)
    along_y = np.array(list(product(across_x, np.arange(y0, y1), [height])))
    along_x = np.array(list(product(across_y, np.arange(x0, x1), [height])))[:, [1, 0, 2]]
    x, y, _ = np.eye(3)
    return np.vstack([along_y, along_x]).T, np.vstack([along_y + y, along_x + x]).T


class ChaseCamera:
    """Looks at a car from behind: the world moves and turns under a camera that stands still.

    Args:
        station: simulated station of the car.
        meshcat: Meshcat that shows the car; None shows nothing.
    """

    def __init__(self, station: Diagram, meshcat: Meshcat | None) -> None:
        self._plant = simulated_car(station).plant
        self._meshcat = meshcat
        self._chassis = self._plant.GetBodyByName("chassis")
        if meshcat is not None:
            draw_ground(meshcat, _AREA)
            meshcat.SetCameraPose(np.array([-2.6, 0.0, 1.5]), np.array([0.8, 0.0, 0.2]))

    def follow(self, context: Context) -> Pair:
        """Turns the view after the car in a context of the whole diagram.

        Returns:
            The car's speed over ground, m/s, and its heading, rad, positive to the left of the x
            axis of the world.
        """
        plant_context = self._plant.GetMyContextFromRoot(context)
        X_WB = self._plant.EvalBodyPoseInWorld(plant_context, self._chassis)
        velocity = self._plant.EvalBodySpatialVelocityInWorld(
            plant_context, self._chassis
        ).translational()
        ahead = X_WB.rotation().matrix()[:, 0]
        heading = math.atan2(ahead[1], ahead[0])
        if self._meshcat is not None:
            place = np.array([*X_WB.translation()[:2], 0.0])
            turned = RigidTransform(RotationMatrix.MakeZRotation(-heading), np.zeros(3))
            self._meshcat.SetTransform(WORLD, turned @ RigidTransform(-place))
            # The ground moves by whole metres: its lines stay in place.
            self._meshcat.SetTransform(GROUND, RigidTransform(np.round(place)))
        return float(np.hypot(velocity[0], velocity[1])), heading
