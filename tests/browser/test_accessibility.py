"""Console, report and replay for those who use a keyboard, or see little contrast or colour."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra `console` is not installed")

from aerodima.hardware.protocol.radio import CarReport, EmergencyStop, OperatorCommand, RadioMode
from aerodima.optimisation.identify.fit_pipeline import Estimate, FitResult
from aerodima.optimisation.identify.fit_report import write_report
from aerodima.workbench.figures.figure_style import new_figure
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
    Folded,
    Link,
    Page,
    Plot,
    Preformatted,
    Section,
    Table,
)
from tests.browser.contrast import contrasts, too_faint
from tests.hardware.console.test_console_server import Served, eventually

pytestmark = pytest.mark.realtime

_FOCUSED = """() => {
  const at = document.activeElement;
  if (!at || at === document.body) return null;
  const marked = at.type === "radio" && at.parentElement.parentElement.id === "modes" ? at.nextElementSibling : at;
  const style = getComputedStyle(marked), box = marked.getBoundingClientRect();
  return {
    name: at.id || at.value || at.tagName, outlined: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2,
    seen: box.width > 0 && box.bottom > 0 && box.top < innerHeight,
  };
}"""  # noqa: E501


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    served = Served(tmp_path)
    yield served
    served.close()


@pytest.fixture
def console(page: Any, served: Served) -> Any:
    page.set_viewport_size({"width": 1280, "height": 900})
    page.goto(served.access.url)
    eventually(lambda: page.evaluate("state !== null && state.controls"))
    return page


def tell(served: Served, console: Any, report: CarReport, condition: str) -> None:
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


def test_every_text_of_the_console_can_be_read_in_every_state(console: Any, served: Served) -> None:
    assert too_faint(console) == []
    tell(served, console, ARMED, "state.radio.armed")
    assert too_faint(console) == []
    console.keyboard.press("Escape")
    tell(served, console, STOPPED, "state.radio.confirmed")
    assert too_faint(console) == []
    assert "EMERGENCY STOP" in console.inner_text("#banner")
    assert len(contrasts(console)) > 40


def test_states_of_the_console_differ_by_words_and_not_by_colour_alone(
    console: Any, served: Served
) -> None:
    shown = [console.inner_text("#car")]
    tell(served, console, ARMED, "state.radio.armed")
    shown.append(console.inner_text("#car"))
    assert console.inner_text("#faults") == "no fix\nspeed: no fix"
    console.keyboard.press("Escape")
    tell(served, console, STOPPED, "state.radio.confirmed")
    shown.append(console.inner_text("#car"))
    assert shown == ["not heard", "ARMED", "STOPPED"]
    marked = console.evaluate(
        "getComputedStyle(document.querySelector('#modes input:checked + span'), "
        "'::before').content"
    )
    assert "●" in marked


def test_focus_goes_through_the_console_in_the_order_of_the_page_and_is_seen(
    console: Any, served: Served
) -> None:
    tell(served, console, ARMED, "state.radio.armed")
    order = []
    for _ in range(40):
        served.link.report(ARMED, time.monotonic())
        console.keyboard.press("Tab")
        focused = console.evaluate(_FOCUSED)
        if focused is None or focused["name"] in order:
            break
        assert focused["outlined"], focused
        assert focused["seen"], focused
        order.append(focused["name"])
    plotted = ["Speed", "Yaw rate", "Roll of the car", "Tail angle", "Tail torque"]
    assert order == [
        "stop",
        "rest",
        "centre",
        "steering",
        "step-size",
        "step-time",
        "record",
        *plotted,
    ]


@pytest.mark.parametrize("size", [(1280, 900), (800, 600), (400, 800), (800, 400)])
def test_the_stop_and_the_states_fit_the_window_and_the_stop_stays_in_it(
    console: Any, served: Served, size: tuple[int, int]
) -> None:
    console.set_viewport_size({"width": size[0], "height": size[1]})
    served.link.fault = "reading failed: there is no such device; is it plugged in?"
    eventually(lambda: console.is_visible("#banner"))
    assert console.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert too_faint(console) == []
    for place in (0, 10_000):
        console.evaluate(f"scrollTo(0, {place})")
        seen = console.evaluate(
            "(() => { const box = get('stop').getBoundingClientRect(), x = (box.left + box.right) "
            "/ 2,"
            " y = (box.top + box.bottom) / 2; return "
            "get('stop').contains(document.elementFromPoint(x, y))"
            " && box.top >= 0 && box.bottom <= innerHeight && box.left >= 0 && box.right <= "
            "innerWidth; })()"
        )
        assert seen, f"scrolled to {place}"


def test_everything_on_the_console_that_can_be_worked_has_a_name(console: Any) -> None:
    unnamed = console.evaluate(
        "[...document.querySelectorAll('button, input')]"
        ".filter(item => !item.textContent.trim() && !item.labels?.length).map(item => item.id)"
    )
    assert unnamed == []


def test_the_console_is_worked_by_keyboard_alone(console: Any, served: Served) -> None:
    def armed(condition: str) -> None:
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


def report_page() -> str:
    drawing, axes = new_figure(4.0, 3.0)
    axes[0, 0].plot([0, 1], [0, 1])
    parts = [
        Finding(["What it comes to."]),
        ("See", Link("other.html", "the other page")),
        Bullets(["a point"]),
        Table(["run", "peak roll [deg]"], [["a", "1.0"], ["b", "2.0"]], marked=(1,)),
        Plot(drawing, "A caption.", "A line"),
        Folded("More", [Preformatted("{}")]),
    ]
    return Page(
        "A report", "What it is about.", [Section("One", parts), Section("Two", parts)]
    ).html()


def fit_page(folder: Path) -> str:
    estimate = Estimate("cd", "1", 1.2, 0.1, 1.0, 1.4, bound="upper")
    result = FitResult(
        "log.parquet",
        (estimate,),
        ((0.01,),),
        1.0,
        {"fx": 0.1},
        True,
        "solved",
        (),
        warnings=("a warning",),
    )
    write_report(folder, "Fits", [result], failed={"other.parquet": "no such log"})
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", ["report", "fits"])
def test_reports_can_be_read_and_their_links_reached_by_keyboard(
    kind: str, page: Any, tmp_path: Path
) -> None:
    text = report_page() if kind == "report" else fit_page(tmp_path / "fits")
    path = tmp_path / "page.html"
    path.write_text(text, encoding="utf-8")
    page.goto(path.as_uri())
    assert too_faint(page) == []
    assert page.get_attribute("html", "lang") == "en"
    assert page.locator("img:not([alt])").count() == 0
    if kind == "report":
        reached = []
        for _ in range(4):
            page.keyboard.press("Tab")
            focused = page.evaluate(_FOCUSED)
            assert focused["outlined"], focused
            reached.append(focused["name"])
        assert reached == ["A", "SUMMARY", "A", "SUMMARY"]
