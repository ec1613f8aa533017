"""What breaks in the computer itself while it drives: controller, clock, log disk, receiving threads."""

from __future__ import annotations

import contextlib
import os
import resource
import time
from collections import deque
from pathlib import Path

import numpy as np

from hardware.drive.guard import CarGuard
from hardware.drive.run_journal import RunJournal, open_run_journal
from hardware.wiring.wired_car import WiredCar
from workbench.errors import LogError
from workbench.logs.journal import read_journal
from workbench.scenario import Scenario


class Breaker:
    """Something that breaks at an instant of the drive. The base breaks nothing.

    Attributes:
        struck: `time.monotonic` of it, s; None before.
    """

    def __init__(self) -> None:
        self.struck: float | None = None

    def begin(self, car: WiredCar, scenario: Scenario, folder: Path) -> None:
        """Before the car is armed."""
        self.car = car

    def strike(self) -> None:
        """Breaks it, once."""
        self.struck = time.monotonic()

    def clock(self) -> float:
        """What the loop takes for `time.monotonic`, s."""
        return time.monotonic()

    def turn(self, guard: CarGuard) -> None:
        """Once per cycle."""

    def end(self) -> None:
        """After the car has stopped; asserts what is left."""


class ControllerRaises(Breaker):
    def turn(self, guard: CarGuard) -> None:
        if self.struck is not None:
            raise ZeroDivisionError("in the controller")


class ClockJumps(Breaker):
    def __init__(self, jump: float) -> None:
        super().__init__()
        self.jump = jump

    def clock(self) -> float:
        return time.monotonic() + (0.0 if self.struck is None else self.jump)


class DiskFull(Breaker):
    """The journal may not grow any more: a limit of the process, for want of a disk that can be filled."""

    def begin(self, car: WiredCar, scenario: Scenario, folder: Path) -> None:
        super().begin(car, scenario, folder)
        self.journal: RunJournal = open_run_journal(folder / "run.parquet", scenario, car.name)
        self.before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def strike(self) -> None:
        super().strike()
        size = os.path.getsize(self.journal.journal)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, self.before[1]))

    def turn(self, guard: CarGuard) -> None:
        self.journal.append(np.zeros(len(self.journal.columns)))
        if self.journal.error:
            guard.stop(self.journal.error, time.monotonic())

    def end(self) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, self.before)
        with contextlib.suppress(LogError):
            self.journal.close()
        table, _ = read_journal(self.journal.journal)
        assert table.num_rows > 0, "the log can be read up to the last time that it was written, once a second"


class _DeadEnd(deque):
    def append(self, item: object) -> None:
        raise SystemError("the receive thread dies")


class ReceiverDies(Breaker):
    """The thread that takes in what the motors answer: of the CAN bus, or of the Teensy's port."""

    def strike(self) -> None:
        super().strike()
        devices = self.car.devices
        assert devices is not None
        port = devices.teensy._link if devices.motor_port is devices.teensy else devices.motor_port
        port._inbox = _DeadEnd()  # type: ignore[union-attr]
