"""Monitor of attitude against gyro of the IMU: either may fail while the other one lives."""

import math

import numpy as np

from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.motor_monitors import Debounce

_MEMORY = 1.0
"""Time after which a difference is forgotten, s: an offset of the gyro of 0.01 rad/s, of which the
attitude is free, leaves 0.01 rad."""
_MAX_ERROR = 0.35
"""Largest difference between turned and reported attitude, rad: 20 degrees, a third of the way to
the limit of the attitude; a chip whose attitude lags its gyro by 20 ms leaves half of it at
8 rad/s."""
_MAX_TIME = 0.25
"""Longest time beyond that difference, s. An attitude that jumps onto the side stops the car by
itself before."""
_MAX_GAP = 0.1
"""Longest span between two samples over which a rate is integrated, s."""
_AXES = ([2, 0, 1], [1, 2, 0])
"""Places of x, y and z in a skew matrix."""


class AttitudeMonitor:
    """Integral of the difference between the change of the attitude and the gyro, in chip axes.

    Attributes:
        fault_text: message that attitude and gyro differ; empty while they agree.
    """

    def __init__(self) -> None:
        self._time = -math.inf
        self._rotation = np.eye(3)
        self._error = np.zeros(3)
        self._beyond = Debounce()
        self.fault_text = ""

    def update(self, time: float, sample: Bno055Sample) -> None:
        """Takes a sample and its time, s."""
        span = time - self._time
        turn = self._rotation.T @ sample.rotation
        self._time = time
        self._rotation = sample.rotation
        if span > _MAX_GAP:
            return
        change = 0.5 * (turn - turn.T)[_AXES] - span * np.array(sample.gyro)
        self._error = (1.0 - span / _MEMORY) * self._error + change
        error = math.hypot(*self._error.tolist())
        self.fault_text = ""
        if self._beyond.update(error > _MAX_ERROR, time) >= _MAX_TIME:
            self.fault_text = (
                f"attitude and gyro of the IMU differ by {math.degrees(error):.0f} degrees"
            )
