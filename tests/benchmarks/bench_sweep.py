"""The 68 runs of the turn study on the distributed engine: one and two workers, and what the engine
itself costs.
"""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from aerodima.optimisation.studies.run_study import run_study
from aerodima.optimisation.studies.runs import evaluate, open_run_engine
from aerodima.optimisation.studies.study import load_study, plan_runs
from tests.benchmarks.rows import BenchRow

SETTINGS = tuple(os.environ.get("AERODIMA_BENCH_SWEEP_SETTINGS", "").split())
"""Overrides of the runs, such as a shorter run where there is no time for whole ones."""


def bench_turn_study() -> Iterator[BenchRow]:
    """Wall time of 12 tailless and 35 tailed runs at the default step, table on the disk; start-up
    apart.
    """
    study = load_study("turn")
    blocks = tuple(block.model_copy(update={"settings": SETTINGS}) for block in study.blocks)
    study = study.model_copy(update={"blocks": blocks})
    tasks = [run.task for run in plan_runs(study)]
    words = f"turn study, {len(tasks)} runs{' with ' if SETTINGS else ''}{' '.join(SETTINGS)}"
    evaluate(tasks[0])
    start = time.perf_counter()
    for task in tasks:
        evaluate(task)
    serial = time.perf_counter() - start
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for workers in (1, 2):
            with open_run_engine(workers) as engine:
                start = time.perf_counter()
                run_study(study, Path(folder) / str(workers), engine)
                found[workers] = time.perf_counter() - start
                yield BenchRow(f"{words}: start-up of {workers} worker(s)", engine.startup, "s")
    yield BenchRow(f"{words}: two workers", found[2], "s")
    yield BenchRow(f"{words}: one worker, over a plain loop", found[1], "s", "<= 1.1", serial)
    yield BenchRow(f"{words}: two workers, speed-up over one", found[1] / found[2], "1", ">= 1.7")
