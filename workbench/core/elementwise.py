"""Functions of single numbers and of arrays alike.

Floats go to `math` and the comparisons of Python, which is ten times as fast; all else goes to
NumPy, whose functions `car/reduced/compiled.py` records.
"""

import math
from typing import Any

import numpy as np


def minimum(a: Any, b: Any) -> Any:
    """Returns the smaller of two numbers, or of each pair in two arrays."""
    if isinstance(a, float) and isinstance(b, float):
        return min(a, b)
    return np.minimum(a, b)


def maximum(a: Any, b: Any) -> Any:
    """Returns the larger of two numbers, or of each pair in two arrays."""
    if isinstance(a, float) and isinstance(b, float):
        return max(a, b)
    return np.maximum(a, b)


def clip(value: Any, lower: Any, upper: Any) -> Any:
    """Returns `value` held inside the bounds; a NaN stays a NaN."""
    if isinstance(value, float) and isinstance(lower, float) and isinstance(upper, float):
        return min(max(value, lower), upper)
    return np.clip(value, lower, upper)


def tanh(value: Any) -> Any:
    """Returns the hyperbolic tangent."""
    if isinstance(value, float):
        return math.tanh(value)
    return np.tanh(value)


def rotation_rows(quaternion: Any) -> tuple[Any, Any, Any]:
    """Returns the rows (3) of the rotation matrix of a quaternion w, x, y, z of any length; each
    entry is an array (n) for a quaternion of arrays (n).
    """
    w, x, y, z = quaternion
    scale = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)),
        (scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x)),
        (scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y)),
    )
