"""What a run leaves behind in the memory of its process."""

import gc
import multiprocessing
from collections.abc import Iterator

import psutil

from tests.benchmarks.rows import BenchRow

RUNS, SETTLED = 40, 10
"""Runs, and those at the start that are not counted: caches fill."""
SCENARIOS = ("turn_none", "turn_swing")


def bench_memory_per_run() -> Iterator[BenchRow]:
    """Growth of a fresh process over 30 runs, garbage collected after each."""
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for name, growth in pool.imap(_growth, SCENARIOS):
            yield BenchRow(f"{name}: memory left per run, {RUNS} runs", growth, "MB", "<= 0.1")


def _growth(name: str) -> tuple[str, float]:
    from aerodima.workbench.batch.simulation import simulate
    from aerodima.workbench.scenario.scenario import load_scenario

    scenario = load_scenario(name)
    process = psutil.Process()
    start = 0.0
    for number in range(RUNS):
        simulate(scenario, record="outcome")
        gc.collect()
        if number + 1 == SETTLED:
            start = process.memory_info().rss
    return name, (process.memory_info().rss - start) / 1e6 / (RUNS - SETTLED)
