"""What breaks in the computer itself while it drives: controller, clock, log disk, receiving
threads.
"""

import math
import multiprocessing
import os
import resource
import shutil
import time
from collections import deque

import numpy as np

from aerodima.hardware.car.car_ports import PORTS_FILE, read_ports
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wirings import wire_car
from aerodima.hardware.driving.drive_limits import DriveLimits
from aerodima.hardware.driving.run_journal import open_run_journal
from aerodima.hardware.driving.watchdog_test import run_watchdog_test
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.scenario.signal_table import IMU
from tests.refusals import assert_refused


class Breaker:
    """Something that breaks at an instant of the drive. The base breaks nothing.

    Attributes:
        struck: `time.monotonic` of it, s; None before.
    """

    def __init__(self):
        self.struck = None

    def begin(self, car, scenario, folder):
        """Before the car is armed."""
        self.car = car

    def strike(self):
        """Breaks it, once."""
        self.struck = time.monotonic()

    def clock(self):
        """What the loop takes for `time.monotonic`, s."""
        return time.monotonic()

    def turn(self, guard):
        """Once per cycle."""

    def end(self):
        """After the car has stopped; asserts what is left."""


class ControllerRaises(Breaker):
    def turn(self, guard):
        if self.struck is not None:
            raise ZeroDivisionError("in the controller")


class ClockJumps(Breaker):
    def __init__(self, jump):
        super().__init__()
        self.jump = jump

    def clock(self):
        return time.monotonic() + (0.0 if self.struck is None else self.jump)


class DiskFull(Breaker):
    """The journal may not grow any more: a limit of the process, for want of a disk that can be
    filled.
    """

    removed = False

    def begin(self, car, scenario, folder):
        super().begin(car, scenario, folder)
        self.journal = open_run_journal(folder / "run.parquet", scenario, car.name)
        self.before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def strike(self):
        super().strike()
        size = os.path.getsize(self.journal.journal)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, self.before[1]))

    def turn(self, guard):
        self.journal.append(np.zeros(len(self.journal.columns)))
        if self.journal.error:
            guard.stop(self.journal.error, time.monotonic(), "log")

    def end(self):
        resource.setrlimit(resource.RLIMIT_FSIZE, self.before)
        lost = self.journal.lost
        error = self.journal.error
        log = read_run_log(self.journal.close())
        assert (lost, bool(error)) == (0, not self.removed)
        assert len(log.table) >= self.journal.rows + (not self.removed) > 1, (
            "and what the disk did not take"
        )


class FolderRemoved(DiskFull):
    """The folder of the log is removed; the rows go on into the open file."""

    removed = True

    def begin(self, car, scenario, folder):
        super().begin(car, scenario, folder / "logs")
        self.said = []
        self.journal._say = self.said.append

    def strike(self):
        Breaker.strike(self)
        shutil.rmtree(self.journal.path.parent)

    def end(self):
        assert [text for text in self.said if str(self.journal.journal) in text], (
            "said while it drives"
        )
        super().end()
        assert str(self.journal.path) in self.said[-1]


class OpenedAgain(Breaker):
    """A port that is back under another name is not taken for the one of before: the next drive is
    refused.
    """

    def begin(self, car, scenario, folder):
        super().begin(car, scenario, folder)
        self.folder = folder / "emulated"
        self.again = wire_car(
            scenario, read_ports(self.folder / PORTS_FILE), car.name, lambda: None
        )

    def end(self):
        assert_refused(self.again.start, HardwareError, str(self.folder), "no such device")


class SecondProgram(Breaker):
    """Another program reaches for the devices of the car that drives; it must be refused, and say
    who has them. It loads its modules before the car is armed: on two processors, loading them
    while the car drives in real time would stall the drive.
    """

    def __init__(self, program):
        super().__init__()
        self.program = program

    def begin(self, car, scenario, folder):
        super().begin(car, scenario, folder)
        ports = read_ports(folder / "emulated" / PORTS_FILE)
        processes = multiprocessing.get_context("forkserver")
        self.line, theirs = processes.Pipe()
        arguments = (self.program, scenario, ports, car.name, theirs)
        self.process = processes.Process(target=_try, args=arguments, daemon=True)
        self.process.start()
        theirs.close()
        assert self.line.poll(60.0), "the second program does not begin"
        assert self.line.recv() == "ready"

    def strike(self):
        super().strike()
        self.line.send("go")

    def end(self):
        assert self.line.poll(10.0), "the second program says nothing"
        said = self.line.recv()
        assert "a drive" in said, said
        self.process.join(10.0)


def second_drive(scenario, ports, wiring):
    """What `aerodima drive run` and `check` do first."""
    car = wire_car(scenario, ports, wiring, lambda: None)
    try:
        car.start()
    finally:
        car.stop("over")


def watchdog_test(scenario, ports, wiring):
    """What `aerodima drive watchdog-test` does."""
    run_watchdog_test(scenario, ports, wiring, lambda _: True, "emulator")


def _try(program, scenario, ports, wiring, line):
    line.send("ready")
    line.recv()
    try:
        program(scenario, ports, wiring)
        line.send("it was let in")
    except HardwareError as error:
        line.send(str(error))


class Blind(Breaker):
    """A drive that does not look at the attitude: what the Teensy does by itself."""

    def begin(self, car, scenario, folder):
        super().begin(car, scenario, folder)
        self.before = DriveLimits.tilt
        DriveLimits.tilt = lambda *_: ""

    def end(self):
        DriveLimits.tilt = self.before


class ThrottleSteps(Breaker):
    """Full throttle from one cycle to the next: the pulse comes on slowly, and the wheels stay on
    the ground.
    """

    def begin(self, car, scenario, folder):
        super().begin(car, scenario, folder)
        self.most_pitch = 0.0
        self.pulses = []

    def turn(self, guard):
        self.most_pitch = max(self.most_pitch, abs(float(guard.reading.imu[IMU.index("pitch")])))
        devices = self.car.devices
        if devices is not None and self.struck is not None:
            self.pulses.append((time.monotonic() - self.struck, devices.teensy._throttle))

    def end(self):
        assert math.degrees(self.most_pitch) < 10.0, (
            f"pitched by {math.degrees(self.most_pitch):.1f} degrees"
        )
        late = [pulse for since, pulse in self.pulses if 0.4 < since < 0.6]
        assert late, "the drive did not go on"
        most = 1500 + 400 * (0.3 + 0.6 * load_drive_safety().throttle_rate + 0.01)
        assert max(late) <= most, (max(late), most)


class _DeadEnd(deque):
    def append(self, item):
        raise SystemError("the receive thread dies")


class ReceiverDies(Breaker):
    """The thread that takes in what the motors answer: of the CAN bus, or of the Teensy's port."""

    def strike(self):
        super().strike()
        devices = self.car.devices
        port = devices.teensy._link if devices.watchdog is None else devices.watchdog._port
        port._inbox = _DeadEnd()
