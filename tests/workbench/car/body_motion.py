"""Motion of a body as the sensors of the chassis read it, from that of a plant."""

import numpy as np


def motion_vector(X_WB, V_WB, A_WB, step):
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
