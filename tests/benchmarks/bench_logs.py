"""How fast run logs are written and read, beside pandas on the same table, and what a row costs in
the control loop.
"""

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.schema import (
    RunLog,
    read_run_log,
    run_log_from_metadata,
    run_metadata,
    write_run_log,
)
from tests.benchmarks.rows import BenchRow
from tests.workbench.made_up_runs import car_run_columns

ROWS = 20_000
"""Ten runs of 4 s at 500 Hz, in one table so that the files' fixed costs do not hide the speed."""
REPEATS = 7


def _run() -> RunLog:
    """A table of the shape of a run: smooth columns, every third held like a 100 Hz sensor in a 500
    Hz log.
    """
    names = [column.name for column in car_run_columns([f"q{number}" for number in range(24)])]
    t = np.arange(ROWS) * 0.002
    random = np.random.default_rng(1)
    columns: dict[str, np.ndarray] = {}
    for number, name in enumerate(names):
        values = np.sin(t * random.uniform(0.1, 20.0)) + 1e-3 * random.standard_normal(ROWS)
        columns[name] = np.repeat(values[::5], 5) if number % 3 == 0 else values
    columns["time_s"] = t
    return run_log_from_metadata(pd.DataFrame(columns), run_metadata({"name": "bench"}, seed=1))


def _alternating(ours: Callable[[], object], peer: Callable[[], object]) -> tuple[float, float]:
    """Median seconds of both, run in turns so that both meet the same disturbances; the first pair
    is not counted.
    """
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(REPEATS + 1):
        for act, taken in zip((ours, peer), seconds, strict=True):
            start = time.perf_counter()
            act()
            taken.append(time.perf_counter() - start)
    return statistics.median(seconds[0][1:]), statistics.median(seconds[1][1:])


def bench_run_log() -> list[BenchRow]:
    """Rows and bytes of signals per second, written (on the disk, in place) and read; peer: pandas'
    Parquet.
    """
    run = _run()
    megabytes = run.table.to_numpy().nbytes / 1e6
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.parquet"
        peer_path = Path(folder) / "pandas.parquet"
        timed = {
            "write": _alternating(
                lambda: write_run_log(run, path, force=True),
                lambda: run.table.to_parquet(peer_path),
            ),
            "read": _alternating(lambda: read_run_log(path), lambda: pd.read_parquet(peer_path)),
        }
        for name, (ours, peer) in timed.items():
            rows.append(BenchRow(f"run_log_{name}_rows", ROWS / ours, "1/s", ">= 0.5", ROWS / peer))
            rows.append(
                BenchRow(
                    f"run_log_{name}_speed", megabytes / ours, "MB/s", ">= 0.5", megabytes / peer
                )
            )
        sizes = (path.stat().st_size / 1e6, peer_path.stat().st_size / 1e6)
        rows.append(BenchRow("run_log_size", sizes[0], "MB", "<= 1.0", sizes[1]))
    return rows


def bench_journal() -> list[BenchRow]:
    """What a row costs the loop: mean and longest append; and the time to close a run of 20 s at
    100 Hz.
    """
    run = _run()
    values = run.table.to_numpy()[:2000]
    with tempfile.TemporaryDirectory() as folder:
        journal = JournalWriter(
            Path(folder) / "run.parquet", list(run.table.columns), run.metadata()
        )
        taken = np.empty(len(values))
        for number, row in enumerate(values):
            start = time.perf_counter()
            journal.append(row)
            taken[number] = time.perf_counter() - start
        start = time.perf_counter()
        journal.close()
        closing = time.perf_counter() - start
    return [
        BenchRow("journal_append_mean", float(np.mean(taken)) * 1e6, "us", "<= 20"),
        BenchRow("journal_append_longest", float(np.max(taken)) * 1e6, "us"),
        BenchRow("journal_close", closing, "s"),
    ]
