"""Types of arrays and collections that every package uses."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
Vector3 = tuple[float, float, float]
"""Components along three axes."""
ArrayPair = tuple[FloatArray, FloatArray]
"""Two arrays that belong together."""
Pair = tuple[float, float]
"""Two numbers that belong together, such as the ends of a range."""
Values = Mapping[str, float]
"""Numbers by their names."""
Texts = tuple[str, ...]
"""Texts in their order, such as names or warnings."""
NamedArrays = dict[str, FloatArray]
"""Arrays by their names."""
