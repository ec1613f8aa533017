"""Functions of single numbers and of arrays alike.

Floats go to `math` and the comparisons of Python, which are ten times as fast as NumPy; comparisons
are three times as fast as `min` and `max`. All else goes to NumPy, whose functions
`car/reduced/compiled` records.
"""

import math
from typing import Any

import numpy as np


def minimum(a: Any, b: Any) -> Any:
    """Returns the smaller of two numbers, or of each pair in two arrays."""
    if isinstance(a, float) and isinstance(b, float):
        return b if b < a else a
    return np.minimum(a, b)


def maximum(a: Any, b: Any) -> Any:
    """Returns the larger of two numbers, or of each pair in two arrays."""
    if isinstance(a, float) and isinstance(b, float):
        return b if b > a else a
    return np.maximum(a, b)


def clip(value: Any, lower: Any, upper: Any) -> Any:
    """Returns `value` held inside the bounds; a NaN stays a NaN."""
    if isinstance(value, float) and isinstance(lower, float) and isinstance(upper, float):
        raised = lower if lower > value else value
        return upper if upper < raised else raised
    return np.clip(value, lower, upper)


def tanh(value: Any) -> Any:
    """Returns the hyperbolic tangent."""
    if isinstance(value, float):
        return math.tanh(value)
    return np.tanh(value)


def where(condition: Any, chosen: Any, other: Any) -> Any:
    """Returns `chosen` where the condition holds, else `other`."""
    if isinstance(condition, (bool, np.bool_)):
        return chosen if condition else other
    return np.where(condition, chosen, other)


def rotation_rows(quaternion: Any) -> tuple[Any, Any, Any]:
    """Returns the rows (3) of the rotation matrix of a quaternion w, x, y, z of any length; for
    arrays (n) each entry is an array (n).
    """
    w, x, y, z = quaternion
    xx = x * x
    yy = y * y
    zz = z * z
    xy = x * y
    xz = x * z
    yz = y * z
    wx = w * x
    wy = w * y
    wz = w * z
    scale = 2.0 / (w * w + xx + yy + zz)
    first = (1.0 - scale * (yy + zz), scale * (xy - wz), scale * (xz + wy))
    second = (scale * (xy + wz), 1.0 - scale * (xx + zz), scale * (yz - wx))
    third = (scale * (xz - wy), scale * (yz + wx), 1.0 - scale * (xx + yy))
    return first, second, third


def roll_pitch_yaw(rows: Any) -> tuple[Any, Any, Any]:
    """Computes roll, pitch and yaw, rad, from the rows of a rotation matrix Rz(yaw) Ry(pitch)
    Rx(roll); pitch is within a quarter turn.
    """
    up = rows[2]
    pitch = np.arcsin(clip(-up[0], -1.0, 1.0))
    return np.arctan2(up[1], up[2]), pitch, np.arctan2(rows[1][0], rows[0][0])
