"""The operator's page in a real browser, on the emulated car: what stops it, and what moves it."""

import time

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `console` is not installed")

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import PERIOD
from aerodima.workbench.logs.schema import read_run_log
from tests.browser.console_session import GAMEPADS, TRIES, ConsoleSession, OperatorPage, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.emulated]

SAFETY = load_drive_safety()


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    with ConsoleSession(tmp_path_factory.mktemp("console"), "--no-view") as session:
        yield session


@pytest.fixture
def operator(page, session):
    page.set_viewport_size({"width": 1280, "height": 900})
    page.add_init_script(GAMEPADS)
    return OperatorPage(page, session)


def press_button(page):
    page.click("#stop")


def press_key(page):
    page.keyboard.press("Escape")


def press_gamepad(page):
    page.evaluate("() => { fakePads = []; }")
    page.wait_for_timeout(100)  # the page sees it let go, if it was pressed
    page.evaluate(
        "() => { const pad = makePad('pad'); pad.buttons[1].pressed = true; fakePads = [pad]; }"
    )


def test_a_car_without_a_tail_is_driven_from_the_page(page, tmp_path):
    # Comes first: the car of `session` would run beside this one.
    with ConsoleSession(tmp_path, "--no-view", "--set", "tail.mode=none") as session:
        operator = OperatorPage(page, session)

        def drive():
            page.fill("#slider-steering", "-15")
            page.fill("#slider-throttle", "20")
            operator.reach("state.radio.report.speed > 0.2 && state.radio.report.yaw_rate > 0.05")

        operator.drive(drive)
        assert page.is_hidden("#slider-roll")
        assert page.inner_text("#faults") == "none"
        page.locator("input[value=rest]").evaluate("box => box.click()")
        operator.until("!state.car.driving")
        assert page.evaluate("state.car.said") == "ended: the operator left MANUAL for IDLE"


@pytest.mark.parametrize("press", [press_button, press_key, press_gamepad])
def test_stop_reaches_the_emulated_bus_and_stays(operator, session, press):
    def stop():
        pressed = time.monotonic()
        press(operator.page)
        wait_for(
            lambda: (
                {event["joint"] for event in session.exits_since(pressed)}
                == {"tail_pitch", "tail_roll"}
            ),
            5.0,
        )
        by = {press_button: "button", press_key: "key", press_gamepad: "gamepad"}[press]
        operator.until(f"state.radio.confirmed && state.radio.stopped_by === '{by}'")

    operator.drive(stop)
    assert "EMERGENCY STOP" in operator.page.inner_text("#banner")
    assert operator.holds("mode === 'rest' && document.getElementById('arm').disabled")
    operator.until("!state.car.driving")
    operator.page.evaluate("() => { fakePads = []; }")
    operator.page.click("#reset")
    operator.until("!state.radio.stopped_by")


def test_slider_moves_the_emulated_tail(operator):
    page = operator.page

    def move():
        start = page.evaluate("state.radio.report.tail_roll")
        asked = page.evaluate("sliders.values(seconds()).roll")
        assert abs(asked - start) < 0.05  # the tail stays where it is
        page.fill("#slider-roll", "-60")
        operator.reach("Math.abs(state.radio.report.tail_roll - (-Math.PI / 3)) < 0.1")
        page.focus("#slider-roll")
        for _ in range(20):
            page.keyboard.press("ArrowRight")
        operator.reach("Math.abs(state.radio.report.tail_roll - (-2 * Math.PI / 9)) < 0.1")

    operator.drive(move)
    page.locator("input[value=rest]").evaluate("box => box.click()")
    operator.until("!state.car.driving")


def test_an_unplugged_gamepad_leaves_the_car_at_rest(operator, session):
    page = operator.page
    page.evaluate("() => { fakePads = [makePad('one')]; }")
    operator.until("!document.getElementById('use-gamepad').disabled")

    def steer():
        page.set_checked("#use-gamepad", True)
        page.evaluate("() => { fakePads[0].axes[0] = -1; }")
        operator.reach("sliders.values(seconds()).steering > 0.3")

    operator.drive(steer)
    page.evaluate("() => { fakePads = []; }")
    operator.until("mode === 'rest' && !document.getElementById('use-gamepad').checked")
    operator.until(
        "document.getElementById('banner').textContent.includes('unplugged')"
    )  # with the next report
    operator.until("!state.car.driving")
    assert "left MANUAL for IDLE" in page.evaluate("state.car.said")


def test_second_page_looks_on(operator, session, browser):
    context = browser.new_context()
    other = context.new_page()
    other.goto(session.url)
    wait_for(lambda: other.evaluate("() => state !== null"), 20.0)
    assert other.inner_text("#seat") == "read-only"
    assert other.is_hidden("#take")
    assert other.is_enabled("#stop")
    assert all(other.is_disabled(name) for name in ("#arm", "#slider-throttle", "#record"))
    context.close()


HIDE = """() => {
  Object.defineProperty(document, 'hidden', {value: true, configurable: true});
  document.dispatchEvent(new Event('visibilitychange'));
  return count;
}"""
SHOW = "() => { delete document.hidden; document.dispatchEvent(new Event('visibilitychange')); }"


def test_a_hidden_tab_sends_no_heartbeat_more_and_the_dead_man_stops_the_car(operator, session):
    page = operator.page
    if not operator.holds("state.recording.on"):
        page.click("#record")
    operator.until("state.recording.on")

    def hide():
        last = page.evaluate(HIDE)
        operator.until("!state.car.driving")
        assert session.recorded("command")[-1]["count"] == last
        page.evaluate(SHOW)
        return operator

    log = stopped_by_the_operator(operator, session, hide)
    assert log.extra["stop_reason"].startswith("the operator's radio is silent for 0.2")
    age, late = stopped_in_order(log)
    assert age <= SAFETY.operator_silence + PERIOD + late


def test_a_closed_tab_sends_the_car_to_rest_before_the_dead_man_would(operator, session):
    pages = [operator.page]

    def close():
        context = pages[-1].context  # a page that another one covers would be hidden first
        pages[-1].close()
        pages.append(context.new_page())
        return OperatorPage(pages[-1], session)

    log = stopped_by_the_operator(operator, session, close)
    assert (
        log.extra["stop_reason"] == "the operator left MANUAL for IDLE and was not heard any more"
    )
    stopped_in_order(log)


def stopped_by_the_operator(operator, session, go):
    """Log of a drive, slowly ahead in MANUAL, during which the operator has gone; `go` returns one
    who is back.

    Again, when a busy machine made the drive stop by itself.
    """

    def drive():
        began = time.monotonic()
        operator.page.fill("#slider-throttle", "3")
        wait_for(
            lambda: any(event["time_s"] >= began for event in session.events("throttle_on")),
            5.0,
            "throttle",
        )

    for _ in range(TRIES):
        operator.drive(drive)
        operator = go()
        operator.until("!state.car.driving")
        log = read_run_log(session.last_log)
        if "operator" in log.extra["stop_reason"]:
            return log
    raise AssertionError(log.extra["stop_reason"])


def stopped_in_order(log):
    """Age of the operator (s) in the tick in which the drive stopped, and how late its ticks came
    at most (s).

    By the drive's own clock and log: how long a busy computer took for it is another question,
    which the benchmark answers (`bench_console`).
    """
    ages = log.signal("status_operator_age_s")
    late = float(np.max(log.signal("loop_lateness_s")))
    stop = (
        round(log.extra["stop_time_s"] / PERIOD) + 1
    )  # a row has the reading of the tick before it
    assert np.all(ages[1:stop] <= SAFETY.operator_silence), "no tick drives with an older operator"
    off = stop + int(np.argmin(log.signal("status_armed")[stop:]))
    held = (off - stop) * PERIOD
    tolerance = 2 * PERIOD + late
    assert SAFETY.tail_hold - tolerance <= held <= SAFETY.max_tail_hold + tolerance
    return float(ages[stop]), late
