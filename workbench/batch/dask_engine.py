"""The engine on Dask workers: it hands out one piece per worker at a time, and looks after the
workers meanwhile.

Dask pauses a worker at 80 % of its memory, ends it at 95 %, and leaves the rest to us: a paused
worker is replaced.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from concurrent.futures import wait as wait_for
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerodima.workbench.batch.dask_cluster import (
    Worker,
    do_piece,
    get_ready,
    local_cluster,
    quiet_logs,
    remote_cluster,
)
from aerodima.workbench.batch.engine import Engine, Item, Result, Standstill, WorkerRecord
from aerodima.workbench.batch.row_store import ProgressLine, print_progress
from aerodima.workbench.core.errors import UserError

if TYPE_CHECKING:
    from distributed import Client, Future

MOST_WORKERS = 64
"""Processes on one computer."""
LOOK_EVERY = 1.0
"""s, between two looks at the workers."""
STOPPED_LOOKS = 5
"""So many looks in a row must find a process stopped (SIGSTOP) before it is killed and replaced."""
PAUSED_LOOKS = 5
"""So many looks in a row must find a paused worker idle although it has a piece before it is
replaced."""
RETIRED_FOR = 60.0
"""s; a worker that is still there so long after it was given up is a worker again."""
RESULT_WITHIN = 30.0
"""s; a result that a worker does not hand over in this time is lost, and its piece is made once
more."""
WORKER_WITHIN = 300.0
"""s; without any worker for so long the study ends."""
ANSWER_WITHIN = 30.0
"""s, for an answer of the scheduler."""
DEATHS_AT_THE_START = 3
"""Workers, and as many for each that works, that may die before any piece is done: then it is not
the pieces' fault."""


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
    """Worker processes on this computer, or those of a Dask cluster.

    Args:
        workers: processes to start here, one BLAS thread each; not used with a scheduler.
        scheduler: address of a running Dask scheduler, such as `tcp://127.0.0.1:8786`. Its workers
            need this package.
        progress: receives what happens to workers, a line each; stderr by default.
        record: file for the same; usually `WORKER_RECORD` in the folder of the study.
        memory: limit of each process here, bytes; by default an equal share of this computer's.
        module: that a worker imports before its first piece.

    Raises:
        UserError: wrong number of workers; no scheduler at that address, or one without workers.
    """
    if scheduler is None:
        check_workers(workers)
    start = time.monotonic()
    kept = WorkerRecord(progress, None if record is None else Path(record))
    if scheduler is None:
        client_of = local_cluster(workers, memory)
    else:
        client_of = remote_cluster(scheduler)
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
    progress: ProgressLine = print_progress,
    record: Path | None = None,
) -> list[Result]:
    """`Engine.map` on an engine for these items; one worker, or one item, runs in this process."""
    check_workers(workers)
    number = min(workers, len(items))
    alone = nullcontext(Engine(progress, record))
    with alone if number <= 1 else open_engine(number, progress=progress, record=record) as engine:
        return engine.map(work, items, done, lost)


def check_workers(workers: int) -> None:
    """Raises UserError unless there are 1 to `MOST_WORKERS` workers."""
    if not 1 <= workers <= MOST_WORKERS:
        raise UserError(f"--workers {workers}: allowed: 1 to {MOST_WORKERS}")


class DaskEngine(Engine):
    """On the workers of a Dask client; made by `open_engine`."""

    def __init__(
        self, client: Client, record: WorkerRecord, *, is_local: bool, module: str | None
    ) -> None:
        self._client = client
        self._record = record
        self._is_local = is_local
        self._module = module
        self._workers: dict[str, Worker] = {}
        self._retired: dict[str, float] = {}
        """Address -> when a worker that the scheduler may still list was given up; monotonic, s."""
        self._looked = -LOOK_EVERY
        self._staffed = time.monotonic()
        self._deaths = 0
        self._worked = False
        self._under_way: dict[Future, tuple[str, int | None]] = {}
        """Address of the worker, and the place of the piece; None while the worker gets ready."""
        self._dead: list[int] = []
        self._again: list[int] = []
        self._still = Standstill(record, self._where)

    def wait_until_ready(self) -> None:
        """Until every worker that is there has imported what it needs."""
        while self._under_way or not self._workers:
            self._look()
            for future in self._ended():
                self._take(future)

    def map(
        self,
        work: Callable[[Any], Any],
        items: Sequence[Any],
        done: Callable[[int, Any], None] | None = None,
        lost: Callable[[Any], Any] | None = None,
    ) -> list[Any]:
        """See `Engine`."""
        waiting = deque(range(len(items)))
        suspects = deque[int]()
        results: dict[int, Any] = {}
        given_up = list[int]()
        died = set[int]()
        self._still = Standstill(self._record, self._where)
        self._staffed = time.monotonic()

        def keep(place: int, result: Any) -> None:
            results[place] = result
            if done is not None:
                done(place, result)

        try:
            while len(results) + len(given_up) < len(items):
                self._look()
                self._hand_out(work, items, waiting or suspects, alone=not waiting)
                for future in self._ended():
                    place, result = self._take(future)
                    if place is not None:
                        keep(place, result)
                waiting.extendleft(self._again)
                for place in self._dead:
                    if place not in died:
                        died.add(place)
                        suspects.append(place)
                        continue
                    self._record.event(
                        "given_up",
                        f"given up, lost twice with its worker: {str(items[place])[:200]}",
                    )
                    if lost is None:
                        given_up.append(place)
                    else:
                        keep(place, lost(items[place]))
                self._again = []
                self._dead = []
        finally:
            self._drop()
        if given_up:
            raise UserError(
                f"{len(given_up)} of {len(items)} pieces were lost twice with their worker process "
                f"(out of memory?), the first is {items[min(given_up)]!r}; the others are done"
            )
        return [results[index] for index in range(len(items))]

    def _drop(self) -> None:
        """Forgets all pending runs, without a word to the user."""
        for future in [
            future for future, (_, place) in self._under_way.items() if place is not None
        ]:
            self._forget_future(future, self._again)
        self._again = []
        self._dead = []

    def _hand_out(
        self, work: Callable[[Any], Any], items: Sequence[Any], source: deque[int], alone: bool
    ) -> None:
        """One piece for every free thread; with `alone` one piece and nothing beside it."""
        for address, worker in list(self._workers.items()):
            busy = sum(address == where for where, _ in self._under_way.values())
            while source and busy < worker.threads and worker.pid and worker.status == "running":
                if alone and any(place is not None for _, place in self._under_way.values()):
                    return
                place = source.popleft()
                self._submit(address, place, do_piece, work, items[place])
                busy += 1

    def _submit(
        self, address: str, place: int | None, function: Callable[..., Any], *arguments: Any
    ) -> None:
        future = self._client.submit(function, *arguments, workers=[address], pure=False, retries=0)
        self._under_way[future] = address, place

    def _ended(self) -> list[Future]:
        """Futures that have ended, after waiting for the first of them until the next look."""
        from distributed import wait

        if not self._under_way:
            time.sleep(0.1)
            return []
        try:
            wait(list(self._under_way), timeout=LOOK_EVERY, return_when="FIRST_COMPLETED")
        except TimeoutError:
            return []
        return [future for future in self._under_way if future.done()]

    def _take(self, future: Future) -> tuple[int | None, Any]:
        """Place and result of a piece that has ended; no place if there is no result to keep."""
        from distributed import KilledWorker

        if future not in self._under_way:
            return None, None
        address, place = self._under_way[future]
        try:
            fetched = self._fetch(future)
        except KilledWorker:
            self._lost(address)
            return None, None
        # This happens when the connection to the scheduler was lost for a moment.
        except CancelledError as error:
            self._record.event("taken_back", f"Dask took a run back ({error}): it is made again")
            self._forget_future(future, self._again)
            return None, None
        if fetched is None:
            return None, None
        result, seconds, pid, memory = fetched
        del self._under_way[future]
        future.release()
        worker = self._workers.get(address)
        if worker is not None:
            worker.pid = pid
            if place is not None:
                worker.pieces += 1
                worker.memory = memory
        if place is not None:
            self._worked = True
            self._still.ended(seconds)
        return place, result

    def _fetch(self, future: Future) -> tuple[Any, float, int, int] | None:
        """What `do_piece` returned; None once it is lost and its piece was taken back.

        A worker that dies between the end of a piece and this call takes the result with it. The
        scheduler then keeps the piece for that worker alone, so the future would wait forever.
        """
        loop: Any = self._client.loop
        # One call serves all looks: it may need several.
        gather: Any = self._client.gather([future], asynchronous=True)
        gathering = asyncio.run_coroutine_threadsafe(gather, loop.asyncio_loop)
        until = time.monotonic() + RESULT_WITHIN
        try:
            while future in self._under_way:
                if wait_for([gathering], timeout=LOOK_EVERY).done:
                    fetched: tuple[Any, float, int, int] = gathering.result()[0]
                    return fetched
                self._look()
                if future in self._under_way and time.monotonic() > until:
                    text = (
                        f"the result of a run did not arrive within {RESULT_WITHIN:g} s: the "
                        "run is made once more"
                    )
                    self._record.event("taken_back", text)
                    self._forget_future(future, self._dead)
            return None
        finally:
            gathering.cancel()

    def _look(self) -> None:
        """Finds out which workers are new, gone, paused or stopped, and acts on it; at most every
        `LOOK_EVERY`.
        """
        if time.monotonic() - self._looked < LOOK_EVERY:
            return
        self._looked = time.monotonic()
        # Not `scheduler_info`: the client's own refresh may put an answer without workers in its
        # place.
        ask: Any = self._client.scheduler.identity
        present: dict[str, Any] = self._asked(ask, n_workers=-1, callback_timeout=ANSWER_WITHIN)[
            "workers"
        ]
        oldest = self._looked - RETIRED_FOR  # a new worker may get the port of an old one
        self._retired = {
            where: at for where, at in self._retired.items() if where in present and at > oldest
        }
        for address in [address for address in self._workers if address not in present]:
            self._lost(address)
        for address, facts in present.items():
            if address in self._retired:
                continue
            if address not in self._workers:
                self._workers[address] = Worker(
                    str(facts["name"]),
                    facts["nthreads"],
                    float(facts["memory_limit"] or 0),
                    bool(facts["nanny"]),
                )
            if not self._workers[address].pid and not self._has_piece(address):
                self._submit(address, None, get_ready, self._module)
            self._check(address, facts)
        if self._workers:
            self._staffed = self._looked
        elif self._looked - self._staffed > WORKER_WITHIN:
            raise UserError(f"no worker process for {WORKER_WITHIN:g} s; what was done is kept")
        self.workers = max(self.workers, sum(worker.threads for worker in self._workers.values()))
        self._still.look()

    def _check(self, address: str, facts: dict[str, Any]) -> None:
        """Whether a worker is paused by Dask, or its process stopped."""
        worker = self._workers[address]
        metrics = facts.get("metrics", {})
        if facts["status"] == "paused":
            worker.memory = metrics.get("memory", worker.memory)
            if worker.status != "paused":
                self._tell("paused", worker, f"{worker} is paused by Dask: it holds {worker.held}")
        worker.status = facts["status"]
        has_piece = self._has_piece(address)
        if has_piece and metrics.get("task_counts", {}).get("executing"):
            worker.idle = 0
        else:
            worker.idle += 1
        if worker.status == "paused" and worker.idle >= (PAUSED_LOOKS if has_piece else 1):
            self._replace_paused(address)
        elif self._is_local and worker.is_stopped():
            worker.stopped += 1
            if worker.stopped >= STOPPED_LOOKS:
                text = (
                    f"{worker} has been stopped for {STOPPED_LOOKS * LOOK_EVERY:g} s: it is "
                    "killed and replaced"
                )
                self._replace(address, "stopped", text + ", its run is made again")
        else:
            worker.stopped = 0

    def _has_piece(self, address: str) -> bool:
        return any(address == where for where, _ in self._under_way.values())

    def _replace_paused(self, address: str) -> None:
        worker = self._workers[address]
        if not worker.pieces:
            self._death(f"{worker} is paused before it has ended a single run")
        if worker.has_nanny:
            self._replace(
                address,
                "replaced",
                f"{worker} is replaced after {worker.pieces} runs: it was paused",
            )
        elif worker.idle % 60 == PAUSED_LOOKS:
            self._tell(
                "still",
                worker,
                f"{worker} is paused and cannot be replaced: it was started without a nanny",
            )

    def _replace(self, address: str, kind: str, text: str) -> None:
        """Ends a worker; its nanny starts another, which the next look finds.

        What it worked on is done again.
        """
        worker = self._workers.pop(address)
        self._retired[address] = time.monotonic()
        self._tell(kind, worker, text)
        self._forget(address, self._again)
        restart: Any = self._client.scheduler.restart_workers
        self._asked(
            restart,
            workers=[address],
            timeout=30.0,
            wait_for_workers=False,
            on_error="return",
            stimulus_id=f"workbench-replaces-{time.time()}",
            callback_timeout=2.0 * ANSWER_WITHIN,
        )

    def _asked(self, question: Any, **arguments: Any) -> Any:
        """The scheduler's answer; UserError without one."""
        try:
            return self._client.sync(question, **arguments)
        except (OSError, TimeoutError) as error:
            raise UserError(f"the Dask scheduler does not answer any more ({error})") from None

    def _lost(self, address: str) -> None:
        worker = self._workers.pop(address)
        self._retired[address] = time.monotonic()
        if worker.memory:
            held = f" (it held {worker.held})"
        else:
            held = ""
        had_piece = any(
            address == where and place is not None for where, place in self._under_way.values()
        )
        ending = "; its run is made again" if had_piece else ""
        self._tell("lost", worker, f"{worker} was lost after {worker.pieces} runs{held}{ending}")
        self._forget(address, self._dead)
        self._death(f"{worker} was lost")

    def _forget(self, address: str, places: list[int]) -> None:
        """Takes back what a worker had; its pieces join `places`."""
        for future in [
            future for future, (where, _) in self._under_way.items() if where == address
        ]:
            self._forget_future(future, places)

    def _forget_future(self, future: Future, places: list[int]) -> None:
        _, place = self._under_way.pop(future)
        self._client.cancel([future], force=True)
        if place is not None:
            places.append(place)

    def _death(self, text: str) -> None:
        self._deaths += 1
        if not self._worked and self._deaths >= DEATHS_AT_THE_START * self.workers:
            raise UserError(
                f"workers died {self._deaths} times before any run was done, the last: {text}"
            )

    def _tell(self, kind: str, worker: Worker, text: str) -> None:
        self._record.event(
            kind,
            text,
            worker=worker.name,
            process=worker.pid,
            runs=worker.pieces,
            memory_bytes=worker.memory,
        )

    def _where(self) -> str:
        busy = [
            str(worker) for address, worker in self._workers.items() if self._has_piece(address)
        ]
        if busy:
            return f"; at work: {', '.join(busy)}"
        return "; no worker is there"
