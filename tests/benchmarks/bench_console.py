"""The operator's page on the emulated car: from a pressed stop to the bus, and from a killed
browser to throttle 0.
"""

import contextlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from aerodima.hardware.car.car_ports import PORTS_FILE
from tests.benchmarks.rows import BenchRow
from tests.browser.console_session import (
    BROWSERS,
    FLAGS,
    SETTINGS,
    ConsoleSession,
    OperatorPage,
    wait_for,
)

PRESSES, SHOWN_PRESSES, KILLS = 100, 40, 6
_BOTH = {"tail_pitch", "tail_roll"}
_NOTE_PRESSES = """() => {
  window.presses = [];
  window.addEventListener("pointerdown", (event) => presses.push(performance.timeOrigin + event.timeStamp), {capture: true});
}"""  # noqa: E501


def bench_emergency_stop_of_the_page() -> Iterator[BenchRow]:
    """From the press of the mouse, on the browser's clock, to the exit frames of both motors on the
    emulated bus.

    The goal is for a hidden view; a shown one is drawn in software here, by the same two cores that
    run the car.
    """
    for view, presses, goal in (("hidden", PRESSES, "<= 0.1"), ("shown", SHOWN_PRESSES, "")):
        latencies = press_latencies(presses, shown=view == "shown")
        yield BenchRow(f"console_stop_to_bus_view_{view}_median", float(np.median(latencies)), "s")
        yield BenchRow(
            f"console_stop_to_bus_view_{view}_p99", float(np.quantile(latencies, 0.99)), "s", goal
        )


def bench_killed_browser() -> Iterator[BenchRow]:
    """From SIGKILL of the browser, which ends its connection, to the neutral throttle; the dead-man
    stands behind.
    """
    times = kill_times(KILLS)
    yield BenchRow("console_killed_browser_to_throttle_0_median", float(np.median(times)), "s")
    yield BenchRow("console_killed_browser_to_throttle_0_max", max(times), "s", "<= 0.3")


def press_latencies(presses: int, shown: bool, seed: int = 1) -> list[float]:
    """Latency of each press, s; the view of the car in the page is shown or not.

    A press counts if both motors were on when it came: a computer that stands still stops the car
    by itself.
    """
    wait = random.Random(seed)
    found: list[float] = []
    with _car() as session, _browser() as (_, open_page):
        operator = OperatorPage(open_page(), session)
        page = operator.page
        _show_view(page, shown)
        page.evaluate(_NOTE_PRESSES)
        button = page.locator("#stop").bounding_box()
        page.mouse.move(button["x"] + 20.0, button["y"] + 20.0)
        for _ in range(presses + presses // 4):
            if len(found) == presses:
                return found
            operator.until("state.radio.armed", 60.0)
            time.sleep(
                wait.uniform(0.1, 0.2)
            )  # no press keeps step with the loops of page and drive
            clock = time.time() - time.monotonic()
            before = time.monotonic()
            page.mouse.down()
            page.mouse.up()
            if _joints_on(session, before) == _BOTH:
                wait_for(
                    lambda since=before: _joints_off(session, since) == _BOTH, 10.0, "exit frames"
                )
                off = max(event["time_s"] for event in session.exits_since(before))
                found.append(off - (page.evaluate("presses.at(-1)") / 1000.0 - clock))
            operator.until("state.radio.confirmed")
            page.evaluate("get('reset').click()")
            operator.until("!state.radio.stopped_by")
    raise RuntimeError(
        f"both motors were on at only {len(found)} presses of {presses + presses // 4}"
    )


def kill_times(kills: int) -> list[float]:
    """Time from each kill to the neutral throttle, s; the operator was driving slowly ahead in
    MANUAL.

    A try in which the car stopped by itself before the kill, as it does on a computer that stands
    still, counts for nothing; twice as many tries as kills.
    """
    found: list[float] = []
    tries = 2 * kills
    with _car() as session:
        for _ in range(tries):
            with _browser() as (process, open_page):
                operator = OperatorPage(open_page(), session)
                began = time.monotonic()
                if len(found) < kills and _drives_ahead(operator, session, began):
                    killed = time.monotonic()
                    process.kill()
                    wait_for(
                        lambda since=killed: _since(session, "throttle_neutral", since),
                        10.0,
                        "neutral throttle",
                    )
                    found.append(_since(session, "throttle_neutral", killed)[0]["time_s"] - killed)
    if len(found) < kills:
        raise RuntimeError(f"the car drove in only {len(found)} tries of {tries}")
    return found


def _drives_ahead(operator: OperatorPage, session: ConsoleSession, began: float) -> bool:
    from playwright.sync_api import TimeoutError as PageTimeoutError

    try:
        _show_view(operator.page, False)
        manual = operator.page.locator("input[value=manual]")
        for wait in (
            2.0,
            2.0,
            2.0,
            20.0,
        ):  # a page that has just opened may fall silent, and the car disarm meanwhile
            operator.until(
                "state.radio.armed && !document.querySelector('input[value=manual]').disabled", 60.0
            )
            manual.evaluate("box => box.click()")
            with suppress(AssertionError):
                operator.until("state.radio.report.mode === 'manual'", wait)
                break
        operator.page.fill("#slider-throttle", "3", timeout=2000.0)
        wait_for(lambda: _since(session, "throttle_on", began), 10.0, "throttle")
    except (PageTimeoutError, AssertionError):
        return False
    time.sleep(0.5)
    return not _since(session, "throttle_neutral", began)


def _show_view(page: Any, shown: bool) -> None:
    """By script: a page that draws in software may be too busy for a mouse that waits until
    everything stands still.
    """
    page.evaluate(
        "(shown) => { const box = get('show-view'); if (box.checked !== shown) box.click(); }",
        shown,
    )


def _joints_off(session: ConsoleSession, time_s: float) -> set[str]:
    return {event["joint"] for event in session.exits_since(time_s)}


def _joints_on(session: ConsoleSession, time_s: float) -> set[str]:
    """Joints whose motor was on at that time (s, monotonic)."""
    last: dict[str, str] = {}
    for event in sorted(
        [*session.events("entered"), *session.events("off")], key=lambda item: item["time_s"]
    ):
        if event["time_s"] <= time_s:
            last[event["joint"]] = event["event"]
    return {joint for joint, name in last.items() if name == "entered"}


def _since(session: ConsoleSession, name: str, time_s: float) -> list[dict[str, Any]]:
    return [event for event in session.events(name) if event["time_s"] >= time_s]


@contextlib.contextmanager
def _car() -> Iterator[ConsoleSession]:
    """A console with its emulated car, and a drive on that car that arms it again after every
    stop.
    """
    with tempfile.TemporaryDirectory() as folder, ConsoleSession(Path(folder)) as session:
        command = [
            sys.executable,
            "-m",
            "tests.benchmarks.rearming_drive",
            str(session.car / PORTS_FILE),
            *SETTINGS,
        ]
        drive = subprocess.Popen(command)
        try:
            yield session
        finally:
            drive.send_signal(signal.SIGTERM)
            try:
                drive.wait(20.0)
            finally:
                drive.kill()  # else it computes beside whatever is measured next


@contextlib.contextmanager
def _browser() -> Iterator[tuple[subprocess.Popen[bytes], Any]]:
    """A Chromium whose process is known, and a function that opens a page in it."""
    from playwright.sync_api import sync_playwright

    program = next(path for name in BROWSERS if (path := shutil.which(name)))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        flags = [
            *FLAGS,
            "--headless=new",
            "--remote-debugging-port=0",
            f"--user-data-dir={profile}",
        ]
        process = subprocess.Popen([program, *flags], stderr=subprocess.DEVNULL)
        listens = Path(profile, "DevToolsActivePort")
        try:
            wait_for(
                lambda: listens.exists() and listens.read_text().count("\n") == 1, 30.0, "a browser"
            )
            port, path = listens.read_text().split()
            with sync_playwright() as playwright:
                context = playwright.chromium.connect_over_cdp(
                    f"ws://127.0.0.1:{port}{path}"
                ).contexts[0]
                yield process, context.new_page
        finally:
            process.kill()
            process.wait()
