"""Where the runs of a sweep happen: in this process, in worker processes on this computer, or on a Dask cluster.

A worker that dies takes nothing with it: what it was working on is done again elsewhere. Work that kills its worker
again is set aside, and tried once more alone in the cluster at the end; what dies even there is reported as lost.
"""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from optimisation.sweep.task import WORKER_LOST, RunTask, evaluate, failed_row
from workbench.batch import THREAD_VARIABLES, check_workers
from workbench.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Result = TypeVar("Result")
Done = Callable[[int, Any], None]
"""Told the place of a finished item and its result, in the order in which they finish."""

DEATHS_ALLOWED = 1
"""A chunk whose worker has died more often than this is set aside."""
CHUNKS_PER_WORKER, LARGEST_CHUNK = 16, 8
CONNECT_TIMEOUT = 10.0
"""s; a scheduler that does not answer in this time is not there."""


class SweepError(UserError):
    """A sweep cannot go on: no scheduler, no workers, work that kills its workers."""


class Engine(Protocol):
    """Runs work; results come in the order of the items."""

    @property
    def workers(self) -> int:
        """How many pieces of work are done at a time."""

    @property
    def startup(self) -> float:
        """Time from the opening until the workers were ready to simulate, s."""

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """`evaluate` of each task; a task that kills its worker gives a row with an error."""

    def call(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """`function` (of a module) of each item; raises what it raises, and SweepError when it kills its worker."""


class SerialEngine:
    """In this process, one after the other: for small work, and for tests."""

    workers = 1
    startup = 0.0

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """See `Engine`."""
        rows = []
        for place, task in enumerate(tasks):
            rows.append(evaluate(task))
            if done is not None:
                done(place, rows[-1])
        return rows

    def call(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """See `Engine`."""
        return [function(item) for item in items]


@contextmanager
def open_engine(workers: int = 2, scheduler: str | None = None) -> Iterator[DaskEngine]:
    """Workers on this computer, or those of a cluster.

    Args:
        workers: processes to start here, one BLAS thread each; not used with a scheduler.
        scheduler: address of a running Dask scheduler, such as `tcp://127.0.0.1:8786`. Its workers need this package.

    Raises:
        UserError: wrong number of workers; no scheduler at that address, or one without workers.
    """
    start = time.monotonic()
    with _quiet_logs(), _local_cluster(workers) if scheduler is None else _remote(scheduler) as client:
        client.run(_get_ready)
        yield DaskEngine(client, time.monotonic() - start)


class DaskEngine:
    """On the workers of a Dask client; made by `open_engine`."""

    def __init__(self, client: Client, startup: float) -> None:
        self._client = client
        self.startup = startup

    @property
    def workers(self) -> int:
        """How many pieces of work are done at a time."""
        return max(1, sum(self._client.nthreads().values()))

    def rows(self, tasks: Sequence[RunTask], done: Done | None = None) -> list[dict[str, Any]]:
        """See `Engine`."""
        return self._spread(evaluate, tasks, lambda task: failed_row(task, WORKER_LOST_AGAIN), done)

    def call(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """See `Engine`."""

        def lost(item: Item) -> Any:
            raise SweepError(f"{WORKER_LOST} again and again while it worked on {item!r} (out of memory?)")

        return self._spread(function, items, lost, None)

    def _spread(
        self,
        function: Callable[[Any], Any],
        items: Sequence[Any],
        lost: Callable[[Any], Any],
        done: Done | None,
    ) -> list[Any]:
        results: dict[int, Any] = {}

        def keep(places: Sequence[int], values: Sequence[Any]) -> None:
            for place, value in zip(places, values, strict=True):
                results[place] = value
                if done is not None:
                    done(place, value)

        suspects = self._work(function, items, _chunks(len(items), self.workers), keep)
        for place in suspects:
            if self._work(function, items, [[place]], keep):
                keep([place], [lost(items[place])])
        return [results[place] for place in range(len(items))]

    def _work(
        self,
        function: Callable[[Any], Any],
        items: Sequence[Any],
        chunks: Sequence[Sequence[int]],
        keep: Callable[[Sequence[int], Sequence[Any]], None],
    ) -> list[int]:
        """Works on chunks of places; returns the places of the chunks that kept killing their workers."""
        from distributed import KilledWorker, as_completed

        suspects: list[int] = []
        futures = {
            self._client.submit(_chunk, function, [items[place] for place in chunk], pure=False, retries=0): chunk
            for chunk in chunks
        }
        try:
            for future in as_completed(list(futures)):
                try:
                    keep(futures[future], future.result())
                except KilledWorker:
                    suspects += futures[future]
                future.release()
        finally:
            self._client.cancel([future for future in futures if not future.done()])
        return sorted(suspects)


WORKER_LOST_AGAIN = (
    f"{WORKER_LOST} again and again, also alone in the cluster (out of memory, or a crash in the solver)"
)


def _chunks(number: int, workers: int) -> list[list[int]]:
    """Places cut into chunks: single ones where there are few, so that the last worker is not waited for."""
    size = max(1, min(LARGEST_CHUNK, number // (CHUNKS_PER_WORKER * workers)))
    return [list(range(start, min(start + size, number))) for start in range(0, number, size)]


def _chunk(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    return [function(item) for item in items]


def _get_ready() -> None:
    """Imports what a run needs, so that the first one does not wait for it."""
    import workbench.trial  # noqa: F401


@contextmanager
def _local_cluster(workers: int) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    check_workers(workers)
    options = {
        "distributed.scheduler.allowed-failures": DEATHS_ALLOWED,
        "distributed.worker.multiprocessing-method": "spawn",
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(THREAD_VARIABLES, 1),
        "distributed.worker.memory.terminate": False,
    }
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(options))
        with _ctrl_c_blocked():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # of Dask's own HTTP routes; the dashboard itself is off
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
            )
            stack.enter_context(cluster)
            client = stack.enter_context(Client(cluster))
        yield client


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Holds Ctrl-C back for threads and processes that are started meanwhile, and for what they start in turn.

    The terminal sends it to all processes, but the client alone is to act on it: it closes the workers. A worker that
    replaces a lost one is started by such a thread too.
    """
    resource_tracker.ensure_running()  # by its own start it would let the signal through to the thread that starts it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    from distributed import Client

    try:
        client = Client(address, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:160]
        raise SweepError(f"--scheduler {address}: no Dask scheduler answers there ({reason})") from None
    with client:
        if not client.nthreads():
            raise SweepError(f"--scheduler {address}: the scheduler has no workers; start some with `dask worker`")
        yield client


@contextmanager
def _quiet_logs() -> Iterator[None]:
    """Dask tells of every lost worker and closed stream; what matters of it is in the rows and in our errors."""
    import distributed  # noqa: F401 - sets its logger up when it is imported, so before the level below

    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
