"""When it happened, in the computer's time, from the clock of a microcontroller that only counts milliseconds."""

from __future__ import annotations

from collections import deque

_WRAP = 2**32
_BACKWARDS = 1000
"""A count that falls by more than that is a restart of the microcontroller, ms."""


class ClockAlignment:
    """Offset between a 32-bit millisecond counter and the computer's monotonic clock.

    A message can only arrive late, never early: the smallest of the last offsets is the best one, and the window lets
    it follow a drift of the counter.

    Args:
        window: number of messages over which the smallest offset is taken.

    Attributes:
        restarts: how often the counter began anew.
    """

    def __init__(self, window: int = 500) -> None:
        self._offsets: deque[float] = deque(maxlen=window)
        self._last: int | None = None
        self._turns = 0
        self.restarts = 0

    def add(self, count: int, arrival: float) -> float:
        """Takes a message with its count (ms) and arrival (s); returns when it was sent, s on the computer's clock."""
        if self._last is not None:
            if self._last - count > _WRAP // 2:
                self._turns += 1
            elif self._last - count > _BACKWARDS:
                self.restarts += 1
                self._offsets.clear()
                self._turns = 0
        self._last = count
        seconds = (count + self._turns * _WRAP) / 1000.0
        self._offsets.append(arrival - seconds)
        return seconds + min(self._offsets)
