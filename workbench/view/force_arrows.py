"""Forces as arrows: where they act, how long they are, and how Meshcat draws one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.signal_table import WHEELS
from aerodima.workbench.view.viewer import WORLD

Colour = tuple[float, float, float]
"""Red, green and blue from 0 to 1."""
WHEEL_COLOUR = (0.10, 0.55, 0.25)
"""Colour of the force of the ground on a wheel."""
AIR_COLOUR = (0.85, 0.25, 0.10)
"""Colour of the force of the air on a tail."""
WHEEL_SCALE = 0.02
"""Length of the arrow of a wheel, m per N: a wheel at rest carries about 15 N."""
SHOWN_LENGTH = 0.015
"""Length below which an arrow is left out, m."""
SHAFT_RADIUS = 0.007
"""Radius of the shaft of an arrow, m."""
HEAD_RADIUS = 0.018
"""Radius of the head of an arrow, m."""
HEAD_LENGTH = 0.05
"""Length of the head of an arrow, m."""


@dataclass(frozen=True)
class ForceArrow:
    """One force over the run.

    Attributes:
        name: name of the force.
        colour: red, green and blue of the arrow, from 0 to 1.
        points: points in W where the force acts, m, shape (n, 3).
        lengths: vectors of the arrow, force times scale, W axes, m, shape (n, 3).
    """

    name: str
    colour: Colour
    points: FloatArray
    lengths: FloatArray

    @property
    def shown(self) -> BoolArray:
        """Says whether the arrow is long enough to be drawn, shape (n,)."""
        return np.linalg.norm(self.lengths, axis=1) > SHOWN_LENGTH


def wheel_arrows(run_log: RunLog) -> list[ForceArrow]:
    """Makes an arrow per wheel whose contact is in the log, one row per row of the log."""
    arrows = []
    for wheel in WHEELS:
        if f"wheel_contact_{wheel}_x_truth_m" in run_log.table:
            lengths = WHEEL_SCALE * run_log.vector(f"wheel_force_{wheel}", "truth_n")
            points = run_log.vector(f"wheel_contact_{wheel}", "truth_m")
            arrows.append(ForceArrow(f"ground_on_{wheel}", WHEEL_COLOUR, points, lengths))
    return arrows


def air_arrow(
    tail: str,
    scale: float,
    force: FloatArray,
    moment: FloatArray,
    root: FloatArray,
    tip: FloatArray,
) -> ForceArrow:
    """Makes the arrow of the air on a tail, one row per row of the log.

    Args:
        tail: name of the tail.
        scale: length of the arrow, m per N.
        force, moment, root, tip: see `point_on_axis`.
    """
    points = point_on_axis(force, moment, root, tip)
    return ForceArrow(f"air_on_{tail}", AIR_COLOUR, points, scale * force)


def point_on_axis(
    force: FloatArray, moment: FloatArray, root: FloatArray, tip: FloatArray
) -> FloatArray:
    """Finds the point of the tail's axis that is nearest to the line of action of a force.

    The line of action is q + s F with q = F x M / F.F, where M is the moment about the world
    origin. A point r + t u of the axis is nearest to this line where (r + t u - q - s F) is
    perpendicular to both lines. Without a force, or for a force along the axis, the result is the
    middle of the tail; beyond an end it is that end.

    Args:
        force: force F in W, N, shape (n, 3).
        moment: moment M about Wo, W axes, N m, shape (n, 3).
        root: root of the tail in W, m, shape (n, 3).
        tip: tip of the tail in W, m, shape (n, 3).
    """
    axis = tip - root
    square = _dot(force, force)
    safe = np.where(square > 0.0, square, 1.0)
    q = np.cross(force, moment) / safe
    across = axis - force * _dot(force, axis) / safe
    weight = _dot(across, axis)
    usable = (square > 0.0) & (weight > 1e-9 * _dot(axis, axis))
    fraction = _dot(across, q - root) / np.where(usable, weight, 1.0)
    return root + np.where(usable, np.clip(fraction, 0.0, 1.0), 0.5) * axis


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Computes the dot products of the rows of two arrays (n, 3), shape (n, 1)."""
    return np.vecdot(a, b)[:, None]


class DrawnArrow:
    """An arrow in Meshcat: a shaft that is stretched and a head, made once and then moved.

    Attributes:
        path: path of the arrow in Meshcat, in the world that moves under the camera.

    Args:
        meshcat: viewer to which the arrow is added.
        name: name of the force.
        colour: colour of the arrow.
    """

    def __init__(self, meshcat: Meshcat, name: str, colour: Colour) -> None:
        self.path = f"{WORLD}/forces/{name}"
        shaft = Cylinder(SHAFT_RADIUS, 1.0)
        head = MeshcatCone(HEAD_LENGTH, HEAD_RADIUS, HEAD_RADIUS)
        meshcat.SetObject(f"{self.path}/shaft", shaft, Rgba(*colour))
        meshcat.SetObject(f"{self.path}/head", head, Rgba(*colour))

    def move(self, scene: Any, point: FloatArray, length: FloatArray, *frame: int) -> None:
        """Puts the arrow where it belongs.

        Args:
            scene: Meshcat, or an animation.
            point: foot of the arrow in W, m, shape (3,).
            length: vector from foot to tip of the arrow, W axes, m, shape (3,); not zero.
            frame: number of the frame of an animation.
        """
        whole = float(np.linalg.norm(length))
        shaft = max(whole - HEAD_LENGTH, 1e-3)
        middle = np.array([0.0, 0.0, shaft / 2])
        tip = np.array([0.0, 0.0, shaft + HEAD_LENGTH])
        # The cone has its point at the origin and opens along z.
        turned = RotationMatrix.MakeXRotation(np.pi)
        X_WA = RigidTransform(RotationMatrix.MakeFromOneVector(length / whole, 2), point)
        scene.SetTransform(*frame, self.path, X_WA)
        scene.SetTransform(*frame, f"{self.path}/shaft", RigidTransform(middle))
        scene.SetTransform(*frame, f"{self.path}/head", RigidTransform(turned, tip))
        scene.SetProperty(*frame, f"{self.path}/shaft", "scale", [1.0, 1.0, shaft])
