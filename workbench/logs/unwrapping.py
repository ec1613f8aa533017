"""Columns of a run log in which a jump of a whole turn is taken out while it is written. No Drake."""

from collections.abc import Sequence

import numpy as np

UNWRAPPED = ("yaw_truth_rad", "imu_yaw_rad")
"""Headings, so that they can be subtracted."""


class RowUnwrapper:
    """Unwraps the headings of rows that come one after the other."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._angles = [columns.index(name) for name in UNWRAPPED if name in columns]
        self._before: list[float] | None = None

    def apply(self, row: np.ndarray) -> np.ndarray:
        """Changes the headings of a row (columns,) in place and returns it."""
        if self._before is not None:
            for index, earlier in zip(self._angles, self._before, strict=True):
                row[index] += 2 * np.pi * round((earlier - row[index]) / (2 * np.pi))
        self._before = [row[index] for index in self._angles]
        return row
