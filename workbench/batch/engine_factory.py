"""Engine of worker processes for many pieces of work, or for one batch."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from aerodima.workbench.batch.dask_cluster import (
    check_workers,
    local_cluster,
    local_workers,
    quiet_logs,
    remote_cluster,
)
from aerodima.workbench.batch.dask_engine import DaskEngine
from aerodima.workbench.batch.engine import Engine, Item, Result, WorkerRecord
from aerodima.workbench.batch.row_store import ProgressLine, print_progress


@contextmanager
def open_engine(
    workers: int = 2,
    scheduler: str | None = None,
    *,
    progress: ProgressLine = print_progress,
    record: str | Path | None = None,
    memory: float | None = None,
    module: str | None = None,
) -> Iterator[Engine]:
    """Open an engine of worker processes on this computer, or of those of a Dask cluster.

    Args:
        workers: number of processes to start here, one BLAS thread each; not used with a scheduler.
        scheduler: address of a running Dask scheduler, such as `tcp://127.0.0.1:8786`. Its workers
            need this package.
        progress: function that receives a line when something happens to a worker; by default
            lines go to stderr.
        record: path of a file for the same; usually `WORKER_RECORD` in the folder of the study.
        memory: memory limit of each process here, bytes; by default an equal share of this
            computer's.
        module: name of a module that a worker imports before its first piece.

    Raises:
        UserError: wrong number of workers; no scheduler at that address, or one without workers.
    """
    if scheduler is None:
        check_workers(workers)
        cluster = local_cluster(workers, memory)
    else:
        cluster = remote_cluster(scheduler)
    start = time.monotonic()
    others = {process.pid for process in local_workers()}
    events = WorkerRecord(progress, None if record is None else Path(record))
    with quiet_logs(), cluster as client:
        engine = DaskEngine(
            client, events, is_local=scheduler is None, module=module, others=others
        )
        engine.wait_until_ready(workers if scheduler is None else 1)
        engine.startup = time.monotonic() - start
        try:
            yield engine
        finally:
            events.close()


def run_batch(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    done: Callable[[int, Result], None] | None = None,
    lost: Callable[[Item], Result] | None = None,
    *,
    progress: ProgressLine = print_progress,
    record: Path | None = None,
) -> list[Result]:
    """Map items on an engine of their own; with one worker or one item, in this process."""
    check_workers(workers)
    number = min(workers, len(items))
    if number <= 1:
        return Engine(progress, record).map(work, items, done, lost)
    with open_engine(number, progress=progress, record=record) as engine:
        return engine.map(work, items, done, lost)
