"""Workers that are lost, paused, stopped, full or idle: said, kept in the record, and no run lost
or made twice.
"""

import asyncio
import gc
import itertools
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
import time
import weakref
from contextlib import ExitStack
from functools import partial
from multiprocessing import util

import dask
import pytest
from distributed import Client

from aerodima.workbench.batch import dask_cluster, dask_engine
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.engine_factory import open_engine
from aerodima.workbench.batch.row_store import WORKER_RECORD
from aerodima.workbench.core.errors import UserError
from tests.refusals import assert_refused

MEGABYTE = 1_000_000
LIMIT = 400 * MEGABYTE
_kept = []


def leak(marks, size, pause, number):
    """Leaves a mark with its process, and `size` bytes that are never freed, in the way of an
    immortal diagram.
    """
    with (marks / str(number)).open("a") as stream:
        stream.write(f"{os.getpid()}\n")
    if size:
        _kept.append(bytearray(os.urandom(size)))
    time.sleep(pause)
    return number * number


def processes(marks):
    """Run -> the processes that began it."""
    return {
        int(path.name): [int(line) for line in path.read_text().split()] for path in marks.iterdir()
    }


@pytest.fixture
def marks(tmp_path):
    (tmp_path / "marks").mkdir()
    return tmp_path / "marks"


@pytest.fixture
def opened(tmp_path):
    """Opens an engine; gives it and the lines that it says."""
    with ExitStack() as stack:

        def open_(workers=2):
            said = []
            engine = stack.enter_context(
                open_engine(
                    workers, memory=LIMIT, progress=said.append, record=tmp_path / WORKER_RECORD
                )
            )
            return engine, said

        yield open_


def recorded(folder):
    path = folder / WORKER_RECORD
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def once_running(marks, number, act):
    """Acts on the process of a run as soon as that has begun."""

    def wait():
        while not (path := marks / str(number)).exists() or not path.read_text().endswith("\n"):
            time.sleep(0.01)
        act(processes(marks)[number][0])

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


@pytest.mark.slow
def test_quiet_work_says_nothing_and_leaves_no_record(opened, marks, tmp_path, monkeypatch):
    """A process of the caller's own that is stopped is none of the engine's business."""
    monkeypatch.setattr(dask_engine, "POLL_PERIOD", 0.1)
    monkeypatch.setattr(dask_engine, "STOPPED_POLLS", 1)
    own = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60.0,))
    own.start()
    os.kill(own.pid, signal.SIGSTOP)
    engine, said = opened()
    work = partial(leak, marks, 0, 0.1)
    assert engine.map(work, range(20)) == Engine().map(work, range(20))
    assert (said, engine.events, recorded(tmp_path)) == ([], {}, [])
    assert own.is_alive()
    own.kill()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (signal.SIGKILL, "lost"),
        (signal.SIGSTOP, "stopped"),
    ],
)
def test_a_worker_killed_or_stopped_is_said_and_only_its_run_is_made_again(
    opened, marks, tmp_path, monkeypatch, number, kind
):
    monkeypatch.setattr(dask_engine, "STOPPED_POLLS", 2)
    engine, said = opened()
    signals = once_running(marks, 4, lambda pid: os.kill(pid, number))
    assert engine.map(partial(leak, marks, 0, 0.3), range(12)) == [n * n for n in range(12)]
    signals.join()
    assert {piece for piece, pids in processes(marks).items() if len(pids) > 1} == {4}
    (event,) = recorded(tmp_path)
    assert (event["event"], event["process"]) == (kind, processes(marks)[4][0])
    assert f"process {event['process']}" in said[0]


def stop_itself(number):
    if number == 1:
        os.kill(os.getpid(), signal.SIGSTOP)
    return number


@pytest.mark.slow
def test_a_run_that_stops_its_worker_is_given_up_after_two(opened, monkeypatch):
    monkeypatch.setattr(dask_engine, "STOPPED_POLLS", 2)
    engine, _ = opened(1)
    assert engine.map(stop_itself, range(3), lost=lambda number: -number) == [0, -1, 2]
    assert engine.events == {"stopped": 2, "given_up": 1}


@pytest.fixture
def left_behind():
    """A process of the kind of a worker, as another engine or one that did not end has it."""
    idle = "import time; time.sleep(300)  # from multiprocessing.spawn import spawn_main"
    with subprocess.Popen([sys.executable, "-c", idle]) as left:
        yield
        left.kill()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("workers", "number", "delay"),
    [
        (1, signal.SIGSTOP, 0.3),
        (2, signal.SIGSTOP, 0.0),
        (2, signal.SIGSTOP, 0.3),
        (2, signal.SIGKILL, 0.3),
    ],
)
def test_a_worker_that_is_stopped_or_killed_while_it_starts_is_not_waited_for(
    opened, monkeypatch, tmp_path, left_behind, workers, number, delay
):
    monkeypatch.setattr(dask_engine, "STOPPED_POLLS", 1)
    spawn = util.spawnv_passfds
    hit = []

    def spawn_and_hit_first(path, arguments, descriptors):
        pid = spawn(path, arguments, descriptors)
        if not hit and "--multiprocessing-fork" in map(os.fsdecode, arguments):
            hit.append(pid)
            time.sleep(delay)
            os.kill(pid, number)
        return pid

    monkeypatch.setattr(util, "spawnv_passfds", spawn_and_hit_first)
    if workers == 1:
        assert_refused(lambda: opened(1), UserError, "no worker")
    else:
        engine, said = opened(2)
        assert engine.startup < dask_engine.START_TIMEOUT
        assert engine.map(int, range(4)) == [0, 1, 2, 3]
        assert "1 of 2 workers" in said[-1]
    stopped = [event["process"] for event in recorded(tmp_path) if event["event"] == "stopped"]
    assert stopped == hit * (number == signal.SIGSTOP)


@pytest.mark.slow
def test_a_worker_of_another_engine_is_not_waited_for(opened, monkeypatch, left_behind):
    monkeypatch.setattr(dask_engine, "START_TIMEOUT", 60.0)
    engine, said = opened(2)
    assert engine.startup < dask_engine.START_TIMEOUT
    assert engine.map(int, range(4)) == [0, 1, 2, 3]
    assert not said


@pytest.mark.slow
def test_result_that_dies_with_its_worker_is_made_again(opened, marks, tmp_path, monkeypatch):
    """The worker is killed after it has ended a piece and before the result is fetched."""
    engine, said = opened(2)
    ended = type(engine)._finished
    killed = list[int]()

    def kill_before_fetching(self):
        found = ended(self)
        with_pieces = [future for future in found if self._pending[future][1] is not None]
        if with_pieces and not killed:
            address, place = self._pending[with_pieces[0]]
            killed.extend(processes(marks)[place])
            os.kill(killed[0], signal.SIGKILL)
            until = time.monotonic() + 10.0
            while with_pieces[0].done() and time.monotonic() < until:
                time.sleep(0.01)
            assert not with_pieces[0].done(), f"the scheduler has not noticed that {address} died"
        return found

    monkeypatch.setattr(type(engine), "_finished", kill_before_fetching)
    assert engine.map(partial(leak, marks, 0, 0.05), range(6)) == [n * n for n in range(6)]
    assert len(killed) == 1
    assert [event["event"] for event in recorded(tmp_path)] == ["lost"]
    assert f"process {killed[0]}" in said[0]


def late_transfers(monkeypatch, delays):
    """Lets the first results that are fetched travel so long (s) each."""
    gather = Client.gather

    async def late(client, delay, futures):
        await asyncio.sleep(delay)
        return await gather(client, futures, asynchronous=True)

    def patched(self, futures, **options):
        return late(self, delays.pop(0), futures) if delays else gather(self, futures, **options)

    monkeypatch.setattr(Client, "gather", patched)


def test_result_that_does_not_arrive_is_made_again(opened, marks, monkeypatch):
    monkeypatch.setattr(dask_engine, "RESULT_TIMEOUT", 0.4)
    monkeypatch.setattr(dask_engine, "POLL_PERIOD", 0.2)
    engine, said = opened(1)
    late_transfers(monkeypatch, [60.0])
    assert engine.map(partial(leak, marks, 0, 0.0), range(3)) == [0, 1, 4]
    assert [len(pids) for _, pids in sorted(processes(marks).items())].count(2) == 1
    assert len(said) == 1
    assert "0.4 s" in said[0]
    assert engine.events == {"taken_back": 1}


def test_result_that_never_arrives_is_given_up_after_two_runs(opened, marks, monkeypatch):
    monkeypatch.setattr(dask_engine, "RESULT_TIMEOUT", 0.4)
    monkeypatch.setattr(dask_engine, "POLL_PERIOD", 0.2)
    engine, _ = opened(1)
    late_transfers(monkeypatch, [60.0, 60.0])
    work = partial(engine.map, partial(leak, marks, 0, 0.0), range(1))
    assert_refused(work, UserError, "1 of 1")
    assert len(processes(marks)[0]) == 2
    assert engine.events == {"taken_back": 2, "given_up": 1}


def test_study_ends_when_no_worker_is_there_for_long(opened, marks, monkeypatch):
    monkeypatch.setattr(dask_engine, "POLL_PERIOD", 0.1)
    monkeypatch.setattr(dask_engine, "ABSENCE_TIME", 0.2)
    engine, said = opened(1)
    monkeypatch.setattr(dask_engine, "WORKER_TIMEOUT", 0.9)
    asked = type(engine)._ask
    monkeypatch.setattr(
        type(engine),
        "_ask",
        lambda self, *args, **options: asked(self, *args, **options) | {"workers": {}},
    )
    work = partial(engine.map, partial(leak, marks, 0, 0.0), range(3))
    assert_refused(work, UserError, "0.9 s")
    assert "no worker process" in said[1]


def refuse_in_time(number):
    raise TimeoutError(f"piece {number} took too long")


def test_timeout_that_a_piece_raises_is_its_own_error(opened):
    engine, _ = opened(1)
    assert_refused(lambda: engine.map(refuse_in_time, range(2)), TimeoutError, "piece 0")


@pytest.mark.slow
@pytest.mark.nightly
def test_workers_that_dask_pauses_are_said_and_replaced_and_the_study_ends(
    opened, marks, tmp_path, monkeypatch
):
    monkeypatch.setattr(dask_engine, "PAUSED_POLLS", 2)
    with dask.config.set(
        {"distributed.worker.memory.pause": 0.45}
    ):  # before our own replacement at 0.7
        engine, said = opened()
        work = partial(leak, marks, 20 * MEGABYTE, 0.5)
        assert engine.map(work, range(24)) == [n * n for n in range(24)]
    assert all(len(pids) == 1 for pids in processes(marks).values())
    assert {event["event"] for event in recorded(tmp_path)} == {"paused", "replaced"}
    assert any("of 0.40 GB" in line for line in said)


@pytest.mark.slow
@pytest.mark.nightly
def test_workers_without_room_for_a_single_run_are_an_error(opened):
    no_room = dask.config.set(
        {
            "distributed.worker.memory.pause": 0.01,
            "distributed.worker.memory.monitor-interval": "10ms",
        }
    )
    with no_room:
        assert_refused(opened, UserError, "paused")


@pytest.mark.slow
@pytest.mark.parametrize("serial", [True, False])
def test_work_that_stands_still_says_so(opened, marks, monkeypatch, tmp_path, serial):
    monkeypatch.setattr("aerodima.workbench.batch.engine.MIN_STALL_TIME", 1.0)
    said = []
    if serial:
        engine = Engine(said.append, tmp_path / WORKER_RECORD)
    else:
        engine, said = opened(1)
    assert engine.map(sleep_long_at_three, range(5)) == list(range(5))
    assert re.search(r"[12] s .*0\.0\d* s", said[0])
    assert 1 <= engine.events["still"] <= 3
    assert all(event["event"] == "still" for event in recorded(tmp_path))


def sleep_long_at_three(number):
    time.sleep(4.0 if number == 3 else 0.05)
    return number


class _Cycle:
    """Garbage that only the collector frees."""

    def __init__(self):
        self.own = self


def test_worker_frees_what_a_piece_leaves_at_once_and_what_became_garbage_later_now_and_then(
    monkeypatch,
):
    monkeypatch.setattr(dask_cluster, "FULL_COLLECTION_PERIOD", 3)
    monkeypatch.setattr(dask_cluster, "_pieces", itertools.count(1))
    held = []
    seen = []

    def work(number):
        for kept in (held, []):
            kept.append(_Cycle())
            seen.append(weakref.ref(kept[-1]))

    try:
        dask_cluster.run_piece(work, 1)
        assert [one() is None for one in seen] == [False, True]
        held.clear()
        alive = []
        for number in (2, 3):
            dask_cluster.run_piece(lambda _: None, number)
            alive.append(seen[0]() is not None)
        assert alive == [True, False]
    finally:
        gc.unfreeze()
