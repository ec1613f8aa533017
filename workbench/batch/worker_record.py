"""What happens to workers: a line each on the terminal and in the folder of the study, and one at a standstill."""

from __future__ import annotations

import json
import statistics
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ProgressLine = Callable[[str], None]
"""Told how far work is, a line each."""


def silent(_line: str) -> None:
    """Says nothing."""


def on_stderr(line: str) -> None:
    """Says it at once."""
    print(line, file=sys.stderr, flush=True)


WORKER_RECORD = "workers.jsonl"
"""In the folder of a study, once something happened: a line per event with its time, worker, process and text."""

STILL_TIMES = 10.0
"""Work stands still when no run has ended for so many typical run times (their median), and at least `STILL_LEAST`."""
STILL_LEAST = 30.0
"""s."""
STILL_FIRST = 120.0
"""s; while no run has ended at all, so that there is no typical time."""


class WorkerRecord:
    """Says and keeps the events of one engine.

    Args:
        progress: told a line per event.
        path: of the file, made with the first event; usually `WORKER_RECORD` in the folder of the study.
    """

    def __init__(self, progress: ProgressLine = on_stderr, path: Path | None = None) -> None:
        self._progress = progress
        self._path = path
        self.counts: Counter[str] = Counter()

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """One event (the kinds: docs/howto/studies.md); `facts` go to the file only."""
        self.counts[kind] += 1
        self._progress(text)
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        line = {"time": datetime.now(UTC).isoformat(timespec="seconds"), "event": kind, **facts, "text": text}
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")

    def close(self) -> None:
        """Sums the events up, if there were any."""
        if self.counts:
            text = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in sorted(self.counts.items()))
            self._progress(f"workers: {text}" + ("" if self._path is None else f"; see {self._path}"))


class Standstill:
    """Says when no run ends for long; again after each doubling of that time. As a context manager it looks by itself.

    Args:
        record: told the event.
        where: names what is under way.
    """

    def __init__(self, record: WorkerRecord, where: Callable[[], str] = lambda: "") -> None:
        self._record, self._where = record, where
        self._seconds: deque[float] = deque(maxlen=101)
        self._limit, self._last = STILL_FIRST, time.monotonic()
        self._over = threading.Event()

    def ended(self, seconds: float) -> None:
        """A run has ended that took so many seconds."""
        self._seconds.append(seconds)
        self._last = time.monotonic()
        self._limit = max(STILL_LEAST, STILL_TIMES * statistics.median(self._seconds))

    def look(self) -> None:
        """Says it when it is so."""
        waited = time.monotonic() - self._last
        if waited < self._limit:
            return
        self._limit = 2.0 * waited
        typical = f"{statistics.median(self._seconds):.3g} s" if self._seconds else "not known yet"
        text = f"no run has ended for {waited:.0f} s (typical: {typical}){self._where()}"
        self._record.event("still", text, waited_s=waited)

    def __enter__(self) -> Standstill:
        self._last = time.monotonic()
        threading.Thread(target=self._look_on, daemon=True, name="standstill").start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()

    def _look_on(self) -> None:
        while not self._over.wait(1.0):
            self.look()
