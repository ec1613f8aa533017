"""Engine on Dask workers: hands out one piece per thread, replaces workers that pause or stop.

Dask pauses a worker at 80 % of its memory, ends it at 95 %, and does no more: the engine replaces a
paused worker.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from concurrent.futures import wait as wait_for
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from aerodima.workbench.batch.dask_cluster import (
    Outcome,
    Work,
    Worker,
    kill_workers,
    local_workers,
    lost_scheduler,
    prepare_worker,
    run_piece,
    stopped_workers,
)
from aerodima.workbench.batch.engine import Engine, StallMonitor, WorkerRecord
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Json

if TYPE_CHECKING:
    import psutil
    from distributed import Client, Future

POLL_PERIOD = 1.0
"""Time between two polls of the workers, s."""
STOPPED_POLLS = 3
"""Polls from one search for stopped processes (SIGSTOP) to the next; one found twice is killed."""
PAUSED_POLLS = 5
"""Polls in a row that find a paused worker idle with a piece in hand before it is replaced."""
QUARANTINE = 60.0
"""Time for which the address of a worker that was given up is ignored, s."""
RESULT_TIMEOUT = 30.0
"""Time within which a worker hands over a result, s; after that its piece is made once more."""
WORKER_TIMEOUT = 300.0
"""Time without any worker after which the work ends, s."""
ABSENCE_TIME = 8.0
"""Time after which the lack of any worker is reported, s; again after each doubling."""
START_TIMEOUT = 120.0
"""Time after which workers that have not started are no longer waited for, s."""
SCHEDULER_TIMEOUT = 30.0
"""Time within which the scheduler answers, s."""
MAX_STARTUP_FAILURES = 3
"""Deaths per worker before any piece is done at which the work ends: the pieces are then not the
reason."""


class DaskEngine(Engine):
    """Engine on the workers of a Dask client; made by `open_engine`.

    Args:
        client: client of the scheduler.
        record: record of what happens to workers.
        is_local: whether the workers are processes of this one.
        module: name of a module that a worker imports before its first piece.
        others: processes of the workers of other engines, which are not waited for.
    """

    def __init__(
        self,
        client: Client,
        record: WorkerRecord,
        *,
        is_local: bool,
        module: str | None,
        others: set[int],
    ) -> None:
        self._client = client
        self._record = record
        self._is_local = is_local
        self._others = others
        self._module = module
        self._workers: dict[str, Worker] = {}
        self._retired: dict[str, float] = {}
        """Monotonic time (s), by address, when a worker that may still be listed was given up."""
        self._polled = -POLL_PERIOD
        self._staffed = time.monotonic()
        self._absence_limit = START_TIMEOUT
        self._stopped_due = 0.0
        self._stopped: set[psutil.Process] = set()
        self._started: set[int] = set()  # local processes that were seen
        self._failures = 0
        self._has_results = False
        self._pending: dict[Future, tuple[str, int | None]] = {}
        """Address of the worker, and index of the piece; None while the worker prepares itself."""
        self._orphans: list[int] = []
        """Indices of pieces whose worker died."""
        self._withdrawn: list[int] = []
        """Indices of pieces that are made again through no fault of their own."""
        self._stall = StallMonitor(record, self._busy_workers)

    def wait_until_ready(self, workers: int) -> None:
        """Wait until `workers` workers, or all but those that died while they started, have
        imported what they need; UserError if there is none within `START_TIMEOUT`.
        """
        until = time.monotonic() + START_TIMEOUT
        while time.monotonic() < until and (self._pending or not self._have_started(workers)):
            self._poll()
            for future in self._finished():
                self._collect(future)
        if not self._workers:
            raise UserError("no worker process has started; try again")
        if len(self._workers) < workers:
            started = f"{len(self._workers)} of {workers} workers have started"
            self._record.event("still", f"the work begins: {started}")

    def _have_started(self, workers: int) -> bool:
        """Return whether no more workers are to be waited for: a nanny gives up a process that dies
        while it starts.
        """
        if not self._is_local:
            return len(self._workers) >= workers
        alive = {process.pid for process in local_workers()} - self._others
        self._started |= alive
        return len(self._started) >= workers and len(self._workers) >= len(alive)

    def map(
        self,
        work: Work,
        items: Sequence[Any],
        done: Callable[[int, Any], None] | None = None,
        lost: Work | None = None,
    ) -> list[Any]:
        """Map items; see `Engine`."""
        waiting = deque(range(len(items)))
        suspects = deque[int]()
        results: dict[int, Any] = {}
        given_up = list[int]()
        orphaned = set[int]()
        self._stall = StallMonitor(self._record, self._busy_workers)
        self._staffed = time.monotonic()

        def keep(index: int, result: Any) -> None:
            results[index] = result
            if done is not None:
                done(index, result)

        try:
            while len(results) + len(given_up) < len(items):
                self._poll()
                self._assign(work, items, waiting or suspects, alone=not waiting)
                for future in self._finished():
                    piece = self._collect(future)
                    if piece is not None:
                        keep(*piece)
                waiting.extendleft(self._withdrawn)
                for index in self._orphans:
                    if index not in orphaned:
                        orphaned.add(index)
                        suspects.append(index)
                        continue
                    text = f"given up, lost twice with its worker: {str(items[index])[:200]}"
                    self._record.event("given_up", text)
                    if lost is None:
                        given_up.append(index)
                    else:
                        keep(index, lost(items[index]))
                self._clear_lost()
        finally:
            for future in self._pieces():
                self._withdraw(future, self._withdrawn)
            self._clear_lost()
        if given_up:
            raise UserError(
                f"{len(given_up)} of {len(items)} pieces were lost twice with their worker process "
                f"(out of memory?), the first is {items[min(given_up)]!r}; the others are done"
            )
        return [results[index] for index in range(len(items))]

    def _clear_lost(self) -> None:
        self._withdrawn = []
        self._orphans = []

    def _pieces(self) -> list[Future]:
        """List the futures of pieces, without those of workers that prepare themselves."""
        return [future for future, (_, index) in self._pending.items() if index is not None]

    def _futures_at(self, address: str) -> list[Future]:
        return [future for future, (where, _) in self._pending.items() if where == address]

    def _assign(self, work: Work, items: Sequence[Any], source: deque[int], alone: bool) -> None:
        """Hand out a piece for every free thread; with `alone` one piece and nothing beside it."""
        for address, worker in list(self._workers.items()):
            if not worker.pid or worker.status != "running":
                continue
            free = worker.threads - len(self._futures_at(address))
            for _ in range(min(free, len(source))):
                if alone and self._pieces():
                    return
                index = source.popleft()
                self._submit(address, index, run_piece, work, items[index])

    def _submit(
        self, address: str, index: int | None, function: Callable[..., Any], *arguments: Any
    ) -> None:
        from distributed.client import ClosedClientError

        options: Json = {"workers": [address], "pure": False, "retries": 0}
        try:
            future = self._client.submit(function, *arguments, **options)
        except ClosedClientError as error:
            raise lost_scheduler(error) from None
        self._pending[future] = address, index

    def _finished(self) -> list[Future]:
        """Wait for the first future to end, until the next poll; return all that have ended."""
        from distributed import wait

        if not self._pending:
            time.sleep(0.1)
            return []
        # Futures are cancelled when the scheduler is lost.
        with suppress(TimeoutError, CancelledError):
            wait(list(self._pending), timeout=POLL_PERIOD, return_when="FIRST_COMPLETED")
        return [future for future in self._pending if future.done()]

    def _collect(self, future: Future) -> tuple[int, Any] | None:
        """Return index and result of a piece that has ended; None if there is no result."""
        from distributed import KilledWorker

        if future not in self._pending:
            return None
        address, index = self._pending[future]
        outcome = None
        try:
            outcome = self._fetch(future)
        except KilledWorker:
            self._remove_lost(address)
        # This happens when the connection to the scheduler was lost for a moment.
        except CancelledError as error:
            self._record.event("taken_back", f"Dask took a run back ({error}): it is made again")
            self._withdraw(future, self._withdrawn)
        if outcome is None:
            return None
        result, seconds, pid, memory = outcome
        del self._pending[future]
        future.release()
        worker = self._workers.get(address)
        if worker is not None:
            worker.pid = pid
        if index is None:
            return None
        if worker is not None:
            worker.pieces += 1
            worker.memory = memory
        self._has_results = True
        self._stall.record_run(seconds)
        return index, result

    def _fetch(self, future: Future) -> Outcome | None:
        """Fetch what `run_piece` returned; None once it is lost and its piece was withdrawn.

        A worker that dies between the end of a piece and this call takes the result with it. The
        scheduler then keeps the piece for that worker alone, so the future would wait forever.
        """
        loop: Any = self._client.loop
        # One call serves all polls: it may need several.
        gather: Any = self._client.gather([future], asynchronous=True)
        gathering = asyncio.run_coroutine_threadsafe(gather, loop.asyncio_loop)
        until = time.monotonic() + RESULT_TIMEOUT
        try:
            while future in self._pending:
                if wait_for([gathering], timeout=POLL_PERIOD).done:
                    return gathering.result()[0]
                self._poll()
                if future in self._pending and time.monotonic() > until:
                    text = (
                        f"the result of a run did not arrive within {RESULT_TIMEOUT:g} s: the "
                        "run is made once more"
                    )
                    self._record.event("taken_back", text)
                    self._withdraw(future, self._orphans)
            return None
        finally:
            gathering.cancel()

    def _poll(self) -> None:
        """Find the workers that are new, gone, paused or stopped, and deal with them; at most every
        `POLL_PERIOD`.
        """
        now = time.monotonic()
        if now - self._polled < POLL_PERIOD:
            return
        self._polled = now
        # Not `scheduler_info`: the client's own refresh may replace it by an answer without
        # workers.
        answer = self._ask("identity", n_workers=-1, callback_timeout=SCHEDULER_TIMEOUT)
        present: Json = answer["workers"]
        # A new worker may get the port of an old one.
        self._retired = {
            address: retired
            for address, retired in self._retired.items()
            if address in present and retired > now - QUARANTINE
        }
        for address in self._workers.keys() - present.keys():
            self._remove_lost(address)
        for address, facts in present.items():
            if address not in self._retired:
                self._update(address, facts)
        absent = now - self._staffed
        if self._workers:
            self._staffed = now
            self._absence_limit = ABSENCE_TIME
        elif absent > WORKER_TIMEOUT:
            raise UserError(f"no worker process for {WORKER_TIMEOUT:g} s; what was done is kept")
        elif absent > self._absence_limit:
            self._absence_limit = 2.0 * absent
            text = f"no worker process for {absent:.0f} s; after {WORKER_TIMEOUT:g} s the work ends"
            self._record.event("still", text)
        if self._is_local and now > self._stopped_due:
            self._stopped_due = now + STOPPED_POLLS * POLL_PERIOD
            self._kill_stopped()
        threads = sum(worker.threads for worker in self._workers.values())
        self.workers = max(self.workers, threads)
        self._stall.poll()

    def _kill_stopped(self) -> None:
        """Kill the processes that have been stopped since the last search; a nanny replaces each,
        unless it was the first one to start there.
        """
        stopped = stopped_workers()
        lasting = stopped & self._stopped
        self._stopped = stopped
        kill_workers(lasting)
        addresses = {worker.pid: address for address, worker in self._workers.items()}
        for process in lasting:
            address = addresses.get(process.pid)
            if address is None:
                text = f"a worker (process {process.pid}) was stopped at its start: it is killed"
                self._record.event("stopped", text, process=process.pid)
            else:
                text = f"{self._workers[address]} was stopped: it is killed and replaced"
                self._retire(address, "stopped", text, self._orphans)

    def _update(self, address: str, facts: Json) -> None:
        """Prepare a worker that is new; replace one that Dask paused."""
        if address not in self._workers:
            self._workers[address] = Worker(
                str(facts["name"]),
                facts["nthreads"],
                float(facts["memory_limit"] or 0),
                bool(facts["nanny"]),
            )
        worker = self._workers[address]
        if not worker.pid and not self._futures_at(address):
            self._submit(address, None, prepare_worker, self._module)
        metrics = facts.get("metrics", {})
        if facts["status"] == "paused":
            worker.memory = metrics.get("memory", worker.memory)
            if worker.status != "paused":
                text = f"{worker} is paused by Dask: it holds {worker.held}"
                self._record_event("paused", worker, text)
        worker.status = facts["status"]
        has_piece = bool(self._futures_at(address))
        is_executing = has_piece and metrics.get("task_counts", {}).get("executing")
        worker.idle = 0 if is_executing else worker.idle + 1
        if worker.status == "paused" and worker.idle >= (PAUSED_POLLS if has_piece else 1):
            self._replace_paused(address)

    def _replace_paused(self, address: str) -> None:
        """End a paused worker; its nanny starts another, which the next poll finds.

        What it worked on is done again.
        """
        worker = self._workers[address]
        if not worker.pieces:
            self._count_failure(f"{worker} is paused before it has ended a single run")
        if not worker.has_nanny:
            if worker.idle % 60 == PAUSED_POLLS:
                text = f"{worker} is paused and cannot be replaced: it was started without a nanny"
                self._record_event("still", worker, text)
            return
        text = f"{worker} is replaced after {worker.pieces} runs: it was paused"
        self._retire(address, "replaced", text, self._withdrawn)
        self._ask(
            "restart_workers",
            workers=[address],
            timeout=30.0,
            wait_for_workers=False,
            on_error="return",
            stimulus_id=f"workbench-replaces-{time.time()}",
            callback_timeout=2.0 * SCHEDULER_TIMEOUT,
        )

    def _ask(self, question: str, **arguments: Any) -> Any:
        """Return the scheduler's answer; UserError if there is none."""
        scheduler: Any = self._client.scheduler
        try:
            return self._client.sync(getattr(scheduler, question), **arguments)
        except Exception as error:  # Dask has many for a connection that is closed
            raise lost_scheduler(error) from None

    def _remove_lost(self, address: str) -> None:
        worker = self._workers[address]
        text = f"{worker} was lost after {worker.pieces} runs"
        if worker.memory:
            text += f" (it held {worker.held})"
        if set(self._pieces()) & set(self._futures_at(address)):
            text += "; its run is made again"
        self._retire(address, "lost", text, self._orphans)
        self._count_failure(f"{worker} was lost")

    def _retire(self, address: str, kind: str, text: str, indices: list[int]) -> None:
        """Strike a worker off; its pieces join `indices`."""
        worker = self._workers.pop(address)
        self._retired[address] = time.monotonic()
        self._record_event(kind, worker, text)
        for future in self._futures_at(address):
            self._withdraw(future, indices)

    def _withdraw(self, future: Future, indices: list[int]) -> None:
        """Cancel a future; its piece joins `indices`."""
        _, index = self._pending.pop(future)
        with suppress(Exception):  # a scheduler that is lost has nothing to cancel
            self._client.cancel([future], force=True)
        if index is not None:
            indices.append(index)

    def _count_failure(self, text: str) -> None:
        self._failures += 1
        if not self._has_results and self._failures >= MAX_STARTUP_FAILURES * self.workers:
            raise UserError(
                f"workers died {self._failures} times before any run was done, the last: {text}"
            )

    def _record_event(self, kind: str, worker: Worker, text: str) -> None:
        self._record.event(
            kind,
            text,
            worker=worker.name,
            process=worker.pid,
            runs=worker.pieces,
            memory_bytes=worker.memory,
        )

    def _busy_workers(self) -> str:
        busy = [str(one) for where, one in self._workers.items() if self._futures_at(where)]
        return f"; at work: {', '.join(busy) or 'no worker'}"
