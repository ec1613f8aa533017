"""A minute of driving the emulated car at 100 Hz on both wirings: periods, replies, load of the drive process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hardware.wiring.base import WIRINGS
from tests.benchmarks.rows import BenchRow
from workbench.logs.schema import RunLog, read_run_log

_PROGRAM = str(Path(sys.executable).with_name("aerodima"))
_SETTINGS = ("manoeuvre.straight_time=55", "manoeuvre.log_end=60", "simulation.step=0.004", "simulation.log_rate=250")
_FLAGS = [word for setting in _SETTINGS for word in ("--set", setting)]
_MISSED = 0.015
"""Age of a reply, s, at which the one of this cycle did not come."""


def bench_drive_for_a_minute() -> Iterator[BenchRow]:
    """Period error, cycles without a reply, CPU share; with Drake on both wirings, and the plain loop."""
    for wiring in WIRINGS:
        for name, flags in (("drake", []), ("plain", ["--no-drake"])):
            log = _drive(wiring, flags)
            stem = f"drive_{wiring}_{name}"
            for percentile in ("p50", "p99", "max"):
                goal = "<= 1000" if percentile == "p99" else ""
                error = log.extra[f"period_error_{percentile}_s"]
                yield BenchRow(f"{stem}_period_error_{percentile}", error * 1e6, "us", goal)
            ages = [log.signal(f"status_tail_{joint}_age_s") for joint in ("pitch", "roll")]
            missed = int(np.count_nonzero(np.maximum(*ages) > _MISSED))
            yield BenchRow(f"{stem}_missed_replies", missed, "1", "== 0")
            yield BenchRow(f"{stem}_cpu_share", log.extra["cpu_share"], "1", "<= 0.5")


def _drive(wiring: str, flags: list[str]) -> RunLog:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = {**os.environ, "XDG_STATE_HOME": str(folder / "state"), "OMP_NUM_THREADS": "1"}
        car = folder / "car"
        emulate = [_PROGRAM, "emulate", "auto_turn", *_FLAGS, "--out", str(car), "--wiring", wiring]
        emulator = subprocess.Popen(emulate, stdout=subprocess.DEVNULL)
        try:
            while not (car / "ready.json").exists():
                if emulator.poll() is not None:
                    raise RuntimeError("the emulator ended")
                time.sleep(0.05)
            drive = [_PROGRAM, "drive", "auto_turn", *_FLAGS, "--ports", str(car / "ports.json"), "--wiring", wiring]
            log = folder / "run.parquet"
            for more in (["--watchdog-test"], ["--arm", "--log", str(log), *flags]):
                subprocess.run([*drive, *more], env=environment, check=True, capture_output=True)
            return read_run_log(log)
        finally:
            emulator.terminate()
            emulator.wait(30)
