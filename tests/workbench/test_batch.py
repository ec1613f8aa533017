"""Work spread over processes: order, errors, killed workers, threads."""

import math
import os
import signal
import threading
import time
from collections import Counter
from functools import partial
from pathlib import Path

import pytest

from aerodima.workbench.batch import dask_cluster
from aerodima.workbench.batch.dask_engine import check_workers, run_batch
from aerodima.workbench.errors import UserError


@pytest.mark.parametrize("workers", [1, 2])
def test_results_stand_in_the_order_of_the_items(workers: int) -> None:
    assert run_batch(math.sqrt, [9.0, 4.0, 1.0, 16.0], workers) == [3.0, 2.0, 1.0, 4.0]


def test_each_finished_item_is_told_once_with_its_place() -> None:
    told: list[tuple[int, float]] = []
    run_batch(math.sqrt, [1.0, 4.0, 9.0], 2, lambda place, result: told.append((place, result)))
    assert sorted(told) == [(0, 1.0), (1, 2.0), (2, 3.0)]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_error_of_an_item_reaches_the_caller_as_it_is(workers: int) -> None:
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        run_batch(math.sqrt, [1.0, -1.0, 4.0], workers)


def die_of_two(marks: Path, number: int) -> int:
    """Leaves a mark per try and kills its own process for number 2."""
    (marks / f"{number}_{time.monotonic_ns()}").touch()
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * 10


@pytest.mark.slow
def test_a_piece_that_kills_its_worker_is_found_and_the_others_are_done(tmp_path: Path) -> None:
    told: list[int] = []
    results = run_batch(
        partial(die_of_two, tmp_path),
        [0, 1, 2, 3, 4, 5],
        2,
        lambda _, result: told.append(result),
        lambda number: -1,
    )
    assert results == [0, 10, -1, 30, 40, 50]
    assert sorted(told) == [-1, 0, 10, 30, 40, 50]
    tries = Counter(int(mark.name.split("_")[0]) for mark in tmp_path.iterdir())
    assert tries[2] == 2  # beside another piece, then alone
    assert max(tries[number] for number in (0, 1, 3, 4, 5)) <= 2
    with pytest.raises(
        UserError, match=r"^1 of 4 pieces were lost twice .*first is 2; the others are done"
    ):
        run_batch(partial(die_of_two, tmp_path), [1, 2, 3, 4], 2)


def wait_for_the_killer(folder: Path, number: int) -> int:
    """The first try of number 1 tells its process and waits to be killed."""
    told = folder / "pid"
    if number == 1 and not told.exists():
        (folder / "unfinished").write_text(str(os.getpid()))
        (folder / "unfinished").rename(told)
        time.sleep(60.0)
    return number


@pytest.mark.slow
def test_a_worker_killed_from_outside_costs_nothing(tmp_path: Path) -> None:
    def kill() -> None:
        while not (tmp_path / "pid").exists():
            time.sleep(0.02)
        os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    assert run_batch(partial(wait_for_the_killer, tmp_path), [0, 1, 2, 3, 4], 2) == [0, 1, 2, 3, 4]
    killer.join()


@pytest.mark.slow
def test_workers_that_cannot_live_at_all_are_an_error_and_not_a_hang() -> None:
    with pytest.raises(UserError, match="workers died 6 times before any run was done"):
        run_batch(os._exit, [1] * 100, 2)


def test_workers_have_one_blas_thread_and_the_caller_keeps_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    seen = run_batch(os.getenv, ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"], 2)
    assert seen == ["1", "1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


@pytest.mark.slow
def test_workers_preload_a_fast_allocator_where_there_is_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("LD_PRELOAD", raising=False)
    monkeypatch.setattr(dask_cluster, "find_library", {"jemalloc": "libm.so.6"}.get)
    assert run_batch(os.getenv, ["LD_PRELOAD"] * 2, 2) == ["libm.so.6"] * 2
    assert "LD_PRELOAD" not in os.environ
    monkeypatch.setattr(dask_cluster, "find_library", lambda name: None)
    assert run_batch(os.getenv, ["LD_PRELOAD"] * 2, 2) == [None] * 2


@pytest.mark.parametrize("workers", [0, -1, 65])
def test_a_wrong_number_of_workers_is_refused(workers: int) -> None:
    with pytest.raises(UserError, match=rf"--workers {workers}: allowed: 1 to 64"):
        check_workers(workers)
