"""Engine that does pieces of work in this process, and the record of what happens to workers."""

from __future__ import annotations

import json
import statistics
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from aerodima.workbench.batch.row_store import ProgressLine, print_progress

Item = TypeVar("Item")
Result = TypeVar("Result")

STALL_FACTOR = 10.0
"""Number of median run times without the end of a run after which work has stalled."""
MIN_STALL_TIME = 30.0
"""Shortest time after which work has stalled, s."""
FIRST_STALL_TIME = 120.0
"""Time after which work has stalled while no run has ended, so that no run time is typical, s."""


class Engine:
    """Does pieces of work in this process, one after the other; the engines of `open_engine` do
    them in several processes (`dask_engine`).

    Attributes:
        workers: number of pieces that are done at a time.
        startup: time from opening the engine until the workers were ready, s.

    Args:
        progress: function that receives a line when something happens to a worker or the work
            stands still.
        record: path of a file for the same events.
    """

    workers = 1
    startup = 0.0

    def __init__(self, progress: ProgressLine = print_progress, record: Path | None = None) -> None:
        self._record = WorkerRecord(progress, record)

    @property
    def events(self) -> dict[str, int]:
        """Count events by kind (docs/howto/studies.md): `replaced`, `lost`, `paused` ..."""
        return dict(self._record.counts)

    def map(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        done: Callable[[int, Result], None] | None = None,
        lost: Callable[[Item], Result] | None = None,
    ) -> list[Result]:
        """Compute `work(item)` for every item; returns the results in the order of the items.

        A piece whose worker dies is done again after all others, with nothing beside it; it is
        given up if its worker dies then too.

        Args:
            work: function of a module, so that a process can import it, or a `functools.partial` of
                one.
            items: inputs of the pieces; they and the results must pickle.
            done: function that receives the index and result of each finished item, once, in the
                order in which they finish.
            lost: function that makes the result of an item that was given up; without it such an
                item is an error after all others.

        Raises:
            UserError: items were given up and there is no `lost`, or workers die before anything is
                done.
            Exception: whatever `work` raises; pieces that have not begun are dropped.
        """
        results = []
        with StallMonitor(self._record) as stall:
            for index, item in enumerate(items):
                start = time.monotonic()
                results.append(work(item))
                stall.record_run(time.monotonic() - start)
                if done is not None:
                    done(index, results[-1])
        return results


class WorkerRecord:
    """Prints and keeps the events of one engine.

    Args:
        progress: function that receives a line per event.
        path: path of the file, which is made with the first event; usually `WORKER_RECORD` in the
            folder of the study.
    """

    def __init__(self, progress: ProgressLine, path: Path | None) -> None:
        self._progress = progress
        self._path = path
        self.counts: Counter[str] = Counter()

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """Record an event (kinds: docs/howto/studies.md); `facts` go to the file only."""
        self.counts[kind] += 1
        self._progress(text)
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        line = {
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "event": kind,
            **facts,
            "text": text,
        }
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")

    def close(self) -> None:
        """Print how many events of each kind there were, if any."""
        if not self.counts:
            return
        kinds = [f"{count} {kind.replace('_', ' ')}" for kind, count in sorted(self.counts.items())]
        text = f"workers: {', '.join(kinds)}"
        if self._path is not None:
            text += f"; see {self._path}"
        self._progress(text)


class StallMonitor:
    """Records an event when no run ends for long, and again after each doubling of that time.

    As a context manager it polls by itself, once a second.

    Args:
        record: record that receives the event.
        busy: function that names what is under way.
    """

    def __init__(self, record: WorkerRecord, busy: Callable[[], str] = str) -> None:
        self._record = record
        self._busy = busy
        self._seconds: deque[float] = deque(maxlen=101)
        self._limit = FIRST_STALL_TIME
        self._last = time.monotonic()
        self._over = threading.Event()

    def record_run(self, seconds: float) -> None:
        """Note the end of a run and how long it took, s."""
        self._seconds.append(seconds)
        self._last = time.monotonic()
        self._limit = max(MIN_STALL_TIME, STALL_FACTOR * statistics.median(self._seconds))

    def poll(self) -> None:
        """Record an event if work has stalled."""
        waited = time.monotonic() - self._last
        if waited < self._limit:
            return
        self._limit = 2.0 * waited
        typical = "not known yet"
        if self._seconds:
            typical = f"{statistics.median(self._seconds):.3g} s"
        text = f"no run has ended for {waited:.0f} s (typical: {typical}){self._busy()}"
        self._record.event("still", text, waited_s=waited)

    def __enter__(self) -> StallMonitor:
        threading.Thread(target=self._poll_on, daemon=True, name="stall monitor").start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()

    def _poll_on(self) -> None:
        while not self._over.wait(1.0):
            self.poll()
