"""Worker processes that Dask starts here or a running scheduler has; functions that run in one."""

from __future__ import annotations

import gc
import importlib
import itertools
import logging
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from ctypes.util import find_library
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from aerodima.workbench.batch.main_guard import refuse_unguarded_script
from aerodima.workbench.core.errors import UserError

if TYPE_CHECKING:
    import psutil
    from distributed import Client, LocalCluster

Work = Callable[[Any], Any]
"""Function that makes the result of an item."""
Outcome = tuple[Any, float, int, int]
"""Result of a piece, its time (s), process number, and the process's memory afterwards (bytes)."""
MAX_WORKERS = 64
"""Largest number of worker processes on one computer."""
CONNECT_TIMEOUT = 10.0
"""Time within which a running scheduler answers, s."""
CLOSE_TIMEOUT = 30.0
"""Time within which a local cluster closes, s."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
MEMORY_VARIABLES = {"MALLOC_TRIM_THRESHOLD_": "268435456", "MALLOC_MMAP_THRESHOLD_": "33554432"}
"""Bytes of free memory that a worker's C library keeps, and the largest array that it takes from
them (mallopt(3); 32 MiB is the most that it accepts). With Dask's own 64 KiB a batch of reduced
cars spent a tenth of its time on returning pages to the system and fetching them again."""
ALLOCATORS = ("tcmalloc_minimal", "jemalloc")
"""Libraries with which a simulated run takes 16 to 18 % less time than with the C library of Debian
12, with the same bits as result."""
FULL_COLLECTION_PERIOD = 100
"""Number of pieces between two full garbage collections of a worker; the others see only what is
new."""
_WORKER_PROCESS = "Dask Worker process (from Nanny)"
"""Name of a local worker among this process's children, as `distributed.nanny` gives it."""
_pieces = itertools.count(1)
_GIGABYTE = 1.0e9
"""Bytes in a gigabyte."""


def check_workers(workers: int) -> None:
    """Raise UserError unless there are 1 to `MAX_WORKERS` workers."""
    if not 1 <= workers <= MAX_WORKERS:
        raise UserError(f"--workers {workers}: must be 1 to {MAX_WORKERS}")


@contextmanager
def local_cluster(workers: int, memory: float | None = None) -> Iterator[Client]:
    """Start processes of one BLAS thread and `memory` bytes each; Dask's nanny replaces one that
    ends. Raises UserError in a script without a main guard.
    """
    refuse_unguarded_script()
    import dask
    from distributed import Client, LocalCluster

    options = {
        # the engine, not Dask, hands out a piece again whose worker died
        "distributed.scheduler.allowed-failures": 0,
        # a worker whose solver keeps the interpreter busy for long is not dead
        "distributed.scheduler.worker-ttl": None,
        "distributed.worker.multiprocessing-method": "spawn",
        # it looks at every stack 100 times a second, which costs 2 to 4 % of a run
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",  # 50 a second, in every process, by default
        # This long after the end of a worker, the cluster gives it up for good if there is none of
        # that name. A worker that is just being replaced once more is absent too, and would never
        # come back.
        "distributed.deploy.lost-worker-timeout": "30 days",
    }
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(options))
        stack.enter_context(_environment_of_workers())
        with _ctrl_c_blocked():
            cluster = LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                memory_limit="auto" if memory is None else int(memory),
                processes=True,
                host="127.0.0.1",
                # address of Dask's own HTTP routes; the dashboard itself is off
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
            )
            stack.callback(_close, cluster)
            client = stack.enter_context(Client(cluster))
        stack.callback(lambda: kill_workers(stopped_workers()))  # they would never end
        cluster.scale(workers)  # does not wait for them
        yield client


def _close(cluster: LocalCluster) -> None:
    """Close a cluster, or leave it: Python waits for ever for a process that takes no task."""
    with suppress(TimeoutError):
        cluster.close(timeout=CLOSE_TIMEOUT)


@contextmanager
def remote_cluster(address: str) -> Iterator[Client]:
    """Connect to the workers of the scheduler at an address."""
    from distributed import Client

    try:
        client = Client(address, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        raise UserError(
            f"--scheduler {address}: no Dask scheduler answers there ({str(error)[:160]})"
        ) from None
    with client:
        if not client.nthreads():
            raise UserError(
                f"--scheduler {address}: the scheduler has no workers; start some with `dask "
                "worker`"
            )
        yield client


@contextmanager
def _environment_of_workers() -> Iterator[None]:
    """Set the environment that worker processes inherit: one thread each, memory that they keep,
    and a fast allocator if there is one.

    Dask's own setting would not override the caller's number of threads. What the caller preloads,
    or sets for the memory, stays.
    """
    before = dict(os.environ)
    os.environ.update(MEMORY_VARIABLES | before | dict.fromkeys(THREAD_VARIABLES, "1"))
    if sys.platform == "linux":
        allocators = filter(None, map(find_library, ALLOCATORS))
        preloaded = [*filter(None, [before.get("LD_PRELOAD"), next(allocators, None)])]
        if preloaded:
            os.environ["LD_PRELOAD"] = " ".join(preloaded)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


@contextmanager
def quiet_logs() -> Iterator[None]:
    """Silence Dask and its loop, which log every lost worker; `WorkerRecord` has what matters."""
    import distributed  # noqa: F401 - sets its logger up when it is imported, so before the level below

    loggers = [logging.getLogger(name) for name in ("distributed", "tornado.application")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Hold Ctrl-C back for threads and processes that are started meanwhile, and for what they
    start in turn.

    The terminal sends it to all processes, but the client alone is to act on it: it closes the
    workers. A worker that replaces a lost one is started by such a thread too.
    """
    # started later, it would unblock the signal in the thread that starts it
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def lost_scheduler(error: Exception) -> UserError:
    """Make the error of a scheduler that is gone."""
    reason = str(error) or type(error).__name__
    return UserError(
        f"the Dask scheduler does not answer any more ({reason}); what was done is kept"
    )


def local_workers() -> list[psutil.Process]:
    """List the processes of local workers, including those that are starting.

    Python lists a child once it has taken its task. A worker that was stopped before that is
    recognised by its command line; the caller's own processes are left out by their names.
    """
    import psutil

    children = multiprocessing.active_children()
    others = {child.pid for child in children if child.name != _WORKER_PROCESS}
    workers = []
    for process in psutil.Process().children():
        with suppress(psutil.Error):
            if process.pid not in others and "spawn_main" in " ".join(process.cmdline()):
                workers.append(process)
    return workers


def stopped_workers() -> set[psutil.Process]:
    """Find the local workers that a signal stopped."""
    import psutil

    stopped = set()
    for process in local_workers():
        with suppress(psutil.Error):
            if process.status() == psutil.STATUS_STOPPED:
                stopped.add(process)
    return stopped


def kill_workers(processes: Iterable[psutil.Process]) -> None:
    """Kill processes that may have ended already."""
    import psutil

    for process in processes:
        with suppress(psutil.Error):
            process.kill()


@dataclass
class Worker:
    """State of one worker process; memory in bytes."""

    name: str
    threads: int
    limit: float
    has_nanny: bool
    pid: int = 0
    memory: float = 0.0
    pieces: int = 0
    status: str = "running"
    idle: int = 0

    @property
    def held(self) -> str:
        """Describe the memory that the worker holds, and its limit."""
        text = f"{self.memory / _GIGABYTE:.2f}"
        if self.limit:
            text += f" of {self.limit / _GIGABYTE:.2f}"
        return f"{text} GB"

    def __str__(self) -> str:
        return f"worker {self.name} (process {self.pid or 'unknown'})"


def run_piece(work: Work, item: Any) -> Outcome:
    """Do a piece in the worker; returns its result, time (s), process and memory (bytes)."""
    start = time.monotonic()
    result = work(item)
    seconds = time.monotonic() - start
    if next(_pieces) % FULL_COLLECTION_PERIOD == 0:
        gc.unfreeze()
    # a dead diagram is a cycle that weighs megabytes and looks like a few small objects
    gc.collect()
    gc.freeze()  # lasting objects would be looked at after every run: 0.1 ms more with each run
    return result, seconds, os.getpid(), _memory()


def prepare_worker(module: str | None) -> Outcome:
    """Import what pieces need in a new worker, out of the garbage collector's sight."""
    if module is not None:
        importlib.import_module(module)
    gc.collect()
    gc.freeze()
    return None, 0.0, os.getpid(), _memory()


def _memory() -> int:
    import psutil

    return int(psutil.Process().memory_info().rss)
