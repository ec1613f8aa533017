"""First contact with new motors on the emulated car: one joint by five degrees, and the zero into
the ports file.
"""

import json
import math
import subprocess
import sys

import pytest

from aerodima.hardware.car.car_ports import PORTS_FILE, read_ports
from aerodima.hardware.car.wiring import WIRINGS
from aerodima.hardware.driving.motor_zero import joint_angles, read_motor_angles, write_zeros
from aerodima.hardware.driving.watchdog_test import run_watchdog_test
from aerodima.workbench.scenario.scenario import load_scenario
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed
from tests.hardware.emulator.fault_runs import SCENARIO, SETTINGS

pytestmark = pytest.mark.emulated

CAR = load_scenario(SCENARIO, list(SETTINGS))


@pytest.mark.parametrize("wiring", ["watched_can", "teensy_bridge"])
def test_the_angles_of_now_become_the_zeros_and_nothing_else_of_the_file_changes(tmp_path, wiring):
    def tried(folder):
        with EmulatorProcess(folder, CAR, wiring) as emulator:
            path = emulator.folder / PORTS_FILE
            before = json.loads(path.read_text())
            angles = read_motor_angles(emulator.ports, wiring)
            write_zeros(path, angles)
            after = json.loads(path.read_text())
            ports = read_ports(path)
            again = joint_angles(ports, read_motor_angles(ports, wiring))
        assert all(abs(angle) < math.radians(2.0) for angle in again.values()), again
        for joint in ("tail_pitch", "tail_roll"):
            before[joint]["zero"] = after[joint]["zero"]
        assert after == before

    undisturbed(tried, tmp_path)


@pytest.mark.parametrize("wiring", WIRINGS)
def test_the_example_moves_one_motor_and_leaves_it_off(tmp_path, wiring):
    def tried(folder):
        with EmulatorProcess(folder, CAR, wiring) as emulator:

            def example():
                words = ["-m", "aerodima.hardware.examples.one_motor"]
                command = [sys.executable, *words, str(emulator.folder / PORTS_FILE), wiring]
                return subprocess.run(command, capture_output=True, text=True, timeout=120)

            assert example().returncode != 0, "no watchdog test"
            assert not emulator.named("entered")
            run_watchdog_test(CAR, emulator.ports, wiring, lambda _: True, "emulator")
            found = example()
            assert found.returncode == 0, found.stderr
            angles = [float(line.split()[0]) for line in found.stdout.splitlines()]
            assert len(angles) == 300
            assert 0.06 < max(angles) - min(angles) < 0.25, "it lies at its limit and rises"
            # of the watchdog test and of the example
            assert len(emulator.named("entered")) == len(emulator.named("off")) == 4

    undisturbed(tried, tmp_path)
