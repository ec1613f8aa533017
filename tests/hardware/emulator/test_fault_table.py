"""The fault table: every fault on the emulated car, with the real drive code, until the car is safe."""

from pathlib import Path

import pytest

import hardware
from tests.hardware.emulator.breakers import ReceiverDies
from tests.hardware.emulator.emulator_process import undisturbed
from tests.hardware.emulator.fault_cases import CASES
from tests.hardware.emulator.fault_runs import RUN_OVER, row, run_case


def parameter(case):
    dies = pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
    marks = [dies] if case.breaker is ReceiverDies else []
    return pytest.param(case, id=f"{case.name}-{case.wiring}".replace(" ", "_"), marks=marks)


@pytest.mark.emulated  # three processes and a car in real time
@pytest.mark.parametrize("case", [parameter(case) for case in CASES])
def test_a_fault_ends_in_a_safe_car(case, tmp_path):
    undisturbed(lambda folder: check(case, run_case(case, folder)), tmp_path)


def check(case, found):
    print(row(case, found), found.reason)
    if not case.stops:
        assert found.reason == RUN_OVER
        return
    assert case.reason in found.reason
    assert found.reason != RUN_OVER
    assert found.motors_off <= case.within, found
    assert found.throttle_neutral <= (case.throttle_within or case.within), found
    assert found.exits >= 6, "several frames to each motor"
    assert found.entered_again == 0, "nothing is armed again by itself"


def test_every_fault_has_its_row_in_the_table():
    readme = Path(hardware.__file__).with_name("README.md").read_text(encoding="utf-8")
    rows = [tuple(cell.strip() for cell in line.split("|")[1:3]) for line in readme.splitlines() if line[:2] == "| "]
    assert not {(case.name, case.wiring) for case in CASES} - set(rows)
