"""A minute of driving the emulated car at 100 Hz on both wirings: periods, replies, load of the
drive process.

Emulator and drive share the machine here, as nothing else must. A drive that ends early is a
result: too few cycles, and beside them by how much the emulated car was behind the clock.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import can
import numpy as np

from aerodima.hardware.car.car_ports import (
    EVENTS_FILE,
    JOINTS,
    PORTS_FILE,
    READY_FILE,
    TRAFFIC_FILE,
    read_events,
    read_ports,
)
from aerodima.hardware.car.wiring import PERIOD
from aerodima.workbench.core.array_types import FloatArray
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
_DELIVERY = 0.001
"""From the bus to the drive, s: a reply that is on the bus that long before a reading is in
time."""


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
    result = _drive(wiring, flags)
    log = result.log
    stem = f"drive_{wiring}_{loop}"
    yield BenchRow(f"{stem}_cycles", log.extra["cycles"], "1", f"== {_CYCLES}")
    yield BenchRow(f"{stem}_emulated_car_behind_the_clock", result.car_delay * 1e3, "ms")
    for percentile in ("p50", "p99", "max"):
        goal = "<= 1000" if percentile == "p99" else ""
        yield BenchRow(
            f"{stem}_period_error_{percentile}",
            log.extra[f"period_error_{percentile}_s"] * 1e6,
            "us",
            goal,
        )
    if result.traffic is not None:
        unanswered = count_unanswered(result.traffic, result.motor_ids)
        yield BenchRow(f"{stem}_frames_without_reply", unanswered, "1", "== 0")
    old = count_old_readings(result)
    if result.traffic is not None:
        unused = old["unused"]
        yield BenchRow(f"{stem}_replies_received_but_not_read", unused, "1", "== 0")
    yield BenchRow(f"{stem}_replies_delivered_late", old["delivered_late"], "1")
    yield BenchRow(f"{stem}_replies_given_late_by_the_emulator", old["given_late"], "1")
    yield BenchRow(f"{stem}_cpu_share", log.extra["cpu_share"], "1", "<= 0.5")


def count_old_readings(drive: Drive) -> Counter[str]:
    """Counts the readings that show the same reply as the reading before, by what became of the
    newer reply: it was `unused` although the drive had received it, it was on the bus
    `_DELIVERY` before the reading and `delivered_late`, or it was `given_late`.
    """
    counts: Counter[str] = Counter()
    log = drive.log
    lateness = log.signal("loop_lateness_s")[1:]
    # A row shows the reading of the cycle before it.
    read = log.time[1:] - PERIOD + lateness + log.extra["begin_unix_s"] - lateness[0]
    for joint, motor_id in zip(JOINTS, drive.motor_ids, strict=True):
        arrived = read - log.signal(f"status_{joint}_age_s")[1:]
        given = _reply_times(drive.bus, motor_id)
        received = _reply_times(drive.traffic or [], motor_id)
        for index in np.flatnonzero(np.diff(arrived) < _SAME) + 1:
            shown = arrived[index] + _SAME
            if np.any((shown < received) & (received < read[index])):
                counts["unused"] += 1
            elif np.any((shown < given) & (given < read[index] - _DELIVERY)):
                counts["delivered_late"] += 1
            else:
                counts["given_late"] += 1
    return counts


def _reply_times(frames: list[can.Message], motor_id: int) -> FloatArray:
    """Returns when the replies of a motor were on the bus, s."""
    return np.array([frame.timestamp for frame in frames if _motor_of(frame) == motor_id])


def count_unanswered(traffic: list[can.Message], motor_ids: tuple[int, int]) -> int:
    """Counts the frames to the motors, from the computer or the Teensy, that have no reply."""
    frames = sum(frame.arbitration_id in motor_ids for frame in traffic)
    return frames - sum(_motor_of(frame) in motor_ids for frame in traffic)


def _motor_of(frame: can.Message) -> int:
    """Returns the id of the motor whose reply a frame is; 0 if it is none."""
    return frame.data[0] if frame.is_rx and frame.arbitration_id == 0 else 0


@dataclass(frozen=True)
class Drive:
    """What a drive left.

    Attributes:
        bus: frames on the motors' bus, as the emulated car saw them.
        traffic: frames at the computer's adapter; None on the bridge, where it sees none.
        car_delay: largest delay of the emulated car behind the clock, s.
    """

    log: RunLog
    motor_ids: tuple[int, int]
    bus: list[can.Message]
    traffic: list[can.Message] | None
    car_delay: float


def _drive(wiring: str, flags: list[str]) -> Drive:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = {
            **os.environ,
            "XDG_STATE_HOME": str(folder / "state"),
            "OMP_NUM_THREADS": "1",
        }
        car = folder / "car"
        ports = car / PORTS_FILE
        emulate = [_PROGRAM, "emulate", "auto_turn", *_FLAGS, "--out", str(car), "--wiring", wiring]
        emulator = subprocess.Popen(emulate, stdout=subprocess.DEVNULL)
        log = folder / "run.parquet"
        traffic = folder / "run.blf"
        try:
            while not (car / READY_FILE).exists():
                if emulator.poll() is not None:
                    raise RuntimeError("the emulator ended")
                time.sleep(0.05)
            words = ["auto_turn", *_FLAGS, "--ports", str(ports), "--wiring", wiring]
            frames = ["--traffic", str(traffic)] if wiring == "watched_can" else []
            drive = ["run", *words, "--arm", "--out", str(log), *frames, *flags]
            for command in (["watchdog-test", *words], drive):
                run = subprocess.run(
                    [_PROGRAM, "drive", *command], env=environment, capture_output=True, text=True
                )
                if run.returncode:
                    reason = f"{command[0]}: {run.stderr.splitlines()[-1]}"
                    if not log.exists():
                        raise RuntimeError(reason)
                    print(reason, file=sys.stderr)
        finally:
            emulator.terminate()
            emulator.wait(30)
        return Drive(
            read_run_log(log),
            read_ports(ports).motor_ids,
            list(can.BLFReader(car / TRAFFIC_FILE)),
            list(can.BLFReader(traffic)) if frames else None,
            read_events(car / EVENTS_FILE)[-1]["largest_delay_s"],
        )
