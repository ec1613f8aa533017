"""Motion of a body as the sensors of the chassis read it, from that of a plant."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.systems.framework import LeafSystem

LISTS = {
    "body_poses": Value[list[RigidTransform]](),
    "body_spatial_velocities": Value[list[SpatialVelocity]](),
    "body_spatial_accelerations": Value[list[SpatialAcceleration]](),
}


def motion_vector(
    X_WB: RigidTransform, V_WB: SpatialVelocity, A_WB: SpatialAcceleration, step: float
) -> np.ndarray:
    """A vector of `CHASSIS_MOTION_SIZE` for a plant of this step, s."""
    before = V_WB.get_coeffs() - step * A_WB.get_coeffs()
    return np.array(
        [
            *X_WB.rotation().ToQuaternion().wxyz(),
            *X_WB.translation(),
            *V_WB.get_coeffs(),
            *before,
            1.0,
        ]
    )


class BodyMotion(LeafSystem):
    """That of one body of a plant."""

    def __init__(self, plant, body):
        super().__init__()
        ports = [self.DeclareAbstractInputPort(name, value) for name, value in LISTS.items()]

        def calc(context, output):
            motion = (port.Eval(context)[int(body.index())] for port in ports)
            output.SetFromVector(motion_vector(*motion, plant.time_step()))

        self.DeclareVectorOutputPort("motion", 20, calc)


def add_sensor(builder, sensor, plant, body):
    """Adds a sensor and what it reads of a body of a plant."""
    motion = builder.AddSystem(BodyMotion(plant, body))
    for name in LISTS:
        builder.Connect(plant.GetOutputPort(name), motion.GetInputPort(name))
    builder.AddSystem(sensor)
    builder.Connect(motion.get_output_port(), sensor.get_input_port())
    return sensor
