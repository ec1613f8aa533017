"""Worker processes that Dask starts on this computer, or those of a scheduler that runs somewhere."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

from aerodima.workbench.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

CONNECT_TIMEOUT = 10.0
"""s; a scheduler that does not answer in this time is not there."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def local_cluster(workers: int, memory: float | None = None) -> Iterator[Client]:
    """So many processes, each replaced by Dask's nanny when it ends, with one BLAS thread and `memory` bytes."""
    import dask
    from distributed import Client, LocalCluster

    options = {
        "distributed.scheduler.allowed-failures": 0,  # a piece whose worker died is ours to give out again
        "distributed.scheduler.worker-ttl": None,  # a solver that keeps the interpreter busy for long is not dead
        "distributed.worker.multiprocessing-method": "spawn",
        # So long after a worker went, the cluster gives it up for good if it finds none of that name. One that is just
        # being replaced once more is not there either, and would never come back.
        "distributed.deploy.lost-worker-timeout": "30 days",
    }
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(options))
        stack.enter_context(_one_thread_each())
        with _ctrl_c_blocked():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit="auto" if memory is None else int(memory),
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
def remote_cluster(address: str) -> Iterator[Client]:
    """The workers of the scheduler at an address."""
    from distributed import Client

    try:
        client = Client(address, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:160]
        raise UserError(f"--scheduler {address}: no Dask scheduler answers there ({reason})") from None
    with client:
        if not client.nthreads():
            raise UserError(f"--scheduler {address}: the scheduler has no workers; start some with `dask worker`")
        yield client


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Environment that the worker processes inherit; in Dask's own setting it would not outdo the caller's."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def quiet_logs() -> Iterator[None]:
    """Dask tells of every lost worker and closed stream; what matters of it our own record says."""
    import distributed  # noqa: F401 - sets its logger up when it is imported, so before the level below

    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


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
