"""A live view in Meshcat that follows a car from behind."""

import math

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context, Diagram

from aerodima.workbench.replay.viewer import GROUND, WORLD, draw_ground
from aerodima.workbench.stations.car_station import simulated_car

_AREA = (-14.0, 14.0, -14.0, 14.0)
"""Of the floor that is drawn around the car, m."""


class ChaseCamera:
    """Looks at a car from behind: the world moves and turns under a camera that stands still.

    Args:
        station: simulated, of the car.
        meshcat: shows the car; None: nothing is shown.
    """

    def __init__(self, station: Diagram, meshcat: Meshcat | None) -> None:
        self._plant, self._meshcat = simulated_car(station).plant, meshcat
        self._chassis = self._plant.GetBodyByName("chassis")
        if meshcat is not None:
            draw_ground(meshcat, _AREA)
            meshcat.SetCameraPose(np.array([-2.6, 0.0, 1.5]), np.array([0.8, 0.0, 0.2]))

    def follow(self, context: Context) -> tuple[float, float]:
        """Turns the view after the car in a context of the whole diagram.

        Returns:
            Its speed over ground, m/s, and its heading, rad, positive to the left of the x axis of the world.
        """
        plant_context = self._plant.GetMyContextFromRoot(context)
        X_WB = self._plant.EvalBodyPoseInWorld(plant_context, self._chassis)
        velocity = self._plant.EvalBodySpatialVelocityInWorld(plant_context, self._chassis).translational()
        ahead = X_WB.rotation().matrix()[:, 0]
        heading = math.atan2(ahead[1], ahead[0])
        if self._meshcat is not None:
            place = np.array([*X_WB.translation()[:2], 0.0])
            turned = RigidTransform(RotationMatrix.MakeZRotation(-heading), np.zeros(3))
            self._meshcat.SetTransform(WORLD, turned @ RigidTransform(-place))
            self._meshcat.SetTransform(GROUND, RigidTransform(np.round(place)))  # whole metres: its lines stay in place
        return float(np.hypot(velocity[0], velocity[1])), heading
