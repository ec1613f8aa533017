"""The watchdog process: `python -m aerodima.hardware.watchdog SETTINGS`, started by `WatchdogProcess`.

SETTINGS is JSON: `can` (the fields of `CanSettings`), `motor_ids`, `report` (a file, or null). Standard input is the
pipe from the drive process; standard output carries one line when it is ready, one when it has acted.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import Any

from aerodima.hardware.car.latency import WATCHDOG_PRIORITY
from aerodima.hardware.car.safety_settings import WatchdogTiming, load_watchdog_timing
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.watchdog.adapter_line import ExitLine, open_line
from aerodima.hardware.watchdog.watchdog_process import ANSWER, Guard, Word
from aerodima.workbench.errors import UserError
from aerodima.workbench.realtime import prefer_realtime

_LOOK = 0.005
"""How often it looks at the clock, s."""


class Watchdog:
    """Pipe in, exit frames out."""

    def __init__(self, line: ExitLine, timing: WatchdogTiming, report: Path | None) -> None:
        self._line, self._timing, self._report = line, timing, report
        self._guard = Guard(timing)
        self._first_exit: float | None = None
        self._next_exit = 0.0
        self._reopened = self._taken = False

    def run(self) -> None:
        """Until the drive process has quit or, after its death, the exit frames were sent for long enough."""
        signal.signal(signal.SIGTERM, lambda *_: self._guard.act("the watchdog was told to end", time.monotonic()))
        _say("ready")
        while True:
            self._listen(_LOOK)
            now = time.monotonic()
            self._guard.look(now)
            self._line.drain(alone=self._guard.ended)
            if self._guard.cause:
                self._act(now)
            if self._guard.ended and (not self._guard.cause or self._over(now)):
                return

    def _over(self, now: float) -> bool:
        """Exit frames were sent for long enough, or nobody can hope any more that the adapter comes back."""
        since = now - (self._first_exit or now)
        return since > (self._timing.exit_time if self._taken else self._timing.give_up)

    def _listen(self, timeout: float) -> None:
        if self._guard.ended:
            time.sleep(timeout)
            return
        readable, _, _ = select.select([0], [], [], timeout)
        if readable:
            data = os.read(0, 4096)
            now = time.monotonic()
            if data:
                self._guard.take(data, now)
                with contextlib.suppress(OSError):  # nobody reads: then nobody beats either
                    os.write(1, ANSWER * (data.count(Word.BEAT.value) + data.count(Word.ARMED.value)))
            else:
                self._guard.end(now)

    def _act(self, now: float) -> None:
        if self._first_exit is None:
            self._taken = self._line.send_exits(self._timing.exit_burst)
            self._first_exit = time.monotonic()
            self._next_exit = self._first_exit + self._timing.exit_interval
            self._tell()
            return
        if not self._reopened and now - self._first_exit > self._timing.reopen_after:
            self._reopened = True
            if self._guard.ended or self._guard.tripped:  # otherwise the drive process may still use the channel
                self._line.reopen()
        if now >= self._next_exit:
            recent = now - self._first_exit < self._timing.exit_time
            self._next_exit = now + (self._timing.exit_interval if recent else self._timing.reminder)
            self._taken = self._line.send_exits(1)

    def _tell(self) -> None:
        _say(f"acted: {self._guard.cause}")
        if self._report is None:
            return
        content = {
            "cause": self._guard.cause,
            "cause_time_s": self._guard.cause_time,
            "first_exit_time_s": self._first_exit,
            "taken_by_driver": self._taken,
        }
        try:
            self._report.write_text(json.dumps(content) + "\n", encoding="utf-8")
        except OSError as error:
            _say(f"error: {self._report}: {error.strerror}")


_GROUP = "watchdog"


def leave_control_group(
    root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup"), asked: bool | None = None
) -> str:
    """Moves this process into the group `watchdog` below its own.

    Args:
        root: where the groups are. own: which group this process is in.
        asked: whether the service asks for it; by its environment when None.

    Returns:
        The new group; empty if it stays where it is.
    """
    if not (os.environ.get("AERODIMA_UNIT") == "1" if asked is None else asked):
        return ""
    try:
        lines = own.read_text(encoding="utf-8").splitlines()
        path = next(line.removeprefix("0::") for line in lines if line.startswith("0::"))
        group = root / path.lstrip("/") / _GROUP
        group.mkdir(exist_ok=True)
        (group / "cgroup.procs").write_text(f"{os.getpid()}\n", encoding="ascii")
    except (OSError, StopIteration):
        return ""
    return str(group)


def _say(text: str) -> None:
    with contextlib.suppress(OSError):  # the drive process is gone
        os.write(1, (text + "\n").encode())


def main() -> int:
    """Runs the watchdog of the settings on the command line; 2 if it cannot watch."""
    for ignored in (signal.SIGINT, signal.SIGHUP, signal.SIGPIPE):  # Ctrl-C is for the drive process
        signal.signal(ignored, signal.SIG_IGN)
    settings: dict[str, Any] = json.loads(sys.argv[1])
    os.set_blocking(1, False)
    report = None if settings["report"] is None else Path(settings["report"])
    try:
        leave_control_group()
        prefer_realtime(WATCHDOG_PRIORITY)
        line = open_line(CanSettings(**settings["can"]), tuple(settings["motor_ids"]))
        Watchdog(line, load_watchdog_timing(), report).run()
    except UserError as error:
        _say(f"error: {error}")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
