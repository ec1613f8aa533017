"""Limits of a car that drives: its throttle, its speed, how it stands, and whether it moves."""

import math
from collections import defaultdict

from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_monitors import Debounce
from aerodima.workbench.scenario.signal_table import IMU

_MAX_SPAN = 0.02
"""Longest span for which the throttle rises in one cycle, s: it does not jump after a pause of the
loop."""


class DriveLimits:
    """Limits of one car. Times in s, monotonic."""

    def __init__(self, safety: DriveSafety) -> None:
        self._safety = safety
        self._conditions: defaultdict[str, Debounce] = defaultdict(Debounce)
        self._throttle = 0.0
        self._opened = False
        self._time = math.inf

    def throttle(self, asked: float, now: float) -> float:
        """Returns the permitted part of a finite throttle: it is clipped, rises at a limited rate
        and falls at once.
        """
        safety = self._safety
        side = math.copysign(1.0, asked)
        rise = safety.throttle_rate * min(max(0.0, now - self._time), _MAX_SPAN)
        present = max(0.0, side * self._throttle)
        self._throttle = side * min(
            abs(asked), safety.throttle_limit, max(present + rise, safety.throttle_start)
        )
        self._time = now
        self._opened = self._opened or bool(self._throttle)
        return self._throttle

    def tilt(self, reading: CarReading, now: float) -> str:
        """Returns the reason to stop at once because the car has tipped over, by its attitude or by
        its accelerometer; empty while it stands.
        """
        imu = IMU.read(reading.imu)
        limit = self._safety.attitude_limit
        angles = {"roll": imu.roll, "pitch": imu.pitch, "lean by the accelerometer": reading.lean}
        # Each by itself: an angle that is NaN must not hide the others.
        tilted = {name: angle for name, angle in angles.items() if abs(angle) > limit}
        if not self._lasts("tilted", bool(tilted), self._safety.attitude_time, now):
            return ""
        name, angle = max(tilted.items(), key=lambda item: abs(item[1]))
        return (
            f"the car has tipped over: {name} {math.degrees(angle):.0f} degrees; allowed is "
            f"{math.degrees(limit):.0f}"
        )

    def straight(self, reading: CarReading, steering: float, now: float) -> str:
        """Returns the reason to stop at once because the car does not turn at full steering (rad);
        empty while it does, or need not.
        """
        safety = self._safety
        straight = (
            abs(steering) >= safety.full_steering
            and abs(self._throttle) >= safety.driving_throttle
            and abs(IMU.read(reading.imu).gyro_z) < safety.least_yaw_rate
        )
        if not self._lasts("straight", straight, safety.straight_time, now):
            return ""
        return "the car does not turn at full steering: it has fallen, or is held"

    def speed(self, reading: CarReading, now: float) -> str:
        """Returns the reason to stop because the car is too fast, or its GPS has lost the fix, so
        that nothing limits the speed; empty otherwise, or where no GPS is fitted.
        """
        speed = float(reading.speed[0])
        limit = self._safety.speed_limit
        fault = reading.named_status.speed_fault
        fast = fault == SourceFault.NONE and speed > limit
        if self._lasts("fast", fast, self._safety.speed_time, now):
            return f"the car drives {speed:.1f} m/s; allowed is {limit:g}"
        lost = fault == SourceFault.NO_FIX
        if self._lasts("blind", lost, self._safety.gps_silence, now):
            return "the GPS has lost its fix: nothing limits the speed"
        return ""

    def moves(self, reading: CarReading, now: float) -> bool:
        """Returns whether the car may move: it is not slow, or its throttle was opened and its
        speed is unknown.
        """
        unknown = bool(reading.named_status.speed_fault)
        fast = unknown or bool(reading.speed[0] >= self._safety.rest_speed)
        if self._lasts("slow", not fast, self._safety.speed_time, now):
            return False
        return self._opened or not unknown

    def _lasts(self, name: str, holds: bool, time: float, now: float) -> bool:
        """Returns whether a condition holds and has held for a time, s."""
        return self._conditions[name].update(holds, now) >= time and holds
