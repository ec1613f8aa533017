"""How long a user waits for the help page."""

import statistics
import subprocess
import sys
import time

from tests.benchmarks.rows import BenchRow

RUNS = 5


def bench_help() -> list[BenchRow]:
    """Wall time of `aerodima --help` in a new process: median of five, after one run that fills the
    file cache.
    """
    seconds = []
    for _ in range(RUNS + 1):
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "aerodima", "--help"], check=True, stdout=subprocess.DEVNULL
        )
        seconds.append(time.perf_counter() - start)
    return [BenchRow("aerodima_help", statistics.median(seconds[1:]), "s", goal="<= 0.5")]
