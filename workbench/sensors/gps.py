"""Ground speed from the GPS receiver."""

import math
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, System

from aerodima.workbench.sensors.sampled import SampledSensor
from aerodima.workbench.systems.noise import CounterNoise


class GpsSpeed(SampledSensor):
    """Horizontal speed of the body origin, as a GPS receiver reports it: slow, late, noisy, without sign.

    speed = max(0, sqrt(vx^2 + vy^2) + noise): driving backwards reads positive. The lever arm from the body origin
    to the antenna is neglected.

    Input ports:
        body_spatial_velocities: list[SpatialVelocity], W axes, from the plant.
    Output ports:
        speed (1): m/s.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: `scenario.gps`: rate Hz, delay s, noise m/s (standard deviation).
        body_index: of the car body in the plant.
        seed: of the run.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.

    Raises:
        UserError: rate or delay not allowed.
    """

    def __init__(
        self,
        settings: Any,
        *,
        body_index: BodyIndex | int,
        seed: int,
        step: float | None = None,
        discrete: bool = False,
    ) -> None:
        super().__init__(
            name="gps", outputs={"speed": 1}, rate=settings.rate, delay=settings.delay, step=step, discrete=discrete
        )
        self._body = int(body_index)
        self._velocities = self.DeclareAbstractInputPort("body_spatial_velocities", Value[list[SpatialVelocity]]())
        self._deviation = settings.noise
        self._noise = CounterNoise(seed, "gps", 1)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        settings: Any,
        *,
        plant: MultibodyPlant,
        body: RigidBody,
        seed: int,
        motion: System | None = None,
    ) -> "GpsSpeed":
        """Adds the receiver on a body of a plant and connects it.

        `motion` gives the body's motion in the plant's place, see `ChassisMotion`.
        """
        gps = cls(
            settings,
            body_index=body.index() if motion is None else 0,
            seed=seed,
            step=plant.time_step() or None,
            discrete=plant.time_step() > 0.0,
        )
        builder.AddSystem(gps)
        builder.Connect(
            (motion or plant).GetOutputPort("body_spatial_velocities"), gps.GetInputPort("body_spatial_velocities")
        )
        return gps

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (1,): speed in m/s."""
        velocities: Any = self._velocities.Eval(context)
        velocity = velocities[self._body].translational()
        speed = math.hypot(velocity[0], velocity[1]) + self._deviation * self._noise.at(index)[0]
        return np.array([max(0.0, speed)])
