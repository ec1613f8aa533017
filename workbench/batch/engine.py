"""Where pieces of work are done: with one worker in this process, with more in processes that Dask starts.

What happens to the workers is kept: a line each on the terminal and in the folder of the study, and a line when work
stands still.
"""

from __future__ import annotations

import json
import statistics
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, TypeVar

from aerodima.workbench.errors import UserError

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


Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_WORKERS = 64
"""Processes on one computer."""


class Engine(Protocol):
    """Does pieces of work; results come in the order of the items."""

    @property
    def workers(self) -> int:
        """How many pieces are done at a time."""

    @property
    def startup(self) -> float:
        """Time from the opening until the workers were ready, s."""

    @property
    def events(self) -> dict[str, int]:
        """Kind of event (docs/howto/studies.md) -> how often: `replaced`, `lost`, `paused`, `still` ..."""

    def map(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        done: Callable[[int, Result], None] | None = None,
        lost: Callable[[Item], Result] | None = None,
    ) -> list[Result]:
        """Results of `work(item)`.

        A piece whose worker dies is done again after all others, with nothing beside it; it is given up if its worker
        dies then too.

        Args:
            work: function of a module, so that a process can import it; a `functools.partial` of one.
            items: they and the results must pickle.
            done: told the place of each finished item and its result, once, in the order in which they finish.
            lost: makes the result of an item that was given up; without it that is an error after all others.

        Raises:
            UserError: items were given up and there is no `lost`, or workers die before anything is done.
            Exception: whatever `work` raises; what has not begun is dropped.
        """


class SerialEngine:
    """In this process, one after the other: for small work, and for tests. It says when it stands still."""

    workers = 1
    startup = 0.0

    def __init__(self, progress: ProgressLine = on_stderr, record: Path | None = None) -> None:
        self._record = WorkerRecord(progress, record)

    @property
    def events(self) -> dict[str, int]:
        """See `Engine`."""
        return dict(self._record.counts)

    def map(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        done: Callable[[int, Result], None] | None = None,
        lost: Callable[[Item], Result] | None = None,
    ) -> list[Result]:
        """See `Engine`."""
        results = []
        with Standstill(self._record) as still:
            for place, item in enumerate(items):
                start = time.monotonic()
                results.append(work(item))
                still.ended(time.monotonic() - start)
                if done is not None:
                    done(place, results[-1])
        return results


@contextmanager
def open_engine(
    workers: int = 2,
    scheduler: str | None = None,
    *,
    progress: ProgressLine = on_stderr,
    record: str | Path | None = None,
    memory: float | None = None,
    module: str | None = None,
) -> Iterator[Engine]:
    """Worker processes on this computer, or those of a Dask cluster.

    Args:
        workers: processes to start here, one BLAS thread each; not used with a scheduler.
        scheduler: address of a running Dask scheduler, such as `tcp://127.0.0.1:8786`. Its workers need this package.
        progress: told what happens to workers, a line each; stderr by default.
        record: file for the same; usually `WORKER_RECORD` in the folder of the study.
        memory: limit of each process here, bytes; by default an equal share of this computer's.
        module: that a worker imports before its first piece.

    Raises:
        UserError: wrong number of workers; no scheduler at that address, or one without workers.
    """
    from aerodima.workbench.batch.dask_cluster import local_cluster, quiet_logs, remote_cluster
    from aerodima.workbench.batch.dask_engine import DaskEngine

    if scheduler is None:
        check_workers(workers)
    start = time.monotonic()
    kept = WorkerRecord(progress, None if record is None else Path(record))
    client_of = local_cluster(workers, memory) if scheduler is None else remote_cluster(scheduler)
    with quiet_logs(), client_of as client:
        engine = DaskEngine(client, kept, is_local=scheduler is None, module=module)
        engine.wait_until_ready()
        engine.startup = time.monotonic() - start
        try:
            yield engine
        finally:
            kept.close()


def run_batch(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    done: Callable[[int, Result], None] | None = None,
    lost: Callable[[Item], Result] | None = None,
    *,
    progress: ProgressLine = on_stderr,
    record: Path | None = None,
) -> list[Result]:
    """`Engine.map` on an engine for these items alone; with one worker, or one item, in this process.

    Args:
        done: told how many items are finished and the newest result.
    """
    check_workers(workers)
    finished = 0

    def count(place: int, result: Result) -> None:
        nonlocal finished
        finished += 1
        if done is not None:
            done(finished, result)

    number = min(workers, len(items))
    alone = nullcontext(SerialEngine(progress, record))
    opened: Any = alone if number <= 1 else open_engine(number, progress=progress, record=record)
    with opened as engine:
        return engine.map(work, items, count, lost)


def check_workers(workers: int) -> None:
    """Raises UserError unless there are 1 to `MOST_WORKERS` workers."""
    if not 1 <= workers <= MOST_WORKERS:
        raise UserError(f"--workers {workers}: allowed: 1 to {MOST_WORKERS}")
