"""I2t of a motor's winding: how much torque it may still make. The same numbers as `motor_guard.cpp` of the firmware.

The winding warms with the square of its current, so with the square of the torque. Above the rated torque a budget of
(N m)^2 s is used up, below it the budget comes back; over its last fifth the torque is taken back to the rated one.
"""

from __future__ import annotations

FADE = 0.2
"""Share of the budget over which the torque is taken back."""


class MotorLoad:
    """Load of one motor.

    Args:
        rated: torque that it bears for ever, N m.
        budget: (N m)^2 s above that.

    Attributes:
        used: (N m)^2 s, at least 0.
    """

    def __init__(self, rated: float, budget: float) -> None:
        self._rated, self._budget = rated, budget
        self._time: float | None = None
        self.used = 0.0

    def add(self, torque: float, now: float) -> None:
        """Takes a measured torque (N m) at `now`, s."""
        span = 0.0 if self._time is None else max(0.0, now - self._time)
        self.used = max(0.0, self.used + (torque * torque - self._rated * self._rated) * span)
        self._time = now

    @property
    def share(self) -> float:
        """Of the budget that is used; beyond 1 the motor does not obey."""
        return self.used / self._budget

    def allowed(self, peak: float) -> float:
        """Torque that it may make now (N m), of at most `peak`."""
        rated = min(self._rated, peak)
        return rated + min(1.0, max(0.0, (1.0 - self.share) / FADE)) * (peak - rated)
