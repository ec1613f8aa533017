"""A long study, and the memory of its workers all the while: `make soak`.

Runs `turn_swing` many times on two workers with little memory, kills one worker and stops another
on the way, writes the memory of every worker process over time to `memory.csv`, and fails unless
every run came to its end once and all runs came to the same.

Example: python -m tests.soak --runs 60 --memory 0.5 --out out/soak
"""

import argparse
import csv
import os
import random
import signal
import sys
import threading
import time
from collections import Counter
from functools import partial
from pathlib import Path

import psutil

from aerodima.workbench.batch.engine_factory import open_engine
from aerodima.workbench.batch.row_store import WORKER_RECORD
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.scenario.scenario import load_scenario

LOOK_EVERY = 1.0
"""s, between two rows per worker in `memory.csv`."""
SETTINGS = ("manoeuvre.duration=3.0",)
"""The turn and its end, without the quiet seconds after."""


def one_run(marks, number):
    """Simulates and measures the turn; leaves a mark with its process."""
    from aerodima.workbench.batch.simulation import simulate
    from aerodima.workbench.metrics.turn_metrics import metrics_of

    with (marks / str(number)).open("a", encoding="utf-8") as stream:
        stream.write(f"{os.getpid()}\n")
    return repr(metrics_of(simulate(load_scenario("turn_swing", list(SETTINGS)), record="outcome")))


class MemoryLog:
    """Writes the memory of the worker processes, in a thread of its own, independent of the
    engine.
    """

    def __init__(self, path):
        self._path = path
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.peak = {}

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._over.set()
        self._thread.join()

    def _run(self):
        start = time.monotonic()
        with self._path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(("time_s", "process", "memory_mb"))
            while not self._over.wait(LOOK_EVERY):
                for pid, memory in sorted(workers().items()):
                    self.peak[pid] = max(self.peak.get(pid, 0.0), memory / 1e6)
                    writer.writerow((f"{time.monotonic() - start:.1f}", pid, f"{memory / 1e6:.1f}"))
                stream.flush()


def workers():
    """Process -> memory (bytes) of the workers of this process."""
    found = {}
    for child in psutil.Process().children(recursive=True):
        try:
            if any("spawn_main" in word for word in child.cmdline()):
                found[child.pid] = float(child.memory_info().rss)
        except psutil.NoSuchProcess:
            continue
    return found


def soak(runs, number, memory, out):
    """The study, with a worker killed after a third of the runs and one stopped after two thirds;
    what it came to.
    """
    marks = out / "marks"
    marks.mkdir(parents=True)
    ended = 0

    def done(place, result):
        nonlocal ended
        ended += 1
        for at, kind in ((runs // 3, signal.SIGKILL), (2 * runs // 3, signal.SIGSTOP)):
            if ended == at:
                os.kill(random.choice(sorted(set(workers()) & set(_processes(marks)))), kind)
        if ended % max(1, runs // 20) == 0:
            print(f"{ended} of {runs} runs, workers hold {_megabytes()} MB", flush=True)

    start = time.monotonic()
    with (
        MemoryLog(out / "memory.csv") as log,
        open_engine(
            number,
            memory=memory,
            record=out / WORKER_RECORD,
            module="aerodima.workbench.car.car_run",
        ) as engine,
    ):
        results = engine.map(partial(one_run, marks), range(runs), done)
        events = engine.events
    tries = Counter(int(path.name) for path in marks.iterdir() for _ in path.read_text().split())
    return {
        "drake": software_versions()["drake"],
        "runs": len(results),
        "different results": len(set(results)),
        "begun more than once": sum(count > 1 for count in tries.values()),
        "worker processes": len(_processes(marks)),
        "largest memory of a worker, MB": round(max(log.peak.values())),
        "its limit, MB": round(memory / 1e6),
        "wall time, s": round(time.monotonic() - start),
        **{f"workers {kind}": count for kind, count in sorted(events.items())},
    }


def _processes(marks):
    return Counter(int(line) for path in marks.iterdir() for line in path.read_text().split())


def _megabytes():
    return ", ".join(f"{memory / 1e6:.0f}" for _, memory in sorted(workers().items()))


def main():
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--memory", type=float, default=1.5, help="of each worker, GB")
    parser.add_argument("--out", type=Path, default=Path("out/soak"), help="an empty or new folder")
    arguments = parser.parse_args()
    if arguments.out.exists() and any(arguments.out.iterdir()):
        parser.error(f"--out {arguments.out}: is not empty")
    found = soak(arguments.runs, arguments.workers, arguments.memory * 1e9, arguments.out)
    for name, value in found.items():
        print(f"{name:32} {value}")
    # The two whose worker was taken from them; and none that anything else cost.
    whole = (
        found["runs"] == arguments.runs
        and found["different results"] == 1
        and found["begun more than once"] <= 2
    )
    taken = found.get("workers lost") == 1 and found.get("workers stopped") == 1
    return 0 if whole and taken else 1


if __name__ == "__main__":
    sys.exit(main())
