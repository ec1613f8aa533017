"""What Meshcat shows of a simulation beside the shapes: a camera that stays with the robot, and the air as arrows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.replay.force_arrows import AIR_COLOUR, SHOWN_LENGTH, DrawnArrow, point_on_axis
from aerodima.workbench.replay.viewer import WORLD, area_around, draw_ground
from aerodima.workbench.systems.port_values import vector_of

PICTURES_PER_SECOND = 32.0
"""That of Drake's own visualizer."""
_FLOOR_MARGIN = 10.0
"""Floor about the place of the start, m."""
_LEAST_SIZE = 0.15


class LiveScene(LeafSystem):
    """Moves the world under the camera as the robot moves, and the arrows of the air.

    Input ports:
        com (6): position, m, and velocity of the centre of mass in W.
        poses (7 n): of the bodies that are drawn, see `PlantTruth`.
        <name of a tail force>_air (12): force N, moment about Wo N m, root and tip m of its sections, W axes.

    Args:
        meshcat: that shows the robot.
        tails: names of the tail forces.
        reach: largest distance of a shape from the origin of its body, m, one per body of `poses`.
        air_scale: length of an arrow, m per N.
    """

    def __init__(self, meshcat: Meshcat, tails: Sequence[str], reach: Sequence[float], air_scale: float) -> None:
        super().__init__()
        self._meshcat, self._reach, self._air_scale = meshcat, np.asarray(reach), air_scale
        self._com = self.DeclareVectorInputPort("com", 6)
        self._poses = self.DeclareVectorInputPort("poses", 7 * len(reach)) if len(reach) else None
        self._tails = [
            (DrawnArrow.make(meshcat, f"air_on_{name}", AIR_COLOUR), self.DeclareVectorInputPort(f"{name}_air", 12))
            for name in tails
        ]
        self._placed = False
        self.DeclareInitializationPublishEvent(self._start)
        self.DeclarePeriodicPublishEvent(1.0 / PICTURES_PER_SECOND, 0.0, self._show)

    def _start(self, context: Context) -> EventStatus:
        self._placed = False
        return self._show(context)

    def _show(self, context: Context) -> EventStatus:
        com = vector_of(self._com, context)[:3]
        if not self._placed:
            self._place(context, com)
        self._meshcat.SetTransform(WORLD, RigidTransform(-com * [1.0, 1.0, 0.0]))
        for arrow, port in self._tails:
            self._draw(arrow, vector_of(port, context))
        return EventStatus.Succeeded()

    def _place(self, context: Context, com: FloatArray) -> None:
        """Puts the camera where all of the robot is seen, and a floor below it unless it hangs below z = 0."""
        size = _LEAST_SIZE
        if self._poses is not None:
            places = vector_of(self._poses, context).reshape(-1, 7)[:, 4:]
            size = max(size, float(np.max(np.linalg.norm(places - com, axis=1) + self._reach)))
        target = np.array([0.0, 0.0, com[2]])
        self._meshcat.SetCameraPose(target + size * np.array([1.4, -2.9, 0.9]), target)
        if com[2] >= 0.0:
            draw_ground(self._meshcat, area_around(com[None, :], _FLOOR_MARGIN))
        self._placed = True

    def _draw(self, arrow: DrawnArrow, air: FloatArray) -> None:
        force, moment, root, tip = (part[None, :] for part in np.split(air, 4))
        length = self._air_scale * force[0]
        shown = bool(np.linalg.norm(length) > SHOWN_LENGTH)
        self._meshcat.SetProperty(arrow.path, "visible", shown)
        if shown:
            poses, shaft = arrow.placed(point_on_axis(force, moment, root, tip)[0], length)
            for path, X_PA in poses.items():
                self._meshcat.SetTransform(path, X_PA)
            self._meshcat.SetProperty(f"{arrow.path}/shaft", "scale", [1.0, 1.0, shaft])


def reach_of(scene: Sequence[Mapping[str, object]], body: str) -> float:
    """An upper bound of the distance of a body's shapes from its origin, m; `scene` as in a log."""
    reach = 0.0
    for entry in scene:
        if entry["body"] == body:
            place = np.asarray(entry["pose"], dtype=float)[4:]
            reach = max(reach, float(np.linalg.norm(place)) + float(np.max(np.abs(np.asarray(entry["size"])))))
    return reach
