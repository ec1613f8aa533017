"""Motion of the chassis alone as one vector, for sensors that would otherwise ask the plant for that of every body.

The plant's own lists cost about 25 us each to read, since every body becomes a Python object.
"""

from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.aero.sail_motion import rotation_rows
from aerodima.workbench.config.array_types import FloatArray

CHASSIS_MOTION_SIZE = 20
"""Quaternion w, x, y, z; position, m; angular velocity, rad/s, and velocity, m/s, in W; angular velocity and velocity
before the plant's last step; 0 before the first step of a run, when there is no acceleration yet, then 1."""


class ChassisMotion(NamedTuple):
    """Of a body: R_WB (3, 3); in W angular velocity (3), rad/s, its change (3), rad/s2, and acceleration (3), m/s2."""

    R_WB: FloatArray
    w_WB: FloatArray
    alpha_WB: FloatArray
    a_WB: FloatArray


def chassis_motion(values: Any, step: float) -> ChassisMotion:
    """What a vector of `CHASSIS_MOTION_SIZE` says, for a plant of this step, s."""
    change = values[19] * (values[7:13] - values[13:19]) / step
    return ChassisMotion(np.array(rotation_rows(values[:4].tolist())), values[7:10], change[:3], change[3:])


def horizontal_velocity(values: Any) -> tuple[float, float]:
    """Along x and y of W, m/s."""
    return values[10], values[11]
