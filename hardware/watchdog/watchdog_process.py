"""The watchdog process as the drive process has it, and the words between the two: one byte per message, and a clock.

```
waiting -- armed --> guarding -- disarmed --> waiting
   |                    |
   +-- the pipe ends ---+-- no heartbeat, or asked to --> acting, for good
```
The end of the pipe without `QUIT` is the death of the drive process, whatever killed it.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from enum import Enum
from pathlib import Path

from aerodima.hardware.car.safety_settings import WatchdogTiming, load_watchdog_timing
from aerodima.hardware.protocol.ak70 import check_motor_id
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.device_lock import DeviceLock
from aerodima.workbench.errors import HardwareError


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


_START_TIME = 15.0


class WatchdogProcess:
    """A running watchdog for the motors on one adapter.

    Start it after the drive process has opened the adapter. `arm` before the motors are entered, `beat` in every cycle,
    `disarm` when they are off, `close` at the end. None of these waits, except `close`. It answers every beat: one
    that hangs is not healthy. The motors must be switched off when `healthy` is False, and nothing may be armed with it
    again.

    Args:
        settings: the adapter, as the drive process opens it.
        motor_ids: whom it switches off.
        report: file that it writes when it acts (cause, and the times of cause and first exit frame on the clock of
            `time.monotonic`); for the record of a watchdog test.
        lock: of the adapter; it inherits it, so that nobody else drives while it sends.

    Raises:
        HardwareError: it cannot open the adapter, or does not start within 15 s.
    """

    def __init__(
        self,
        settings: CanSettings,
        motor_ids: tuple[int, ...],
        report: Path | None = None,
        lock: DeviceLock | None = None,
    ) -> None:
        for motor_id in motor_ids:
            check_motor_id(motor_id)
        self._text = b""
        self._lines: list[str] = []
        self._broken = ""
        self._tripped = False
        self._asked: float | None = None  # when the first heartbeat without an answer left
        self._answer_timeout = load_watchdog_timing().answer_timeout
        content = {
            "can": settings.model_dump(),
            "motor_ids": list(motor_ids),
            "report": None if report is None else str(report.resolve()),
        }
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "aerodima.hardware.watchdog", json.dumps(content)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # what is meant for the terminal or the session of the drive is not for it
            pass_fds=() if lock is None else lock.files,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._in, False)
        os.set_blocking(self._out, False)
        if lock is not None:
            lock.entrust(self._process.pid)
        self._wait_ready()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def healthy(self) -> bool:
        """Whether it lives and has not acted."""
        self._read()
        return not self.reason

    @property
    def reason(self) -> str:
        """Why it is not healthy; empty while it is."""
        acted = next((line for line in self._lines if line.startswith("acted")), "")
        if acted:
            return f"the watchdog has {acted}"
        if self._broken or self._process.poll() is not None:
            return "the watchdog process has ended"
        waited = 0.0 if self._asked is None else time.monotonic() - self._asked
        return f"the watchdog process does not answer for {waited:.2f} s" if waited > self._answer_timeout else ""

    def arm(self) -> None:
        """From now on it waits for heartbeats. Raises `HardwareError` if it is not healthy."""
        if not self.healthy:
            raise HardwareError(f"{self.reason}; start anew")
        self._ask(Word.ARMED)

    def beat(self) -> None:
        """The loop lives."""
        self._ask(Word.BEAT)

    def disarm(self) -> None:
        """The motors are off; no heartbeats follow."""
        self._write(Word.DISARMED)

    def trip(self) -> None:
        """Asks it to switch the motors off: the drive process cannot, or is not sure."""
        self._tripped = True
        self._write(Word.TRIP)

    def close(self, timeout: float = 2.0) -> None:
        """Ends it in order, and kills it if it does not end within `timeout` s. Never raises.

        One that has acted or was asked to is left alone: it goes on sending exit frames for a while, also to an adapter
        that is plugged in again, and ends by itself.
        """
        self._read()
        hangs = self._asked is not None and "does not answer" in self.reason
        acted = (self._tripped or bool(self.reason)) and not hangs
        self._write(Word.QUIT)
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        self._broken = self._broken or "closed"
        if hangs:  # it would keep the adapter's lock for ever, and switches nothing off
            self._process.kill()
        if acted and self._process.poll() is None:
            return
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _wait_ready(self) -> None:
        end = time.monotonic() + _START_TIME
        while "ready" not in self._lines:
            select.select([self._out], [], [], 0.1)
            self._read()
            error = next((line for line in self._lines if line.startswith("error: ")), "")
            if error or self._process.poll() is not None or time.monotonic() > end:
                self.close(0.5)
                raise HardwareError(error.removeprefix("error: ") or "the watchdog process did not start")

    def _read(self) -> None:
        try:
            while data := os.read(self._out, 4096):
                if ANSWER in data:
                    self._asked = None
                self._text += data.replace(ANSWER, b"")
        except BlockingIOError:
            pass
        except (OSError, ValueError) as error:
            self._broken = str(error)
        *lines, self._text = self._text.split(b"\n")
        self._lines += [line.decode("utf-8", "replace") for line in lines]

    def _ask(self, word: Word) -> None:
        self._read()
        if self._asked is None:
            self._asked = time.monotonic()
        self._write(word)

    def _write(self, word: Word) -> None:
        if self._broken:
            return
        try:
            os.write(self._in, word.value)
        except BlockingIOError:
            pass  # it does not read: its own clock tells it that no heartbeat came
        except OSError as error:
            self._broken = str(error)
