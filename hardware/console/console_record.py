"""What the console sent and heard, as one JSON object per line, while recording is on."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, TextIO

from aerodima.workbench.errors import LogError


class ConsoleRecord:
    """A file that is begun with the first recording and continued by later ones.

    A line has `time_s` (seconds since 1970) and `event`.

    Args:
        path: of the file; it must not exist.

    Attributes:
        error: what ended the recording, empty while it works.
    """

    def __init__(self, path: Path) -> None:
        if path.exists():
            raise LogError(f"{path}: exists already; choose another --record")
        self.path = path
        self.error = ""
        self._file: TextIO | None = None

    @property
    def on(self) -> bool:
        """Whether it records."""
        return self._file is not None

    def switch(self, on: bool) -> None:
        """Begins or ends; a disk that does not take it is told by `error`."""
        if on == self.on:
            return
        try:
            if self._file is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._file = open(self.path, "a", encoding="utf-8", buffering=1)  # noqa: SIM115 - until switched off
                self.error = ""
            else:
                self._file.close()
                self._file = None
        except OSError as error:
            self._file, self.error = None, f"{self.path}: {error.strerror}"

    def add(self, event: str, **facts: Any) -> None:
        """One line, if it records."""
        if self._file is None:
            return
        try:
            self._file.write(json.dumps({"time_s": time.time(), "event": event, **facts}) + "\n")
        except OSError as error:
            self._file, self.error = None, f"{self.path}: {error.strerror}"
