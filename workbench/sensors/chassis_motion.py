"""Motion of the chassis alone as one vector, for sensors that would otherwise ask the plant for that of every body.

The plant's own lists cost about 25 us each to read, since every body becomes a Python object.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from aerodima.workbench.aero.sail_motion import rotation_rows

CHASSIS_MOTION_SIZE = 20
"""Quaternion w, x, y, z; position, m; angular velocity, rad/s, and velocity, m/s, in W; angular velocity and velocity
before the plant's last step; 0 before the first step of a run, when there is no acceleration yet, then 1."""


class ChassisMotion(NamedTuple):
    """Of a body: rows of R_WB (3, 3); in W angular velocity, rad/s, its change, rad/s2, and acceleration, m/s2 (3)."""

    R_WB: Sequence[Sequence[float]]
    w_WB: Sequence[float]
    alpha_WB: Sequence[float]
    a_WB: Sequence[float]


def chassis_motion(values: Any, step: float) -> ChassisMotion:
    """What a vector of `CHASSIS_MOTION_SIZE` says, for a plant of this step, s."""
    x = values.tolist()
    change = [x[19] * (x[7 + k] - x[13 + k]) / step for k in range(6)]
    return ChassisMotion(rotation_rows(x[:4]), x[7:10], change[:3], change[3:])


def horizontal_velocity(values: Any) -> tuple[float, float]:
    """Along x and y of W, m/s."""
    return values[10], values[11]
