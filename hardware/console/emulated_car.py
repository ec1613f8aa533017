"""An emulated car, and for the console its drive, started as processes of their own."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from aerodima.hardware.car.car_ports import EVENTS_FILE, PORTS_FILE, READY_FILE, read_events
from aerodima.hardware.car.wiring import WiringName, wiring_name
from aerodima.hardware.driving.speaker import Say
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.file_reading import Json, read_json
from aerodima.workbench.scenario.scenario import Scenario

Process = subprocess.Popen[str]
_START_TIME = 120.0
"""Longest wait for the emulator, and for one test of its watchdog, s."""
_END_TIME = 20.0
"""Longest wait for a process to end, s."""
_POLL_PERIOD = 0.05
"""Time between two checks whether the emulator is ready, s."""
_TESTS = 3
"""Number of times that the watchdog test is tried: a computer that is busy with other work can be
late for the emulated car."""


class EmulatedCarProcess:
    """Processes of an emulated car: `aerodima emulate` and, once armed, `aerodima drive run`.

    Args:
        scenario: scenario as the two commands take it.
        settings: changes of the scenario, as the commands' `--set` takes them.
        has_tail: whether the scenario's car has tail motors, whose watchdog is to be tested.
        wiring: wiring of the car.
        folder: folder for the emulator's files and `drive_N.parquet`; where an earlier car has left
            its own, they go into a numbered folder in it.
        view: whether to show the car in Meshcat.
        console: whether `aerodima console` drives it; otherwise its operator chooses AUTO when the
            car asks.
        faults: path of a script for `aerodima emulate --faults`.

    Attributes:
        folder: folder with its files.
        wiring: wiring of the car.
        view: address of its Meshcat view; None before `start` and without a view.
    """

    def __init__(
        self,
        scenario: str,
        settings: Sequence[str],
        has_tail: bool,
        wiring: WiringName,
        folder: Path,
        view: bool = True,
        *,
        console: bool = True,
        faults: str | Path | None = None,
    ) -> None:
        self._scenario = [scenario, *(word for setting in settings for word in ("--set", setting))]
        self._has_tail = has_tail
        self.wiring = wiring
        self.folder = _own_folder(folder)
        self._flags = ["--view"] * view + ["--console"] * console
        self._flags += [] if faults is None else ["--faults", str(faults)]
        self._emulator: Process | None = None
        self._drive: Process | None = None
        self._lines: list[str] = []
        self._drives = 0
        self.view: str | None = None

    @property
    def ports(self) -> Path:
        """Path of the ports file."""
        return self.folder / PORTS_FILE

    def events(self, *names: str) -> list[Json]:
        """Returns the events so far, or those of these names, with times, s on `time.monotonic`."""
        return [
            event
            for event in read_events(self.folder / EVENTS_FILE)
            if not names or event["event"] in names
        ]

    def start(self, say: Say) -> None:
        """Starts the emulator and records the watchdog test (some seconds); raises `HardwareError`
        with what they said.
        """
        say(f"starting the emulated car in {self.folder}")
        command = ["emulate", *self._scenario, "--out", str(self.folder), "--wiring", self.wiring]
        # The emulator ends with this process, also when that is killed.
        command += ["--parent", str(os.getpid())]
        self._emulator = self._run([*command, *self._flags])
        ready = self.folder / READY_FILE
        end = time.monotonic() + _START_TIME
        while not (facts := _ready_facts(ready, self._emulator.pid)):
            if self._emulator.poll() is not None:
                raise HardwareError(self._last_words() or "the emulator ended")
            if time.monotonic() > end:
                raise HardwareError(f"the emulator is not ready after {_START_TIME:g} s")
            time.sleep(_POLL_PERIOD)
        self.view = facts["view"]
        if self._has_tail:
            self._test_watchdog(say)

    def _test_watchdog(self, say: Say) -> None:
        say("testing its watchdog")
        for left in reversed(range(_TESTS)):
            test = self._run(self._drive_command("watchdog-test"))
            try:
                out, _ = test.communicate(timeout=_START_TIME)
            except subprocess.TimeoutExpired:
                test.kill()
                out = f"the watchdog test has not ended after {_START_TIME:g} s"
            if test.returncode == 0:
                return
            if left == 0:
                raise HardwareError(_last_line(out) or "the watchdog test failed")
            say(f"again: {_last_line(out)}")

    @property
    def driving(self) -> bool:
        """Returns whether a drive runs."""
        return self._drive is not None and self._drive.poll() is None

    @property
    def said(self) -> str:
        """Last line of the drive, or how a signal ended drive or emulator."""
        for name, process in (("emulated car", self._emulator), ("drive", self._drive)):
            if process is not None and (process.poll() or 0) < 0:
                return f"the {name} was killed by signal {-process.returncode}"
        return self._lines[-1] if self._lines else ""

    def arm(self) -> None:
        """Starts a drive; raises `HardwareError` while one runs, or once the emulator has ended."""
        if self.driving:
            raise HardwareError("a drive runs already")
        if self._emulator is None or self._emulator.poll() is not None:
            raise HardwareError(
                f"the emulated car has ended ({self._last_words()}); start the console again"
            )
        self._drives += 1
        log = self.folder / f"drive_{self._drives}.parquet"
        self._lines = ["starting"]
        self._drive = self._run(
            [*self._drive_command("run"), "--no-drake", "--arm", "--out", str(log)]
        )
        threading.Thread(
            target=self._listen, args=(self._drive,), name="drive-lines", daemon=True
        ).start()

    def disarm(self) -> None:
        """Ends the drive in order, motors first."""
        if self._drive is not None and self.driving:
            self._drive.send_signal(signal.SIGINT)

    def close(self) -> None:
        """Ends drive and emulator; never raises."""
        for process, number in ((self._drive, signal.SIGINT), (self._emulator, signal.SIGTERM)):
            if process is None or process.poll() is not None:
                continue
            process.send_signal(number)
            try:
                process.wait(_END_TIME)
            except subprocess.TimeoutExpired:
                process.kill()

    def _drive_command(self, command: str) -> list[str]:
        car = ["--ports", str(self.ports), "--wiring", self.wiring]
        return ["drive", command, *self._scenario, *car]

    def _last_words(self) -> str:
        """Returns the last line of the emulator, which has ended."""
        if self._emulator is None or self._emulator.stdout is None:
            return ""
        return _last_line(self._emulator.stdout.read())

    def _run(self, words: list[str]) -> Process:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "aerodima", *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )

    def _listen(self, drive: Process) -> None:
        for line in drive.stdout or ():
            if line.strip():
                self._lines = [*self._lines[-20:], line.strip()]


@contextmanager
def emulated_car(
    scenario: Scenario,
    wiring: str = "teensy_bridge",
    folder: str | Path | None = None,
    *,
    view: bool = False,
    faults: str | Path | None = None,
    say: Say = print,
) -> Iterator[EmulatedCarProcess]:
    """Runs the simulated car in real time behind ports, with its watchdog tested, for `drive` to
    drive in place of a real one.

    It is a process of its own, which ends with the block, or with the program.

    Args:
        scenario: scenario of the car.
        wiring: name of the wiring, one of `aerodima.hardware.car.wiring.WIRINGS`.
        folder: folder for ports, events, traffic and truth; None: one that is removed at the end.
        view: whether to show the car in Meshcat; the address is `view` of the car.
        faults: path of a script for `aerodima emulate --faults`.
        say: function that receives what is waited for.

    Raises:
        HardwareError: unknown wiring, a folder that cannot be used, no compiler for the firmware.
    """
    chosen = wiring_name(wiring)
    with TemporaryDirectory() as temporary:
        settled = Path(temporary) / "scenario.yaml"
        settled.write_text(json.dumps(scenario.resolved()), encoding="utf-8")
        place = Path(folder or Path(temporary) / "car")
        has_tail = scenario.has_tail
        car = EmulatedCarProcess(
            str(settled), [], has_tail, chosen, place, view, console=False, faults=faults
        )
        try:
            car.start(say)
            yield car
        finally:
            car.close()


def _own_folder(folder: Path) -> Path:
    """Returns the folder or, where an earlier car left its files, a folder in it with the next free
    number from 2.
    """
    candidate = folder
    number = 1
    while (candidate / READY_FILE).exists():
        number += 1
        candidate = folder / str(number)
    return candidate


def _last_line(text: str) -> str:
    lines = text.strip().splitlines() or [""]
    return lines[-1].removeprefix("error: ")


def _ready_facts(path: Path, pid: int) -> Json:
    """Returns what that emulator writes once it is ready, not an earlier one in the same folder;
    empty before.
    """
    facts: Json = read_json(path, HardwareError) if path.exists() else {}
    return facts if facts.get("pid") == pid else {}
