"""What happened in the emulated car, one JSON object per line, on the clock that all processes of a computer share."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any


class EventLog:
    """Appends to a file; every line is on the disk's side of the process as soon as it is written.

    A line has `time_s` (`time.monotonic`) and `event`, and what belongs to the event.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, "x", encoding="utf-8", buffering=1)  # noqa: SIM115 - open as long as the emulator runs

    def add(self, event: str, **facts: Any) -> None:
        """One event, now."""
        self._file.write(json.dumps({"time_s": time.monotonic(), "event": event, **facts}) + "\n")

    def close(self) -> None:
        """Nothing more to write."""
        self._file.close()


def read_events(path: Path) -> list[dict[str, Any]]:
    """The events so far, also while the emulator runs; a line that is not complete is left out."""
    lines = path.read_text(encoding="utf-8").split("\n")[:-1]
    return [json.loads(line) for line in lines]
