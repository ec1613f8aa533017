"""Many independent pieces of work in worker processes, with progress; Ctrl-C lets the pieces under way finish."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

from workbench.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_WORKERS = 64
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def check_workers(workers: int) -> None:
    """Raises UserError unless there are 1 to `MOST_WORKERS` workers."""
    if not 1 <= workers <= MOST_WORKERS:
        raise UserError(f"--workers {workers}: allowed: 1 to {MOST_WORKERS}")


def run_batch(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    done: Callable[[int, Result], None] | None = None,
) -> list[Result]:
    """Results of `work(item)` in the order of the items.

    With one worker everything happens in this process; with more each has a process of its own, started afresh (not
    forked) and with one BLAS thread. The first error, and Ctrl-C, cancel what has not begun and wait for what has.

    Args:
        work: function of a module, so that a process can import it.
        items: what to work on; they and the results must pickle.
        workers: number of processes.
        done: told the number of finished items and the newest result, in the order in which they finish.

    Raises:
        UserError: wrong number of workers, or a worker process was killed from outside.
        Exception: whatever `work` raises.
    """
    check_workers(workers)
    if min(workers, len(items)) <= 1:
        return _one_by_one(work, items, done)
    results: dict[int, Result] = {}
    with _one_thread_each():
        pool = ProcessPoolExecutor(min(workers, len(items)), get_context("spawn"), initializer=_leave_ctrl_c_to_parent)
        try:
            futures: dict[Future[Result], int] = {pool.submit(work, item): place for place, item in enumerate(items)}
            for future in _as_they_finish(set(futures)):
                results[futures[future]] = future.result()
                if done is not None:
                    done(len(results), results[futures[future]])
        except BrokenProcessPool as error:
            raise UserError(
                f"a worker process was killed after {len(results)} of {len(items)} pieces (out of memory?)"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    return [results[place] for place in range(len(items))]


def _one_by_one(
    work: Callable[[Item], Result], items: Sequence[Item], done: Callable[[int, Result], None] | None
) -> list[Result]:
    results = []
    for item in items:
        results.append(work(item))
        if done is not None:
            done(len(results), results[-1])
    return results


def _as_they_finish(pending: set[Future[Result]]) -> Iterator[Future[Result]]:
    while pending:
        finished, pending = wait(pending, return_when=FIRST_COMPLETED)
        yield from finished


def _leave_ctrl_c_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Environment that the worker processes inherit; they read it when they import NumPy."""
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
