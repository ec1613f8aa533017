"""The drive process is killed or stopped while it drives: the watchdog of the wiring switches the car off."""

import json
import math
import os
import signal
import subprocess
import sys
import time

import pytest

from hardware.emulator.folder import PORTS_FILE
from hardware.firmware.settings import load_teensy_timing
from hardware.watchdog.record import record_path, require_watchdog_test
from hardware.watchdog.settings import load_watchdog_timing
from hardware.watchdog.trial import run_watchdog_test
from tests.hardware.emulator.fault_runs import SCENARIO, EmulatorProcess
from tests.hardware.fake_can import wait_until
from workbench.errors import HardwareError
from workbench.scenario import load_scenario

pytestmark = pytest.mark.emulated  # processes and a car in real time

WIRINGS = ("direct_can", "teensy_bridge")
MARGIN = 0.2
"""s; for processes that share a busy computer."""


@pytest.fixture(params=WIRINGS)
def emulator(request, tmp_path):
    with EmulatorProcess(tmp_path, request.param) as running:
        running.wiring = request.param
        yield running


@pytest.fixture
def driving(emulator, tmp_path, monkeypatch):
    """A drive process whose motors hold, after a watchdog test of its wiring on this emulator."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    run_watchdog_test(load_scenario(SCENARIO), emulator.ports, emulator.wiring, lambda _: True, "emulator")
    entered = count(emulator, "entered")
    ports, log = str(emulator.folder / PORTS_FILE), str(tmp_path / "drive.parquet")
    command = ["drive", SCENARIO, "--ports", ports, "--wiring", emulator.wiring, "--log", log, "--no-drake", "--arm"]
    process = subprocess.Popen(
        [sys.executable, "-m", "workbench.cli", *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    seen = []
    for line in process.stdout:
        seen.append(line)
        if line.startswith("driving"):
            break
    assert count(emulator, "entered") == entered + 2, "".join(seen)
    assert wait_until(lambda: names(emulator)[-1] == "throttle_on", 5.0), names(emulator)
    yield process
    process.kill()
    process.wait()


def names(emulator):
    return [event["event"] for event in emulator.events]


def count(emulator, name):
    return names(emulator).count(name)


def after(emulator, since):
    """Times (s since `since`) of the first event of each kind; the later one of the two motors' `off`."""
    found = {}
    for event in emulator.events:
        if event["time_s"] >= since:
            key = event["event"] + event.get("joint", "")
            found.setdefault(key, event["time_s"] - since)
    off = [found.get(f"off{joint}", math.nan) for joint in ("tail_pitch", "tail_roll")]
    return max(off), found.get("throttle_neutral", math.nan)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hangs"])
def test_a_drive_process_that_dies_or_hangs_leaves_a_safe_car(emulator, driving, number):
    sent = time.monotonic()
    os.kill(driving.pid, number)
    time.sleep(1.5)
    off, neutral = after(emulator, sent)
    firmware, process = load_teensy_timing().watchdog_timeout, load_watchdog_timing().heartbeat_timeout
    if emulator.wiring == "teensy_bridge":
        allowed = firmware
    else:
        allowed = 0.0 if number == signal.SIGKILL else process
    print(f"{emulator.wiring} {number.name}: motors off {off * 1000:.0f} ms, throttle {neutral * 1000:.0f} ms")
    assert off <= allowed + MARGIN
    assert neutral <= firmware + MARGIN
    entered = count(emulator, "entered")
    if number == signal.SIGSTOP:
        os.kill(driving.pid, signal.SIGCONT)
        driving.wait(30.0)
    assert count(emulator, "entered") == entered, "nothing is armed again by itself"


def test_a_watchdog_test_on_the_emulator_is_recorded_and_worth_nothing_for_real_motors(emulator, tmp_path):
    scenario, wiring = load_scenario(SCENARIO), emulator.wiring
    seen = []

    def confirm(question):
        assert wait_until(lambda: count(emulator, "off") >= 2)
        seen.append(question)
        return True

    record, path = run_watchdog_test(scenario, emulator.ports, wiring, confirm, "emulator", tmp_path / "records")
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
        run_watchdog_test(
            load_scenario(SCENARIO), emulator.ports, emulator.wiring, lambda _: False, folder=tmp_path / "records"
        )
    assert not (tmp_path / "records").exists()
