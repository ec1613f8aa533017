"""Emulators of the tests: processes of their own, forked from one that has loaded Drake once for
all of them.

A start of `aerodima emulate` costs three seconds of processor time, nearly all of it for imports.
"""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
import time
from pathlib import Path

import can

from aerodima.hardware.car.car_ports import (
    EVENTS_FILE,
    PORTS_FILE,
    READY_FILE,
    TRAFFIC_FILE,
    read_events,
    read_ports,
)
from aerodima.hardware.emulator.emulator import EmulatorSettings, run_emulator
from aerodima.hardware.emulator.fault_script import Script
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.emulator.console_operator import ConsoleOperator

DISTURBED = 0.02
"""A pause of that length, s, is not of our making: the loops of drive and emulator take 2 ms of
their 10."""
_READY_TIME = 60.0
_ATTEMPTS = 3
_CALM = 5.0
"""s before the next attempt."""
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(
    [
        "aerodima.hardware.emulator.emulator",
        "aerodima.workbench.car.car_run",
        "aerodima.workbench.scenario.scenario",
    ]
)


class EmulatorProcess:
    """A running emulator as a context manager: ready at the beginning, ended in order at the end.

    Args:
        folder: gets the folder `emulated` with the emulator's files.
        script: content of a script of faults, without its schema.
        console: the car is driven by `operator`, at the console's end of the radio, instead of by
            the script.
    """

    def __init__(
        self,
        folder,
        scenario,
        wiring,
        script=None,
        console=False,
    ):
        self.folder = folder / "emulated"
        self.wiring = wiring
        arguments = (scenario, wiring, self.folder, script or {}, console)
        self._console = console
        self.operator = None
        self.process = _CONTEXT.Process(target=_run, args=arguments, daemon=True)

    def __enter__(self):
        self.process.start()
        try:
            self._wait_until_ready()
            self.operator = ConsoleOperator(self.ports) if self._console else None
        except BaseException:
            self.end()
            raise
        return self

    def _wait_until_ready(self):
        end = time.monotonic() + _READY_TIME
        while not (self.folder / READY_FILE).exists():
            assert self.process.is_alive(), "the emulator ended"
            assert time.monotonic() < end, "the emulator is not ready"
            time.sleep(0.01)

    def __exit__(self, *_):
        self.end()

    def end(self):
        """Its logs are whole after that."""
        if self.operator is not None:
            self.operator.close()
        if self.process.is_alive():
            self.process.terminate()
            self.process.join(30.0)
        if self.process.is_alive():
            self.process.kill()

    @property
    def ports(self):
        return read_ports(self.folder / PORTS_FILE)

    @property
    def events(self):
        return read_events(self.folder / EVENTS_FILE)

    def named(self, name):
        """Events of that name."""
        return [event for event in self.events if event["event"] == name]

    def traffic(self):
        """Frames of the finished log, those of the motors too."""
        return list(can.BLFReader(self.folder / TRAFFIC_FILE))


def _run(scenario, wiring, folder, script, console):
    threading.Thread(target=_end_with_tests, name="end-with-tests", daemon=True).start()
    run_emulator(
        EmulatorSettings(scenario, wiring, folder, Script.model_validate(script), console=console)
    )


def _end_with_tests():
    """Its own parent, which forks emulators, lives as long as they do."""
    tests = multiprocessing.parent_process()
    if tests is not None:
        multiprocessing.connection.wait([tests.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)


class PauseWitness:
    """Watches how late a thread that sleeps wakes up: what the computer does to all real-time
    loops.

    Attributes: longest: s.
    """

    def __init__(self):
        self.longest = 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="pause-witness", daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()

    def _watch(self):
        before = time.monotonic()
        while not self._end.wait(0.005):
            now = time.monotonic()
            self.longest = max(self.longest, now - before - 0.005)
            before = now


def undisturbed(run, folder):
    """What `run` returns for a new folder; again, at most twice, when it failed while the computer
    stood still.

    That it stood still is witnessed by the emulator, which notes its delays, and by a thread of
    this process. A failure without such a witness stands.
    """
    for attempt in range(_ATTEMPTS):
        made = folder / f"attempt_{attempt}"
        made.mkdir()
        with PauseWitness() as witness:
            try:
                return run(made)
            except (AssertionError, HardwareError) as error:
                pause = max(witness.longest, _longest_delay(made))
                print(f"attempt {attempt}: longest pause {pause * 1000:.0f} ms: {error}")
                if pause < DISTURBED or attempt == _ATTEMPTS - 1:
                    raise
        time.sleep(_CALM)
    raise AssertionError("unreachable")


def _longest_delay(folder):
    """Of the emulators that ran in a folder, s."""
    files = [
        Path(place) / EVENTS_FILE for place, _, names in os.walk(folder) if EVENTS_FILE in names
    ]
    events = [event for file in files for event in read_events(file)]
    return max((event["delay_s"] for event in events if event["event"] == "late"), default=0.0)
