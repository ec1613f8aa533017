"""Many independent pieces of work in worker processes, with progress; Ctrl-C lets the pieces under way finish.

A killed worker (out of memory, a crash in native code) costs only the pieces under way: each of them is tried again
with nothing beside it, so that a piece that kills its worker is found and the others go on.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Generic, TypeVar

from workbench.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_WORKERS = 64
MOST_LOST_AT_THE_START = 3
"""Pieces that may kill their worker, alone, before any piece has succeeded: then it is not the pieces' fault."""
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
    lost: Callable[[Item], Result] | None = None,
) -> list[Result]:
    """Results of `work(item)` in the order of the items.

    With one worker everything happens in this process; with more each has a process of its own, started afresh (not
    forked) and with one BLAS thread. The first error of `work`, and Ctrl-C, cancel what has not begun and wait for what
    has. When a worker is killed, the pieces that were under way are tried once more, one at a time; a piece whose
    worker dies then too is given up and the others go on.

    Args:
        work: function of a module, so that a process can import it.
        items: what to work on; they and the results must pickle.
        workers: number of processes.
        done: told the number of finished items and the newest result, in the order in which they finish.
        lost: makes the result of an item that was given up; without it a given-up item is an error after all others.

    Raises:
        UserError: wrong number of workers; items were given up and there is no `lost`; or the first three items all
            killed their workers.
        Exception: whatever `work` raises.
    """
    check_workers(workers)
    if min(workers, len(items)) <= 1:
        return _one_by_one(work, items, done)
    with _one_thread_each():
        spread = _Spread(work, items, workers, done, lost)
        try:
            spread.run()
        finally:
            spread.pool.shutdown(wait=True, cancel_futures=True)
    if spread.given_up:
        raise UserError(
            f"{len(spread.given_up)} of {len(items)} pieces killed their worker process (out of memory?), the first is "
            f"{items[min(spread.given_up)]!r}; the others are done"
        )
    return [spread.results[place] for place in range(len(items))]


class _Spread(Generic[Item, Result]):
    """The state of one batch over processes.

    Attributes:
        pool: of the workers; a new one after a worker was killed.
        results: by place of the item.
        given_up: places of items whose worker was killed although nothing ran beside it, and without a result.
    """

    def __init__(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        workers: int,
        done: Callable[[int, Result], None] | None,
        lost: Callable[[Item], Result] | None,
    ) -> None:
        self._work, self._items, self._done, self._lost = work, items, done, lost
        self._workers = min(workers, len(items))
        self._waiting = deque(range(len(items)))
        self._suspects: deque[int] = deque()
        self._under_way: dict[Future[Result], int] = {}
        self._killers = 0
        self._worked = False
        self.pool = self._new_pool()
        self.results: dict[int, Result] = {}
        self.given_up: list[int] = []

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._workers, get_context("spawn"), initializer=_leave_ctrl_c_to_parent)

    def run(self) -> None:
        """Until every item has a result or is given up."""
        while self._waiting or self._suspects or self._under_way:
            alone = bool(self._suspects)
            killed = not self._submit(alone)
            finished = wait(self._under_way, return_when=FIRST_COMPLETED).done
            killed |= any(isinstance(future.exception(), BrokenProcessPool) for future in finished)
            if killed:
                finished = wait(self._under_way).done  # a broken pool ends all of its pieces
            dead = [place for future in finished if (place := self._take(future)) is not None]
            if killed:
                self.pool.shutdown(wait=True, cancel_futures=True)
                self.pool = self._new_pool()
            if alone and dead:
                self._give_up(dead[0])
            else:
                self._suspects.extend(dead)

    def _submit(self, alone: bool) -> bool:
        """Hands out a suspect with nothing beside it, or as many pieces as there are workers; False: the pool broke."""
        source, room = (self._suspects, 1) if alone else (self._waiting, self._workers)
        while source and len(self._under_way) < room:
            try:
                future = self.pool.submit(self._work, self._items[source[0]])
            except BrokenProcessPool:  # an idle worker was killed
                return False
            self._under_way[future] = source.popleft()
        return True

    def _take(self, future: Future[Result]) -> int | None:
        """Keeps the result of a finished piece; the place of one whose worker was killed."""
        place = self._under_way.pop(future)
        try:
            result = future.result()
        except BrokenProcessPool:
            return place
        self._worked = True
        self._keep(place, result)
        return None

    def _keep(self, place: int, result: Result) -> None:
        self.results[place] = result
        if self._done is not None:
            self._done(len(self.results), result)

    def _give_up(self, place: int) -> None:
        self._killers += 1
        if not self._worked and self._killers >= MOST_LOST_AT_THE_START:
            raise UserError(
                f"worker processes were killed {self._killers} times before any of {len(self._items)} pieces was done "
                "(out of memory?)"
            )
        if self._lost is None:
            self.given_up.append(place)
        else:
            self._keep(place, self._lost(self._items[place]))


def _one_by_one(
    work: Callable[[Item], Result], items: Sequence[Item], done: Callable[[int, Result], None] | None
) -> list[Result]:
    results = []
    for item in items:
        results.append(work(item))
        if done is not None:
            done(len(results), results[-1])
    return results


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
