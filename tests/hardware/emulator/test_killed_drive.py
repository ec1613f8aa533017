"""The drive process is killed or stopped while it drives: the watchdog of the wiring switches the car off."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from hardware.emulator.folder import PORTS_FILE
from hardware.emulator.script import JOINTS
from hardware.firmware.settings import load_teensy_timing
from hardware.watchdog.record import record_path, require_watchdog_test
from hardware.watchdog.settings import load_watchdog_timing
from hardware.watchdog.trial import run_watchdog_test
from hardware.wiring.base import WIRINGS
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed
from tests.hardware.emulator.fault_runs import SCENARIO, SETTINGS
from tests.hardware.fake_can import wait_until
from workbench.errors import HardwareError
from workbench.scenario import load_scenario

pytestmark = pytest.mark.emulated  # processes and a car in real time

MARGIN = 0.2
"""s; for processes that share a busy computer."""


CAR = load_scenario(SCENARIO, list(SETTINGS))


@contextmanager
def driving(emulator, folder):
    """A drive process that drives, after a watchdog test of its wiring on this emulator."""
    state = {"XDG_STATE_HOME": str(folder / "state")}
    records = folder / "state" / "aerodima" / "watchdog_tests"
    run_watchdog_test(CAR, emulator.ports, emulator.wiring, lambda _: True, "emulator", records)
    entered = len(emulator.named("entered"))
    ports, log = str(emulator.folder / PORTS_FILE), str(folder / "drive.parquet")
    command = ["drive", SCENARIO, "--ports", ports, "--wiring", emulator.wiring, "--log", log, "--no-drake", "--arm"]
    process = subprocess.Popen(
        [sys.executable, "-m", "workbench.cli", *command],
        env={**os.environ, **state},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        seen = []
        for line in process.stdout:
            seen.append(line)
            if line.startswith("driving"):
                break
        assert len(emulator.named("entered")) == entered + 2, "".join(seen)
        assert wait_until(lambda: emulator.named("throttle_on"), 5.0), emulator.events
        yield process
    finally:
        process.kill()
        process.wait()


def after(emulator, since):
    """Times (s since `since`) of the first event of each kind; the later one of the two motors' `off`."""
    found = {}
    for event in emulator.events:
        if event["time_s"] >= since:
            key = event["event"] + event.get("joint", "")
            found.setdefault(key, event["time_s"] - since)
    off = [found.get(f"off{joint}", math.nan) for joint in JOINTS]
    return max(off), found.get("throttle_neutral", math.nan)


def stop_and_look(folder, wiring, number):
    with EmulatorProcess(folder, CAR, wiring) as emulator, driving(emulator, folder) as process:
        sent = time.monotonic()
        os.kill(process.pid, number)
        wait_until(lambda: not any(math.isnan(value) for value in after(emulator, sent)), 2.0)
        off, neutral = after(emulator, sent)
        print(f"{wiring} {number.name}: motors off {off * 1000:.0f} ms, throttle {neutral * 1000:.0f} ms")
        firmware, beats = load_teensy_timing().watchdog_timeout, load_watchdog_timing().heartbeat_timeout
        if wiring == "teensy_bridge":
            allowed = firmware
        else:
            allowed = 0.0 if number == signal.SIGKILL else beats
        assert off <= allowed + MARGIN
        assert neutral <= firmware + MARGIN
        entered = len(emulator.named("entered"))
        if number == signal.SIGSTOP:
            os.kill(process.pid, signal.SIGCONT)
            process.wait(30.0)
        else:
            time.sleep(0.5)
        assert len(emulator.named("entered")) == entered, "nothing is armed again by itself"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hangs"])
@pytest.mark.parametrize("wiring", WIRINGS)
def test_a_drive_process_that_dies_or_hangs_leaves_a_safe_car(tmp_path, wiring, number):
    undisturbed(lambda folder: stop_and_look(folder, wiring, number), tmp_path)


@pytest.fixture(params=WIRINGS)
def emulator(request, tmp_path):
    with EmulatorProcess(tmp_path, CAR, request.param) as running:
        yield running


def test_a_watchdog_test_on_the_emulator_is_recorded_and_worth_nothing_for_real_motors(emulator, tmp_path):
    wiring = emulator.wiring
    seen = []

    def confirm(question):
        assert wait_until(lambda: len(emulator.named("off")) >= 2)
        seen.append(question)
        return True

    record, path = run_watchdog_test(CAR, emulator.ports, wiring, confirm, "emulator", tmp_path / "records")
    assert path == record_path(wiring, tmp_path / "records")
    assert len(seen) == 1
    assert record.emulated
    assert record.time_to_exit <= load_watchdog_timing().longest_test
    assert require_watchdog_test(wiring, emulator.ports, tmp_path / "records") == record
    data = json.loads((emulator.folder / PORTS_FILE).read_text())
    data["teensy"]["path"] = "/dev/ttyACM0"
    data["can"] = {"interface": "socketcan", "channel": "can0"}
    real = type(emulator.ports).model_validate(data)
    with pytest.raises(HardwareError, match="made on the emulator; the motors are real"):
        require_watchdog_test(wiring, real, tmp_path / "records")


def test_motors_that_were_not_seen_off_are_not_recorded(emulator, tmp_path):
    with pytest.raises(HardwareError, match="were not seen off; nothing is recorded"):
        run_watchdog_test(CAR, emulator.ports, emulator.wiring, lambda _: False, folder=tmp_path / "records")
    assert not (tmp_path / "records").exists()
