"""Motion of a body as the sensors of the chassis read it, from that of a plant."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity


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
