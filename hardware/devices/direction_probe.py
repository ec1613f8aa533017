"""Direction in which a joint goes under a little torque, found before its motor gets a position to
hold.

A joint that rests is held by friction, by a stop or by the balance of its weight, so torque can
move it only its own way. Feedback with the wrong sign, or a motor that turns the other way, shows
at the first hundredth of a radian; a position to hold would make the motor swing with all its
torque. A joint that is mounted the other way round, motor and encoder together, looks right from
here: only somebody who sees the tail can tell (`aerodima drive motor-test`).
"""

import math

from aerodima.hardware.devices.motor_settings import MotorSettings

_MIN_MOVE = 0.015
"""Least movement that shows a direction, rad: 40 steps of the reply's position, and less than a
degree."""
_RATE = 4.0
"""Rate at which the torque rises, N m/s."""
_REST_SPEED = 0.1
"""Speed below which a joint rests, rad/s; a free joint creeps on its friction."""
_REST_REPLIES = 3
"""Number of replies in a row that show a joint at rest."""
_LAST_TRY = 0.1
"""Time at the largest torque, s."""


class DirectionProbe:
    """Probe of one motor, from rest: torque towards the middle of the range, then away from it
    where that is allowed.

    Attributes:
        fault: reason why the motor must not be used; empty while there is none.
        torque: torque that is commanded now, N m.
        passed: whether the joint went the way it was pushed.
    """

    def __init__(self, settings: MotorSettings, now: float) -> None:
        self._settings = settings
        self._began = now
        self._resting = 0
        self._from: tuple[float, float, float] | None = None
        self._direction = 0.0
        self._start = 0.0
        self.torque = 0.0
        self.passed = False
        self.fault = ""

    def step(self, position: float, speed: float, now: float) -> None:
        """Takes the newest reading (rad, rad/s) at `now` (s, monotonic) and sets `torque`, `passed`
        or `fault`.
        """
        if self._from is None:
            self._wait_for_rest(position, speed, now)
            return
        since, begun, drift = self._from
        moved = position - begun - drift * (now - since)
        if abs(moved) >= _MIN_MOVE:
            self.passed = moved * self._direction > 0.0
            if not self.passed:
                self.fault = (
                    f"goes {moved:+.3f} rad under {self.torque:+.2f} N m: its direction, or that "
                    "of its feedback, is "
                    "reversed"
                )
            self.torque = 0.0
            return
        max_torque = self._settings.safety.probe_torque
        torque = _RATE * (now - since)
        self.torque = self._direction * min(torque, max_torque)
        if torque > max_torque + _RATE * _LAST_TRY:
            self._reverse(position, now)

    @property
    def _inwards(self) -> float:
        return -math.copysign(1.0, self._start - 0.5 * (self._settings.low + self._settings.high))

    def _wait_for_rest(self, position: float, speed: float, now: float) -> None:
        if abs(speed) < _REST_SPEED:
            self._resting += 1
        else:
            self._resting = 0
        self._start = position
        if self._resting >= _REST_REPLIES:
            self._direction = self._inwards
            self._from = (now, position, speed)
        elif now - self._began > self._settings.safety.enter_timeout:
            self.fault = (
                f"turns at {speed:.2f} rad/s while it is to be switched on; let the tail rest"
            )

    def _reverse(self, position: float, now: float) -> None:
        settings = self._settings
        if self._direction == self._inwards and settings.low < position < settings.high:
            self._direction = -self._direction
            self._from = (now, position, 0.0)
            return
        self.torque = 0.0
        self.fault = (
            f"does not move under {settings.safety.probe_torque:g} N m: something holds the tail, "
            "it is heavier, or "
            "its direction is reversed"
        )
