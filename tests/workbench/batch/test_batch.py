"""Work spread over processes: order, errors, killed workers, threads."""

import math
import os
import signal
import time
from collections import Counter
from functools import partial

import pytest

from aerodima.workbench.batch.dask_cluster import MEMORY_VARIABLES, check_workers
from aerodima.workbench.batch.engine_factory import run_batch
from aerodima.workbench.core.errors import UserError
from tests.refusals import assert_refused


@pytest.mark.parametrize("workers", [1, 2])
def test_results_stand_in_the_order_of_the_items(workers):
    assert run_batch(math.sqrt, [9.0, 4.0, 1.0, 16.0], workers) == [3.0, 2.0, 1.0, 4.0]


def test_each_finished_item_is_told_once_with_its_place():
    told = []
    run_batch(math.sqrt, [1.0, 4.0, 9.0], 2, lambda place, result: told.append((place, result)))
    assert sorted(told) == [(0, 1.0), (1, 2.0), (2, 3.0)]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_error_of_an_item_reaches_the_caller_as_it_is(workers):
    assert_refused(lambda: run_batch(math.sqrt, [1.0, -1.0, 4.0], workers), ValueError)


def die_of_two(marks, number):
    """Leaves a mark per try and kills its own process for number 2."""
    (marks / f"{number}_{time.monotonic_ns()}").touch()
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * 10


@pytest.mark.slow
def test_a_piece_that_kills_its_worker_is_found_and_the_others_are_done(tmp_path):
    told = []
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
    work = partial(run_batch, partial(die_of_two, tmp_path), [1, 2, 3, 4], 2)
    assert_refused(work, UserError, "1 of 4", "2")


@pytest.mark.slow
def test_workers_that_cannot_live_at_all_are_an_error_and_not_a_hang():
    assert_refused(lambda: run_batch(os._exit, [1] * 100, 2), UserError, "6 times")


def test_workers_have_one_blas_thread_and_the_caller_keeps_its_own(
    monkeypatch,
):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    seen = run_batch(os.getenv, ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"], 2)
    assert seen == ["1", "1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_workers_keep_their_memory_as_the_caller_says_or_else_as_the_engine_does(monkeypatch):
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "131072")
    monkeypatch.delenv("MALLOC_MMAP_THRESHOLD_", raising=False)
    seen = run_batch(os.getenv, ["MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"], 2)
    assert seen == ["131072", MEMORY_VARIABLES["MALLOC_MMAP_THRESHOLD_"]]
    assert "MALLOC_MMAP_THRESHOLD_" not in os.environ


@pytest.mark.parametrize("workers", [0, -1, 65])
def test_a_wrong_number_of_workers_is_refused(workers):
    assert_refused(lambda: check_workers(workers), UserError, f"--workers {workers}", "1 to 64")
