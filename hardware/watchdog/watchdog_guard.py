"""When the watchdog acts: one byte per message from the drive process, and a clock. No ports, no threads.

```
waiting -- armed --> guarding -- disarmed --> waiting
   |                    |
   +-- the pipe ends ---+-- no heartbeat, or asked to --> acting, for good
```
The end of the pipe without `QUIT` is the death of the drive process, whatever killed it.
"""

from __future__ import annotations

from enum import Enum

from aerodima.hardware.car.watchdog_settings import WatchdogTiming


class Word(Enum):
    """What the drive process writes."""

    BEAT = b"."
    """Every beat is answered: `ANSWER` comes back."""
    ARMED = b"A"
    DISARMED = b"D"
    TRIP = b"T"
    QUIT = b"Q"


ANSWER = b"\x06"
"""What the watchdog writes for a beat; no byte of its lines of text."""


class Guard:
    """State of the watchdog.

    Attributes:
        cause: why it acted; empty while it has not. For good: a new process guards the next drive.
        cause_time: when that was known, s.
        ended: the drive process is gone or has quit.
        tripped: it asked for help: its own exit frames may not have left.
    """

    def __init__(self, timing: WatchdogTiming) -> None:
        self._timing = timing
        self._armed = False
        self._beat = 0.0
        self._quit = False
        self.cause = ""
        self.cause_time = 0.0
        self.ended = self.tripped = False

    def take(self, data: bytes, now: float) -> None:
        """Takes what came through the pipe at `now` (s); bytes that are no word are ignored."""
        for value in data:
            word = bytes([value])
            if word == Word.BEAT.value:
                self._beat = now
            elif word == Word.ARMED.value:
                self._armed, self._beat = True, now
            elif word == Word.DISARMED.value:
                self._armed = False
            elif word == Word.TRIP.value:
                self.tripped = True
                self.act("asked to by the drive process", now)
            elif word == Word.QUIT.value:
                self._quit = True

    def end(self, now: float) -> None:
        """The pipe ended. Quitting while armed is a death too."""
        self.ended = True
        if not self._quit or self._armed:
            self.act("the drive process died", now)

    def look(self, now: float) -> None:
        """Looks at the clock."""
        silence = now - self._beat
        if self._armed and not self.cause and silence > self._timing.heartbeat_timeout:
            self.act(f"no heartbeat for {silence:.3f} s", now)

    def act(self, cause: str, now: float) -> None:
        """The motors must be switched off; the first cause counts."""
        if not self.cause:
            self.cause, self.cause_time = cause, now
