"""Do more replies come than frames went out? Then two motors share an id."""

from __future__ import annotations

from collections import deque

MOST_EXTRA = 2
"""Replies too many, in cycles in a row, that may still be chance."""


class ReplyCount:
    """Frames to one motor that are still to be answered, and the replies that answer none of them.

    A computer that is held up sends late and reads late: several replies in one cycle are none too many while as many
    frames are owed. A frame that has no answer after `memory` was lost.

    Args:
        memory: s.

    Attributes:
        extra: replies too many, in cycles in a row.
    """

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._owed: deque[list[float]] = deque()
        self.extra = 0

    def clear(self) -> None:
        """Forgets everything: the motor is switched on anew."""
        self._owed.clear()
        self.extra = 0

    @property
    def too_many(self) -> bool:
        """Whether a second motor answers."""
        return self.extra > MOST_EXTRA

    def add(self, frames: int, replies: int, now: float) -> None:
        """Takes what went out and what came back in a cycle that ends at `now`, s."""
        while self._owed and now - self._owed[0][0] > self._memory:
            self._owed.popleft()
        if frames:
            self._owed.append([now, frames])
        while replies and self._owed:
            paid = min(replies, int(self._owed[0][1]))
            replies -= paid
            self._owed[0][1] -= paid
            if not self._owed[0][1]:
                self._owed.popleft()
        if frames:  # without frames of its own a motor may still be asked by the Teensy, which repeats its last order
            self.extra = self.extra + replies if replies else 0
