"""Does pieces of work in this process (`dask_engine`: in several); says and keeps what happens to
workers meanwhile.
"""

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

STILL_TIMES = 10.0
"""Work stands still when no run has ended for so many typical run times (their median), and at
least `STILL_LEAST`."""
STILL_LEAST = 30.0
"""s."""
STILL_FIRST = 120.0
"""s; while no run has ended at all, so that there is no typical time."""


class Engine:
    """Does pieces of work in this process, one after the other; those of `open_engine` do them in
    several.

    Attributes:
        workers: how many pieces are done at a time.
        startup: time from the opening until the workers were ready, s.

    Args:
        progress: receives what happens to workers, and when the work stands still.
        record: file for the same.
    """

    workers = 1
    startup = 0.0

    def __init__(self, progress: ProgressLine = print_progress, record: Path | None = None) -> None:
        self._record = WorkerRecord(progress, record)

    @property
    def events(self) -> dict[str, int]:
        """Kind of event (docs/howto/studies.md) -> how often: `replaced`, `lost`, `paused` ..."""
        return dict(self._record.counts)

    def map(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        done: Callable[[int, Result], None] | None = None,
        lost: Callable[[Item], Result] | None = None,
    ) -> list[Result]:
        """Results of `work(item)`, in the order of the items.

        A piece whose worker dies is done again after all others, with nothing beside it; it is
        given up if its worker dies then too.

        Args:
            work: function of a module, so that a process can import it; a `functools.partial` of
                one.
            items: they and the results must pickle.
            done: receives the index and result of each finished item, once, in the order in which
                they finish.
            lost: makes the result of an item that was given up; without it that is an error after
                all others.

        Raises:
            UserError: items were given up and there is no `lost`, or workers die before anything is
                done.
            Exception: whatever `work` raises; what has not begun is dropped.
        """
        results = []
        with Standstill(self._record) as still:
            for place, item in enumerate(items):
                start = time.monotonic()
                results.append(work(item))
                still.ended(time.monotonic() - start)
                if done is not None:
                    done(place, results[-1])
        return results


class WorkerRecord:
    """Says and keeps the events of one engine.

    Args:
        progress: receives a line per event.
        path: of the file, made with the first event; usually `WORKER_RECORD` in the folder of the
            study.
    """

    def __init__(self, progress: ProgressLine = print_progress, path: Path | None = None) -> None:
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
        line = {
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "event": kind,
            **facts,
            "text": text,
        }
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")

    def close(self) -> None:
        """Sums the events up, if there were any."""
        if self.counts:
            text = ", ".join(
                f"{count} {kind.replace('_', ' ')}" for kind, count in sorted(self.counts.items())
            )
            self._progress(
                f"workers: {text}" + ("" if self._path is None else f"; see {self._path}")
            )


class Standstill:
    """Says when no run ends for long; again after each doubling of that time.

    As a context manager it looks by itself.

    Args:
        record: receives the event.
        where: names what is under way.
    """

    def __init__(self, record: WorkerRecord, where: Callable[[], str] = lambda: "") -> None:
        self._record = record
        self._where = where
        self._seconds: deque[float] = deque(maxlen=101)
        self._limit = STILL_FIRST
        self._last = time.monotonic()
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
        typical = "not known yet"
        if self._seconds:
            typical = f"{statistics.median(self._seconds):.3g} s"
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
