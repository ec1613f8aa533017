"""The fault table: every fault on the emulated car, with the real drive code, until the car is safe."""

import pytest

from tests.hardware.emulator.emulator_process import undisturbed
from tests.hardware.emulator.fault_runs import CASES, RUN_OVER, run_case

pytestmark = pytest.mark.emulated  # three processes and a car in real time


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}-{case.wiring}".replace(" ", "_"))
def test_a_fault_ends_in_a_safe_car(case, tmp_path):
    undisturbed(lambda folder: check(case, run_case(case, folder)), tmp_path)


def check(case, found):
    times = f"motors off {found.motors_off:.3f} s, throttle {found.throttle_neutral:.3f} s"
    print(f"{times}, {found.exits} exit frames: {found.reason}")
    if not case.stops:
        assert found.reason == RUN_OVER
        return
    assert case.reason in found.reason
    assert found.reason != RUN_OVER
    assert found.motors_off <= case.within, found
    assert found.throttle_neutral <= case.within, found
    assert found.exits >= 6, "several frames to each motor"
    assert found.entered_again == 0, "nothing is armed again by itself"
