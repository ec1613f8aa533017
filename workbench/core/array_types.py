"""Types of arrays that every package uses."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
Vector3 = tuple[float, float, float]
"""Components along three axes."""
