"""The operator's page in a real browser, on the emulated car: what stops it, and what moves it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra `console` is not installed")

from tests.browser.console_session import GAMEPADS, ConsoleSession, OperatorPage, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.emulated]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ConsoleSession]:
    with ConsoleSession(tmp_path_factory.mktemp("console"), "--no-view") as session:
        yield session


@pytest.fixture
def operator(page: Any, session: ConsoleSession) -> OperatorPage:
    page.set_viewport_size({"width": 1280, "height": 900})
    page.add_init_script(GAMEPADS)
    return OperatorPage(page, session)


def press_button(page: Any) -> None:
    page.click("#stop")


def press_key(page: Any) -> None:
    page.keyboard.press("Escape")


def press_gamepad(page: Any) -> None:
    page.evaluate("() => { fakePads = []; }")
    page.wait_for_timeout(100)  # the page sees it let go, if it was pressed
    page.evaluate("() => { const pad = makePad('pad'); pad.buttons[1].pressed = true; fakePads = [pad]; }")


@pytest.mark.parametrize("press", [press_button, press_key, press_gamepad])
def test_stop_reaches_the_emulated_bus_and_stays(operator: OperatorPage, session: ConsoleSession, press: Any) -> None:
    def stop() -> None:
        pressed = time.monotonic()
        press(operator.page)
        wait_for(lambda: {event["joint"] for event in session.exits_since(pressed)} == {"tail_pitch", "tail_roll"}, 5.0)
        by = {press_button: "button", press_key: "key", press_gamepad: "gamepad"}[press]
        operator.until(f"state.radio.confirmed && state.radio.stopped_by === '{by}'")

    operator.drive(stop)
    assert "EMERGENCY STOP" in operator.page.inner_text("#banner")
    assert operator.holds("mode === 'rest' && document.getElementById('arm').disabled")
    operator.until("!state.car.driving")
    operator.page.evaluate("() => { fakePads = []; }")
    operator.page.click("#reset")
    operator.until("!state.radio.stopped_by")


def test_slider_moves_the_emulated_tail(operator: OperatorPage) -> None:
    page = operator.page

    def move() -> None:
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


def test_an_unplugged_gamepad_leaves_the_car_at_rest(operator: OperatorPage, session: ConsoleSession) -> None:
    page = operator.page
    page.evaluate("() => { fakePads = [makePad('one')]; }")
    operator.until("!document.getElementById('use-gamepad').disabled")

    def steer() -> None:
        page.set_checked("#use-gamepad", True)
        page.evaluate("() => { fakePads[0].axes[0] = -1; }")
        operator.reach("sliders.values(seconds()).steering > 0.3")

    operator.drive(steer)
    page.evaluate("() => { fakePads = []; }")
    operator.until("mode === 'rest' && !document.getElementById('use-gamepad').checked")
    assert "unplugged" in page.inner_text("#banner")
    operator.until("!state.car.driving")
    assert "left MANUAL for IDLE" in page.evaluate("state.car.said")


def test_a_car_without_a_tail_is_driven_from_the_page(page: Any, tmp_path: Path) -> None:
    with ConsoleSession(tmp_path, "--no-view", "--set", "tail.mode=none") as session:
        operator = OperatorPage(page, session)

        def drive() -> None:
            page.fill("#slider-throttle", "20")
            page.fill("#slider-steering", "-15")
            operator.reach("state.radio.report.speed > 0.2 && state.radio.report.yaw_rate > 0.05")

        operator.drive(drive)
        assert page.is_hidden("#slider-roll")
        assert page.inner_text("#faults") == "none"
        page.locator("input[value=rest]").evaluate("box => box.click()")
        operator.until("!state.car.driving")
        assert page.evaluate("state.car.said") == "ended: the operator left MANUAL for IDLE"


def test_second_page_looks_on(operator: OperatorPage, session: ConsoleSession, browser: Any) -> None:
    context = browser.new_context()
    other = context.new_page()
    other.goto(session.url)
    wait_for(lambda: other.evaluate("() => state !== null"), 20.0)
    assert other.inner_text("#seat") == "read-only"
    assert other.is_hidden("#take")
    assert other.is_enabled("#stop")
    assert all(other.is_disabled(name) for name in ("#arm", "#slider-throttle", "#record"))
    context.close()


@pytest.mark.parametrize("hidden", [False, True])
def test_a_closed_or_hidden_tab_stops_the_car(operator: OperatorPage, session: ConsoleSession, hidden: bool) -> None:
    operator.arm()
    page = operator.page
    gone = time.monotonic()
    if hidden:
        page.evaluate(
            "() => { Object.defineProperty(document, 'hidden', {value: true});"
            " document.dispatchEvent(new Event('visibilitychange')); }"
        )
    else:
        page.close()
    wait_for(lambda: len({event["joint"] for event in session.exits_since(gone)}) == 2, 5.0)
    off = max(event["time_s"] for event in session.exits_since(gone))
    assert off - gone < 2.0  # dead-man 0.25 s and 0.5 s with the tail held; the rest is a busy machine's
