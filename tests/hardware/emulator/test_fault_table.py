"""The fault table: every fault on the emulated car, with the real drive code, until the car is safe."""

import math

import pytest

from tests.hardware.emulator.fault_runs import AT, CASES, RUN_OVER, run_case_undisturbed

pytestmark = pytest.mark.emulated  # three processes and a car in real time


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}-{case.wiring}".replace(" ", "_"))
def test_a_fault_ends_in_a_safe_car(case, tmp_path):
    found = run_case_undisturbed(case, tmp_path, run_time=AT + 2.5)
    if not case.stops:
        assert found.reason == RUN_OVER
        return
    assert case.reason in found.reason
    assert found.reason != RUN_OVER
    assert found.motors_off <= case.within, found
    assert found.throttle_neutral <= case.within, found
    assert found.exits >= 6, "several frames to each motor"
    assert found.entered_again == 0, "nothing is armed again by itself"
    assert not math.isnan(found.motors_off)
