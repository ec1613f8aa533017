"""Ground speed from the GPS receiver."""

import math
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from aerodima.workbench.sensors.chassis_motion import CHASSIS_MOTION_SIZE, horizontal_velocity
from aerodima.workbench.sensors.sampled import SampledSensor
from aerodima.workbench.systems.noise import CounterNoise


class GpsSpeed(SampledSensor):
    """Horizontal speed of the body origin, as a GPS receiver reports it: slow, late, noisy, without sign.

    speed = max(0, sqrt(vx^2 + vy^2) + noise): driving backwards reads positive. The lever arm from the body origin
    to the antenna is neglected.

    Input ports:
        body_spatial_velocities: list[SpatialVelocity], W axes, from the plant.
        chassis_motion (20): in its place where `body_index` is None, see `chassis_motion`.
    Output ports:
        speed (1): m/s.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: `scenario.gps`: rate Hz, delay s, noise m/s (standard deviation).
        body_index: of the car body in the plant; None for a vector that has its motion.
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
        body_index: BodyIndex | int | None,
        seed: int,
        step: float | None = None,
        discrete: bool = False,
    ) -> None:
        super().__init__(
            name="gps", outputs={"speed": 1}, rate=settings.rate, delay=settings.delay, step=step, discrete=discrete
        )
        self._body = body_index
        if body_index is None:
            self._motion = self.DeclareVectorInputPort("chassis_motion", CHASSIS_MOTION_SIZE)
        else:
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
        motion: OutputPort | None = None,
    ) -> "GpsSpeed":
        """Adds the receiver on a body of a plant and connects it.

        `motion` gives the body's motion in the plant's place, see `chassis_motion`.
        """
        gps = cls(
            settings,
            body_index=body.index() if motion is None else None,
            seed=seed,
            step=plant.time_step() or None,
            discrete=plant.time_step() > 0.0,
        )
        builder.AddSystem(gps)
        source = motion or plant.GetOutputPort("body_spatial_velocities")
        builder.Connect(source, gps.get_input_port())
        return gps

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (1,): speed in m/s."""
        speed = math.hypot(*self._velocity(context)) + self._deviation * self._noise.at(index)[0]
        return np.array([max(0.0, speed)])

    def _velocity(self, context: Context) -> tuple[float, float]:
        if self._body is None:
            return horizontal_velocity(self._motion.Eval(context))
        velocities: Any = self._velocities.Eval(context)
        velocity = velocities[int(self._body)].translational()
        return velocity[0], velocity[1]
