"""The console for those who use a keyboard alone."""

import time

import pytest

pytest.importorskip("starlette", reason="the extra `console` is not installed")

from aerodima.hardware.protocol.radio import CarReport, EmergencyStop, OperatorCommand, RadioMode
from tests.hardware.console.test_console_server import Served, eventually

pytestmark = [pytest.mark.realtime, pytest.mark.nightly]


@pytest.fixture
def served(tmp_path):
    served = Served(tmp_path)
    yield served
    served.close()


@pytest.fixture
def console(page, served):
    page.set_viewport_size({"width": 1280, "height": 900})
    page.goto(served.access.url)
    eventually(lambda: page.evaluate("state !== null && state.controls"))
    return page


def tell(served, console, report, condition):
    """The car reports until the page shows it."""
    end = time.monotonic() + 10.0
    while not console.evaluate(f"Boolean({condition})"):
        assert time.monotonic() < end, condition
        served.link.report(report, time.monotonic())
        time.sleep(0.05)


ARMED = CarReport(
    True, False, RadioMode.IDLE, faults=(0, 0, 0, 0, 6, 0), operator_age=0.02, text="no fix"
)
STOPPED = CarReport(False, True, RadioMode.IDLE, operator_age=0.02)


def test_the_console_is_worked_by_keyboard_alone(console, served):
    def armed(condition):
        tell(served, console, ARMED, condition)

    armed("state.radio.armed")
    console.keyboard.press("Tab")
    console.keyboard.press("Tab")
    console.keyboard.press("ArrowRight")
    armed("document.activeElement.value === 'manual'")
    assert console.evaluate("mode") == "rest", (
        "an arrow key chooses nothing: the next one would be AUTO"
    )
    console.keyboard.press("Space")
    armed("mode === 'manual'")
    console.keyboard.press("Tab")
    for _ in range(3):
        console.keyboard.press("ArrowRight")
    armed("Math.abs(sliders.values(seconds()).throttle - 0.03) < 1e-6")
    sent = served.sent(OperatorCommand)
    eventually(lambda: served.sent(OperatorCommand)[len(sent) :])
    assert served.sent(OperatorCommand)[-1].throttle == pytest.approx(0.03)
    console.keyboard.press("Escape")
    eventually(lambda: served.sent(EmergencyStop))
    tell(served, console, STOPPED, "state.radio.confirmed")
    assert console.evaluate("mode") == "rest"
