"""What the car may do while it drives: how much throttle and how fast it comes on, which speed, which attitude.

The firmware of the Teensy keeps the same limits of throttle and attitude, for a computer that does not.
"""

from __future__ import annotations

import math

from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_limits import Lasting
from aerodima.workbench.config.signal_table import IMU, STATUS

_ROLL, _PITCH = IMU.index("roll"), IMU.index("pitch")
_SPEED = STATUS.index("speed_fault")

_MOST_SPAN = 0.02
"""s; a loop that stood still does not catch up with a step of the throttle."""


class DriveLimits:
    """Limits of one car. Times in s, monotonic."""

    def __init__(self, safety: DriveSafety) -> None:
        self._safety = safety
        self._tilted, self._fast = Lasting(), Lasting()
        self._throttle, self._time = 0.0, -math.inf

    def rest(self) -> None:
        """The throttle is neutral."""
        self._throttle, self._time = 0.0, -math.inf

    def throttle(self, asked: float, now: float) -> float:
        """What is let through of a finite throttle: clipped, coming on at the limited rate, going back at once."""
        safety = self._safety
        side = math.copysign(1.0, asked)
        span = min(max(0.0, now - self._time), _MOST_SPAN) if math.isfinite(self._time) else 0.0
        most = safety.throttle_rate * span
        begun = max(0.0, side * self._throttle)
        self._throttle = side * min(abs(asked), safety.throttle_limit, max(begun + most, safety.throttle_start))
        self._time = now
        return self._throttle

    def tilt(self, reading: CarReading, now: float) -> str:
        """Why the car must stop at once since it lies on its side or its end; empty while it does not."""
        roll, pitch = float(reading.imu[_ROLL]), float(reading.imu[_PITCH])
        limit = self._safety.attitude_limit
        lasted = self._tilted.look(max(abs(roll), abs(pitch)) > limit, now)
        if lasted == 0.0 or lasted < self._safety.attitude_time:
            return ""
        name, angle = ("roll", roll) if abs(roll) >= abs(pitch) else ("pitch", pitch)
        return (
            f"the car has tipped over: {name} {math.degrees(angle):.0f} degrees; allowed is {math.degrees(limit):.0f}"
        )

    def too_fast(self, reading: CarReading, now: float) -> str:
        """Why the car must slow down; empty while it need not, or while its speed is not known."""
        speed, limit = float(reading.speed[0]), self._safety.speed_limit
        known = reading.status[_SPEED] == SourceFault.NONE
        if self._fast.look(known and speed > limit, now) < self._safety.speed_time or not known or speed <= limit:
            return ""
        return f"the car drives {speed:.1f} m/s; allowed is {limit:g}"
