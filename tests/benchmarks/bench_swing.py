"""Swings: reduced runs over trials of the full car, and how many of them two cores make in a
second.
"""

import time

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.scenario.scenario import load_scenario
from tests.benchmarks.rows import BenchRow
from tests.optimisation.screening_gate import reduced_seconds


def bench_screening() -> list[BenchRow]:
    """Reduced runs among many per second of CPU time, over trials of the full car, in one process;
    and twice that.
    """
    scenario = load_scenario("turn_designed")
    simulate(scenario, record="outcome")
    begun = time.process_time()
    for _ in range(3):
        simulate(scenario, record="outcome")
    full = 3 / (time.process_time() - begun)
    reduced_seconds([scenario], 8)  # compiles the step
    single = 1.0 / reduced_seconds([scenario], 256)
    return [
        BenchRow("screening, reduced runs", single, "1/s", ">= 20", full),
        BenchRow("batch model, runs a second on two cores", 2.0 * single, "1/s", ">= 2000"),
    ]
