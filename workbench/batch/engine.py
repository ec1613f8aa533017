"""Where pieces of work are done: with one worker in this process, with more in processes that Dask starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, TypeVar

from aerodima.workbench.batch.row_store import ProgressLine, Standstill, WorkerRecord, on_stderr
from aerodima.workbench.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_WORKERS = 64
"""Processes on one computer."""


class Engine:
    """Does pieces of work in this process, one after the other; those of `open_engine` do them in several.

    Attributes:
        workers: how many pieces are done at a time.
        startup: time from the opening until the workers were ready, s.

    Args:
        progress: told what happens to workers, and when the work stands still.
        record: file for the same.
    """

    workers = 1
    startup = 0.0

    def __init__(self, progress: ProgressLine = on_stderr, record: Path | None = None) -> None:
        self._record = WorkerRecord(progress, record)

    @property
    def events(self) -> dict[str, int]:
        """Kind of event (docs/howto/studies.md) -> how often: `replaced`, `lost`, `paused`, `still` ..."""
        return dict(self._record.counts)

    def map(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        done: Callable[[int, Result], None] | None = None,
        lost: Callable[[Item], Result] | None = None,
    ) -> list[Result]:
        """Results of `work(item)`, in the order of the items.

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
    alone = nullcontext(Engine(progress, record))
    opened: Any = alone if number <= 1 else open_engine(number, progress=progress, record=record)
    with opened as engine:
        return engine.map(work, items, count, lost)


def check_workers(workers: int) -> None:
    """Raises UserError unless there are 1 to `MOST_WORKERS` workers."""
    if not 1 <= workers <= MOST_WORKERS:
        raise UserError(f"--workers {workers}: allowed: 1 to {MOST_WORKERS}")
