"""The fault table: every fault on the emulated car, with the real drive code, until the car is
safe.
"""

import csv
from pathlib import Path

import pytest

from aerodima import hardware
from aerodima.hardware.emulator.fault_script import FAULT_PARTS
from tests.hardware.emulator.breakers import ReceiverDies
from tests.hardware.emulator.emulator_process import undisturbed
from tests.hardware.emulator.fault_cases import CASES
from tests.hardware.emulator.fault_runs import check, row, run_case
from tests.hardware.emulator.process_runs import CASES as PROCESS_CASES
from tests.hardware.emulator.process_runs import REFUSED


def parameter(case):
    dies = pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
    marks = [dies] if case.breaker is ReceiverDies else []
    return pytest.param(case, id=f"{case.name}-{case.wiring}".replace(" ", "_"), marks=marks)


@pytest.mark.emulated  # three processes and a car in real time
@pytest.mark.parametrize("case", [parameter(case) for case in CASES])
def test_a_fault_ends_in_a_safe_car(case, tmp_path):
    found = undisturbed(lambda folder: check(case, run_case(case, folder)), tmp_path)
    print(row(case, found), found.reason)


def test_every_fault_of_a_script_has_a_case():
    entries = [case.fault for case in (*CASES, *REFUSED)] + [
        entry for case in PROCESS_CASES for entry in case.faults
    ]
    assert {entry["fault"] for entry in entries if entry} == set(FAULT_PARTS)


def test_every_case_has_its_line_in_the_table():
    table = Path(hardware.__file__).with_name("emulator") / "fault_table.csv"
    with table.open(encoding="utf-8", newline="") as file:
        measured = {(line["fault"], line["wiring"]) for line in csv.DictReader(file)}
    assert not {(case.name, case.wiring) for case in (*CASES, *PROCESS_CASES, *REFUSED)} - measured
