"""Frames that wait for the sending thread: urgent ones first, of the others only the newest per id."""

from __future__ import annotations

import threading
import time
from collections import deque

from aerodima.hardware.protocol.can_frame import CanFrame

_STALE_AFTER = 0.05
"""A command that has waited that long is not sent any more, s: five cycles of the loop."""
_MOST_URGENT = 256


class Outbox:
    """Thread-safe store between the loop and the sending thread.

    A blocked adapter must not let old commands through when it comes back, and must let exit frames through first.

    Attributes:
        superseded: frames that were dropped, being old or replaced.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._urgent: deque[CanFrame] = deque(maxlen=_MOST_URGENT)
        self._waiting: dict[tuple[int, bool], tuple[float, CanFrame]] = {}
        self._in_hand: tuple[float, CanFrame] | None = None
        self._taken = 0.0
        self._in_hand_is_urgent = False
        self._closed = False
        self.superseded = 0

    def put(self, frame: CanFrame, urgent: bool) -> None:
        """Adds a frame; see `CanBus.send`."""
        key = (frame.arbitration_id, frame.extended)
        with self._condition:
            replaced = self._waiting.pop(key, None)
            self.superseded += replaced is not None
            if urgent:
                self._urgent.append(frame)
            else:
                self._waiting[key] = (time.monotonic(), frame)
            self._condition.notify_all()

    def next(self) -> CanFrame | None:
        """Waits for the next frame to send; None once the box is closed and empty of urgent ones."""
        with self._condition:
            while True:
                if self._urgent:
                    self._taken = time.monotonic()
                    self._in_hand, self._in_hand_is_urgent = (self._taken, self._urgent.popleft()), True
                    return self._in_hand[1]
                if self._closed:
                    return None
                while self._waiting:
                    key = next(iter(self._waiting))
                    since, frame = self._waiting.pop(key)
                    self._taken = time.monotonic()
                    if self._taken - since > _STALE_AFTER:
                        self.superseded += 1
                        continue
                    self._in_hand, self._in_hand_is_urgent = (since, frame), False
                    return frame
                self._in_hand = None
                self._condition.notify_all()
                self._condition.wait()

    def done(self) -> None:
        """The frame in hand was sent."""
        with self._condition:
            self._in_hand = None
            if not self._urgent and not self._waiting:
                self._condition.notify_all()

    def put_back(self, frame: CanFrame, may_have_left: bool = False) -> None:
        """The frame in hand could not be sent: it goes first again, unless a newer one or an exit came, or it is old.

        A command that may have left all the same is not sent twice, for the motor would answer twice.

        After `close` nothing comes back, so that a lost adapter cannot keep the thread alive.
        """
        with self._condition:
            since = self._in_hand[0] if self._in_hand else 0.0
            self._in_hand = None
            if self._closed:
                self._urgent.clear()
                return
            key = (frame.arbitration_id, frame.extended)
            if self._in_hand_is_urgent:
                self._urgent.appendleft(frame)
            elif (
                may_have_left
                or key in self._waiting
                or any((item.arbitration_id, item.extended) == key for item in self._urgent)
            ):
                self.superseded += 1
            else:
                self._waiting = {key: (since, frame), **self._waiting}

    def age_in_hand(self) -> float:
        """How long the sending thread holds its frame, s; 0 when it holds none."""
        with self._condition:
            return 0.0 if self._in_hand is None else time.monotonic() - self._taken

    def wait_empty(self, timeout: float) -> bool:
        """Waits until nothing waits and nothing is in hand, at most `timeout` s. Whether it came to that."""
        with self._condition:
            return self._condition.wait_for(
                lambda: not self._urgent and not self._waiting and self._in_hand is None, timeout
            )

    def close(self) -> None:
        """No more frames; `next` returns None."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
