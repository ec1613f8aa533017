"""`make bench` fails when a benchmark does not run, and not when a goal is missed."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benchmarks.__main__ import run
from tests.benchmarks.rows import BenchRow, NotPermittedError


def bench_good() -> Iterator[BenchRow]:
    yield BenchRow("good", 1.0, "s", "<= 0.5")


def bench_broken() -> Iterator[BenchRow]:
    yield BenchRow("first row", 2.0, "s")
    raise ModuleNotFoundError("no such engine")


def bench_empty() -> Iterator[BenchRow]:
    yield from ()


def bench_forbidden() -> Iterator[BenchRow]:
    raise NotPermittedError("not the right to it")
    yield


def test_a_missed_goal_is_marked_and_no_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([bench_good], tmp_path / "bench.csv") == 0
    assert "MISSED" in capsys.readouterr().out


def test_a_benchmark_that_fails_fails_the_command_and_hides_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([bench_broken, bench_good], tmp_path / "bench.csv") == 1
    with (tmp_path / "bench.csv").open(newline="") as file:
        assert [row["name"] for row in csv.DictReader(file)] == ["first row", "good"]
    assert re.search(r"failed to run: \S+\.bench_broken\n", capsys.readouterr().err)


def test_a_benchmark_without_a_row_fails_unless_the_computer_forbids_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([bench_empty], tmp_path / "bench.csv") == 1
    assert run([bench_forbidden], tmp_path / "bench.csv") == 0
    assert "bench_forbidden: not the right to it" in capsys.readouterr().out
