"""The operator's page in a real browser with a radio in memory: what is refused, and what a browser
may lack.
"""

import contextlib
import http.server
import threading
import time
from functools import partial

import pytest

pytest.importorskip("starlette", reason="the extra `console` is not installed")

from aerodima.hardware.console.console_server import open_socket
from aerodima.hardware.protocol.radio import (
    EmergencyStop,
    Heartbeat,
    OperatorCommand,
    RadioMode,
)
from tests.browser.console_session import GAMEPADS
from tests.hardware.console.test_console_server import ARMED, Served, eventually

pytestmark = [pytest.mark.realtime, pytest.mark.nightly]

IN_CONTROL = "state !== null && state.controls"
KNOCK = """(port) => new Promise((resolve) => {
  const socket = new WebSocket(`ws://127.0.0.1:${port}/socket`);
  socket.onopen = () => resolve("open");
  socket.onerror = () => resolve("refused");
})"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Files of a folder, without a line per request."""

    def log_message(self, *_):
        pass


@pytest.fixture
def served(tmp_path):
    with contextlib.closing(Served(tmp_path)) as served:
        yield served


def shown(page):
    return page.inner_text("body")


def take_control(page, served):
    """Opens the page with the token of the console, until it is in control."""
    page.goto(served.access.url)
    eventually(lambda: page.evaluate(IN_CONTROL))


def show_armed(page, served):
    """The car reports that it is armed until the page shows it."""
    end = time.monotonic() + 10.0
    while page.inner_text("#car") != "ARMED":
        assert time.monotonic() < end
        served.link.report(ARMED, time.monotonic())
        time.sleep(0.05)


def report_all_the_time(served, report):
    poll = served.console.poll

    def report_and_poll(now):
        served.link.report(report, now)
        poll(now)

    served.console.poll = report_and_poll


def readings(page):
    """What the boxes above and the plots show of car and console."""
    texts = [page.inner_text(name) for name in ("#car", "#heard-mode", "#speed", "#link", "#seat")]
    return [*texts, *page.locator(".plot b").all_inner_texts()]


NO_PLOTS = ["–", "–", "–", "roll (solid) – · pitch (dashed) –", "roll (solid) – · pitch (dashed) –"]


@contextlib.contextmanager
def stalled(served):
    """The console stands still, its connections open."""
    release = threading.Event()
    served.console.poll = lambda _: release.wait(60.0)
    try:
        yield
    finally:
        release.set()
        del served.console.poll


def test_a_wrong_and_a_used_token_are_refused_in_words(page, served):
    page.goto(served.access.url.partition("?")[0] + "?token=wrong")
    assert "used or is wrong" in shown(page)
    used = served.access.url
    page.goto(used)
    eventually(lambda: page.evaluate(IN_CONTROL))
    assert "token" not in page.url
    page.context.clear_cookies()
    page.goto(used)
    assert "used or is wrong" in shown(page)
    page.goto(used.partition("?")[0])
    assert "works once" in shown(page)


def test_a_page_of_another_origin_gets_no_connection_though_the_browser_is_known(
    page, served, tmp_path
):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "index.html").write_text("<p>another page", encoding="utf-8")
    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Quiet, directory=tmp_path / "other")
    ) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        take_control(page, served)
        assert page.evaluate(KNOCK, served.port) == "open"
        page.goto(f"http://127.0.0.1:{other.server_port}/")
        assert page.evaluate(KNOCK, served.port) == "refused"
        other.shutdown()


def test_a_page_left_open_after_a_restart_says_so_and_sends_nothing(page, tmp_path):
    (tmp_path / "second").mkdir()
    first = Served(tmp_path)
    take_control(page, first)
    show_armed(page, first)
    first.close()
    eventually(
        lambda: (
            "connection to the console is lost" in shown(page) or "does not answer" in shown(page)
        )
    )
    with contextlib.closing(Served(tmp_path / "second", open_socket(first.port))) as second:
        eventually(lambda: "was started again" in shown(page))
        assert readings(page) == ["not connected", "–", "–", "no link", "not connected", *NO_PLOTS]
        assert page.is_disabled("#arm")
        assert second.sent(Heartbeat) == []


def test_a_console_that_stalls_leaves_nothing_that_looks_current(page, served):
    take_control(page, served)
    show_armed(page, served)
    page.locator("input[value=manual]").evaluate("box => box.click()")
    assert page.evaluate("mode") == "manual"
    with stalled(served):
        eventually(
            lambda: readings(page) == ["not known", "–", "–", "no link", "not known", *NO_PLOTS]
        )
        assert page.evaluate("socket.readyState") == 1
        assert page.evaluate("mode") == "rest"
        assert "silent for" in page.inner_text("#banner")
        assert "not known" in page.inner_text("#faults")
        assert all(page.is_disabled(name) for name in ("#arm", "input[value=manual]", "#record"))
        page.keyboard.press("Escape")
        assert "has not answered" in page.inner_text("#banner")
    eventually(lambda: served.sent(EmergencyStop))
    eventually(lambda: "EMERGENCY STOP by key" in page.inner_text("#banner"))
    assert readings(page)[4] == "controls"
    with stalled(served):
        eventually(lambda: "An emergency stop by key stood before" in page.inner_text("#banner"))


def test_a_radio_that_is_lost_is_a_fault_in_words_and_a_stop_says_that_it_was_not_sent(
    page, served
):
    take_control(page, served)
    show_armed(page, served)
    page.locator("input[value=manual]").evaluate("box => box.click()")
    served.link.fault = "reading failed: there is no such device"
    eventually(
        lambda: page.inner_text("#banner").startswith("RADIO FAULT: nothing reaches the car")
    )
    assert "radio of this console: the radio's port is lost" in page.inner_text("#faults")
    assert page.evaluate("mode") == "rest"
    assert readings(page)[:4] == ["not heard", "–", "–", "no link"]
    page.keyboard.press("Escape")
    eventually(lambda: "NOT SENT" in page.inner_text("#banner"))


def test_a_console_that_dies_says_so_on_the_page(page, tmp_path):
    with contextlib.closing(Served(tmp_path)) as served:
        take_control(page, served)
        served.console.poll = lambda _: 1 / 0
        eventually(
            lambda: (
                "The console has failed and ends: ZeroDivisionError" in page.inner_text("#banner")
            )
        )
        eventually(lambda: page.inner_text("#car") == "not connected")
        time.sleep(1.5)  # the page tries to connect again
        assert "The console has failed" in page.inner_text("#banner")


def test_a_stop_that_was_pressed_without_connection_is_sent_when_it_is_back(page, served):
    take_control(page, served)
    page.evaluate("socket.close()")
    eventually(lambda: page.evaluate("state === null"))
    page.keyboard.press("Escape")
    assert "not connected" in page.inner_text("#banner")
    eventually(lambda: served.sent(EmergencyStop))
    eventually(lambda: "EMERGENCY STOP by key: the car is not heard" in page.inner_text("#banner"))


def test_the_first_click_on_a_page_without_the_keyboard_is_a_click(page, served):
    take_control(page, served)
    page.set_viewport_size({"width": 560, "height": 900})
    page.evaluate(
        "document.hasFocus = () => window.pressed;"
        "addEventListener('pointerdown', () => { window.pressed = true; }, {capture: true});"
    )
    eventually(lambda: "does not have the keyboard" in page.inner_text("#banner"))
    page.evaluate("get('centre').addEventListener('click', () => { window.clicked = true; })")
    before = page.locator("#centre").bounding_box()
    page.mouse.move(before["x"] + 5.0, before["y"] + 5.0)
    page.mouse.down()
    page.wait_for_timeout(300.0)
    assert page.locator("#centre").bounding_box() == before
    page.mouse.up()
    assert page.evaluate("window.clicked")


@pytest.fixture
def gamepads(page, served):
    """A page of an armed car that stays armed, with gamepads that the test plugs in."""
    page.add_init_script(GAMEPADS)
    take_control(page, served)
    report_all_the_time(served, ARMED)
    eventually(lambda: page.inner_text("#car") == "ARMED")
    return page


def plug(page, *pads):
    page.evaluate(f"() => {{ fakePads = [{', '.join(f'makePad({pad})' for pad in pads)}]; }}")
    page.wait_for_timeout(100.0)


def drive_by_gamepad(page):
    page.check("#use-gamepad")
    page.locator("input[value=manual]").evaluate("box => box.click()")
    assert page.evaluate("mode") == "manual"


def steering(page):
    page.wait_for_timeout(100.0)
    return float(page.evaluate("sliders.values(seconds()).steering"))


@pytest.mark.parametrize("mapping", ["''", "'xr-standard'"])
def test_a_gamepad_of_another_layout_neither_drives_nor_stops(gamepads, served, mapping):
    plug(gamepads, f"'odd one', 0, {mapping}")
    assert gamepads.is_disabled("#use-gamepad")
    assert "odd one has no standard layout: not used" in gamepads.inner_text("#gamepad")
    gamepads.evaluate("() => { fakePads[0].buttons[1].pressed = true; fakePads[0].axes[0] = -1; }")
    assert steering(gamepads) == 0.0
    assert served.sent(EmergencyStop) == []
    plug(gamepads, f"'odd one', 0, {mapping}", "'good one', 1")
    drive_by_gamepad(gamepads)
    gamepads.evaluate("() => { fakePads[0].axes[0] = -1; }")
    assert steering(gamepads) == 0.0
    gamepads.evaluate("() => { fakePads[1].axes[0] = -1; }")
    assert steering(gamepads) == pytest.approx(0.5, abs=0.02)


def test_of_two_gamepads_the_first_that_is_touched_drives_and_the_other_may_stop(gamepads, served):
    plug(gamepads, "'one', 0", "'two', 1")
    assert gamepads.is_disabled("#use-gamepad")
    assert "the first one that is touched drives" in gamepads.inner_text("#gamepad")
    gamepads.evaluate("() => { fakePads[1].buttons[0].pressed = true; }")
    eventually(lambda: gamepads.is_enabled("#use-gamepad"))
    assert "ignored: one" in gamepads.inner_text("#gamepad")
    drive_by_gamepad(gamepads)
    gamepads.evaluate("() => { fakePads[0].axes[0] = 1; fakePads[1].axes[0] = -1; }")
    assert steering(gamepads) > 0.4
    gamepads.evaluate("() => { fakePads[0].buttons[1].pressed = true; }")
    eventually(lambda: served.sent(EmergencyStop))


def test_an_unplugged_gamepad_means_rest_and_the_other_does_not_take_over(gamepads, served):
    plug(gamepads, "'one', 0")
    drive_by_gamepad(gamepads)
    plug(gamepads, "'one', 0", "'two', 1")
    gamepads.evaluate("() => { fakePads[1].axes[0] = -1; }")
    assert steering(gamepads) == 0.0
    assert gamepads.evaluate("mode") == "manual"
    plug(gamepads, "'one', 0")
    assert gamepads.evaluate("mode") == "manual", "the one that is ignored may go"
    plug(gamepads, "'two', 1")
    eventually(lambda: gamepads.evaluate("mode") == "rest")
    assert not gamepads.is_checked("#use-gamepad")
    assert "unplugged" in gamepads.inner_text("#banner")
    eventually(lambda: served.sent(OperatorCommand)[-1].mode is RadioMode.IDLE)
