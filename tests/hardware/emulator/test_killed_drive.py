"""The drive process is killed or stopped while it drives: the watchdog of the wiring switches the
car off.
"""

import pytest

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import WIRINGS
from aerodima.hardware.driving.watchdog_record import require_watchdog_test
from aerodima.hardware.driving.watchdog_test import run_watchdog_test
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed
from tests.hardware.emulator.fault_runs import SCENARIO, SETTINGS
from tests.hardware.emulator.process_runs import (
    CASES,
    REFUSED,
    check,
    process_row,
    run_process_case,
    run_refused_case,
)
from tests.hardware.fake_can import wait_until
from tests.refusals import assert_refused

pytestmark = pytest.mark.emulated  # processes and a car in real time

CAR = load_scenario(SCENARIO, list(SETTINGS))


@pytest.mark.parametrize(
    "case", CASES, ids=lambda case: f"{case.name}-{case.wiring}".replace(" ", "_")
)
def test_a_drive_that_dies_hangs_or_tips_over_leaves_a_safe_car(tmp_path, case):
    found = undisturbed(lambda folder: check(case, run_process_case(case, folder)), tmp_path)
    print(process_row(case, found))


@pytest.mark.parametrize(
    "case", REFUSED, ids=lambda case: f"{case.name}-{case.wiring}".replace(" ", "_")
)
def test_a_car_that_must_not_be_armed_is_refused(tmp_path, case):
    undisturbed(lambda folder: run_refused_case(case, folder), tmp_path)


@pytest.fixture(params=WIRINGS)
def emulator(request, tmp_path):
    with EmulatorProcess(tmp_path, CAR, request.param) as running:
        yield running


def test_a_watchdog_test_on_the_emulator_is_recorded_as_such(emulator):
    wiring = emulator.wiring
    seen = []

    def confirm(question):
        assert wait_until(lambda: len(emulator.named("off")) >= 2)
        seen.append(question)
        return True

    record, path = run_watchdog_test(CAR, emulator.ports, wiring, confirm, "emulator")
    assert path == emulator.folder / f"{wiring}.json"
    assert len(seen) == 1
    assert record.emulated
    assert record.time_to_exit <= load_drive_safety().longest_watchdog_test
    assert require_watchdog_test(wiring, emulator.ports) == record


def test_motors_that_were_not_seen_off_are_not_recorded(emulator):
    arguments = (CAR, emulator.ports, emulator.wiring, lambda _: False)
    assert_refused(
        lambda: run_watchdog_test(*arguments),
        HardwareError,
        emulator.wiring,
        "not seen off",
    )
    assert not list(emulator.folder.glob("*_*.json"))
