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
