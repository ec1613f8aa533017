"""A minute of driving the emulated car at 100 Hz on both wirings: periods, replies, load of the
drive process.

Emulator and drive share the machine here, as nothing else must.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import numpy as np

from aerodima.workbench.core.realtime import permitted
from aerodima.workbench.logs.schema import RunLog, read_run_log
from tests.benchmarks.rows import BenchRow, NotPermittedError

_PROGRAM = str(Path(sys.executable).with_name("aerodima"))
_SETTINGS = (
    "manoeuvre.speed=2.0",
    "manoeuvre.straight_time=55",
    "manoeuvre.log_end=60",
    "simulation.step=0.004",
    "simulation.log_rate=250",
)
_FLAGS = [word for setting in _SETTINGS for word in ("--set", setting)]
_CYCLES = 6000
_SAME = 1e-3
"""Between the arrivals of one and the same reply, as two rows of the log have it, s."""


def bench_drive_over_can_for_a_minute() -> Iterator[BenchRow]:
    """Wiring `watched_can`, in Drake: period error, cycles without a reply, load of the drive
    process.
    """
    yield from _rows("watched_can", "drake", [])


def bench_drive_over_the_bridge_for_a_minute() -> Iterator[BenchRow]:
    """Wiring `teensy_bridge`, in Drake."""
    yield from _rows("teensy_bridge", "drake", [])


def bench_plain_drive_for_a_minute() -> Iterator[BenchRow]:
    """The plain loop, on the CAN adapter."""
    yield from _rows("watched_can", "plain", ["--no-drake"])


def bench_bridge_drive_beside_load() -> Iterator[BenchRow]:
    """With real-time priority beside one ordinary program per processor that computes without a
    pause.
    """
    yield from _rows_beside_load("teensy_bridge", "drake_beside_load", [])


def bench_watched_drive_beside_load() -> Iterator[BenchRow]:
    """The same with the motors on the computer's adapter and the Teensy as watchdog on their
    bus.
    """
    yield from _rows_beside_load("watched_can", "drake_beside_load", [])


def bench_plain_drive_beside_load() -> Iterator[BenchRow]:
    """The same in the plain loop."""
    yield from _rows_beside_load("watched_can", "plain_beside_load", ["--no-drake"])


def _rows_beside_load(wiring: str, loop: str, flags: list[str]) -> Iterator[BenchRow]:
    if not all(permitted()):
        raise NotPermittedError("real-time priority or locked memory is not permitted here")
    with _load():
        yield from _rows(wiring, loop, flags)


@contextmanager
def _load() -> Iterator[None]:
    """Programs that compute, one per processor."""
    busy = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(os.cpu_count() or 1)
    ]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _rows(wiring: str, loop: str, flags: list[str]) -> Iterator[BenchRow]:
    log, unanswered = _drive(wiring, flags)
    stem = f"drive_{wiring}_{loop}"
    yield BenchRow(f"{stem}_cycles", log.extra["cycles"], "1", f"== {_CYCLES}")
    for percentile in ("p50", "p99", "max"):
        goal = "<= 1000" if percentile == "p99" else ""
        yield BenchRow(
            f"{stem}_period_error_{percentile}",
            log.extra[f"period_error_{percentile}_s"] * 1e6,
            "us",
            goal,
        )
    if unanswered is not None:
        yield BenchRow(f"{stem}_frames_without_reply", unanswered, "1", "== 0")
    late = sum(_without_newer_reply(log, joint) for joint in ("pitch", "roll"))
    yield BenchRow(f"{stem}_readings_without_newer_reply", late, "1", "== 0")
    yield BenchRow(f"{stem}_cpu_share", log.extra["cpu_share"], "1", "<= 0.5")


def _without_newer_reply(log: RunLog, joint: str) -> int:
    """Cycles that read the same reply as the cycle before: it came late, or the cycle before was
    late and read two.
    """
    arrival = log.time + log.signal("loop_lateness_s") - log.signal(f"status_tail_{joint}_age_s")
    return int(np.count_nonzero(np.diff(arrival[1:]) < _SAME))


def _unanswered(traffic: Path) -> int:
    """Frames to the motors less frames from them: each one is answered, whatever it asks."""
    frames = list(can.BLFReader(traffic))
    return sum(not frame.is_rx for frame in frames) - sum(frame.is_rx for frame in frames)


def _drive(wiring: str, flags: list[str]) -> tuple[RunLog, int | None]:
    """The log, and how many frames stayed without reply; None on the bridge, where the computer
    sees no frames.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = {
            **os.environ,
            "XDG_STATE_HOME": str(folder / "state"),
            "OMP_NUM_THREADS": "1",
        }
        car = folder / "car"
        emulate = [_PROGRAM, "emulate", "auto_turn", *_FLAGS, "--out", str(car), "--wiring", wiring]
        emulator = subprocess.Popen(emulate, stdout=subprocess.DEVNULL)
        try:
            while not (car / "ready.json").exists():
                if emulator.poll() is not None:
                    raise RuntimeError("the emulator ended")
                time.sleep(0.05)
            words = ["auto_turn", *_FLAGS, "--ports", str(car / "ports.json"), "--wiring", wiring]
            log = folder / "run.parquet"
            traffic = folder / "run.blf"
            frames = ["--traffic", str(traffic)] if wiring == "watched_can" else []
            drive = ["run", *words, "--arm", "--out", str(log), *frames, *flags]
            for command in (["watchdog-test", *words], drive):
                run = subprocess.run(
                    [_PROGRAM, "drive", *command], env=environment, capture_output=True, text=True
                )
                if run.returncode:
                    facts = read_run_log(log).extra if log.exists() else {}
                    raise RuntimeError(f"{command[0]}: {run.stderr.splitlines()[-1]} {facts}")
            return read_run_log(log), _unanswered(traffic) if frames else None
        finally:
            emulator.terminate()
            emulator.wait(30)
