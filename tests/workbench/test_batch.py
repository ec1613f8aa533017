"""Work spread over processes: order, errors, killed workers, threads."""

import math
import os

import pytest

from workbench.batch import check_workers, run_batch
from workbench.errors import UserError


@pytest.mark.parametrize("workers", [1, 2])
def test_results_stand_in_the_order_of_the_items(workers: int) -> None:
    assert run_batch(math.sqrt, [9.0, 4.0, 1.0, 16.0], workers) == [3.0, 2.0, 1.0, 4.0]


def test_each_finished_item_is_told_once_with_its_count() -> None:
    told: list[tuple[int, float]] = []
    run_batch(math.sqrt, [1.0, 4.0, 9.0], 2, lambda count, result: told.append((count, result)))
    assert [count for count, _ in told] == [1, 2, 3]
    assert sorted(result for _, result in told) == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_error_of_an_item_reaches_the_caller_as_it_is(workers: int) -> None:
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        run_batch(math.sqrt, [1.0, -1.0, 4.0], workers)


def test_a_killed_worker_is_an_error_and_not_a_hang() -> None:
    with pytest.raises(UserError, match="killed after 0 of 2"):
        run_batch(os._exit, [1, 1], 2)


def test_workers_have_one_blas_thread_and_the_caller_keeps_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    seen = run_batch(os.getenv, ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"], 2)
    assert seen == ["1", "1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


@pytest.mark.parametrize("workers", [0, -1, 65])
def test_a_wrong_number_of_workers_is_refused(workers: int) -> None:
    with pytest.raises(UserError, match=rf"--workers {workers}: allowed: 1 to 64"):
        check_workers(workers)
