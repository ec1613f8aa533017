"""`aerodima console` with an emulated car as a process of its own, and a browser's page of it."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aerodima.hardware.car.car_ports import EVENTS_FILE, read_events

SETTINGS = ("simulation.step=0.004", "simulation.log_rate=250", "drive.governor=true")
"""Half the load of a step of 2 ms for a machine that runs car, drive and browser."""
GAMEPADS = """
window.fakePads = [];
navigator.getGamepads = () => window.fakePads;
window.makePad = (id, index = 0, mapping = "standard") => ({
  id, index, mapping, connected: true, axes: [0, 0, 0, 0],
  buttons: Array.from({length: 17}, () => ({pressed: false, value: 0})),
});
"""
"""Script that gives a page gamepads: `fakePads`, filled by `makePad`."""
TRIES = 5
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox",
    "--no-first-run",
    "--disable-quic",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
)
"""WebGL in software; pages are composed without it, which takes a third of the processor's time.
The browser's own errands, which would wait for a network, are off.
"""


class ConsoleSession:
    """The processes; a context manager."""

    def __init__(self, folder: Path, *flags: str) -> None:
        self.car = folder / "car"
        self.record = folder / "record.jsonl"
        words = [word for setting in SETTINGS for word in ("--set", setting)]
        command = ["console", "auto_turn", "--out", str(self.car), "--port", "0", *words, *flags]
        record = ["--record", str(self.record)]
        self._lines: list[str] = []
        self._process = subprocess.Popen(
            [sys.executable, "-m", "aerodima", *command, *record],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        threading.Thread(target=self._listen, daemon=True).start()

    def __enter__(self) -> ConsoleSession:
        wait_for(lambda: self._addresses() or self._process.poll() is not None, 180.0)
        assert self._addresses(), self._lines
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(40.0)

    @property
    def url(self) -> str:
        """The address that is valid now."""
        return self._addresses()[-1]

    def events(self, name: str) -> list[dict[str, Any]]:
        """What the emulated car noted so far."""
        return [event for event in read_events(self.car / EVENTS_FILE) if event["event"] == name]

    @property
    def last_log(self) -> Path:
        """Run log of the last drive; it is there once the drive has ended."""
        return max(
            self.car.glob("drive_*.parquet"), key=lambda path: int(path.stem.partition("_")[2])
        )

    def recorded(self, name: str) -> list[dict[str, Any]]:
        """What the console recorded so far."""
        lines = self.record.read_text(encoding="utf-8").split("\n")[:-1]
        return [event for event in map(json.loads, lines) if event["event"] == name]

    def exits_since(self, time_s: float) -> list[dict[str, Any]]:
        """Motors that an exit frame on the emulated bus has switched off since then (s,
        monotonic).
        """
        return [
            event
            for event in self.events("off")
            if event["time_s"] >= time_s and event["reason"] == "exit frame"
        ]

    def _addresses(self) -> list[str]:
        return [line.split()[-1] for line in list(self._lines) if "http://" in line]

    def _listen(self) -> None:
        for line in self._process.stdout or ():
            self._lines.append(line.strip())


class OperatorPage:
    """A page that controls the car.

    Conditions are asked for again and again: the page's policy forbids `eval`.
    """

    def __init__(self, page: Any, session: ConsoleSession) -> None:
        self.page = page
        self.session = session
        page.set_default_timeout(8000.0)
        page.goto(session.url)
        self.until("state !== null && (state.controls || state.can_take)")
        if not self.holds("state.controls"):
            page.click("#take")
            self.until("state.controls")

    def holds(self, condition: str) -> bool:
        return bool(self.page.evaluate(f"() => Boolean({condition})"))

    def until(self, condition: str, seconds: float = 20.0) -> None:
        wait_for(lambda: self.holds(condition), seconds, condition)

    def reach(self, condition: str) -> None:
        """Waits for a condition for as long as the car drives."""
        self.until(f"({condition}) || !state.car.driving")
        assert self.holds(condition), self.page.evaluate("state.car.said")

    def drive(self, act: Callable[[], None], mode: str = "manual") -> None:
        """Arms, chooses a mode and does something; again, when the drive ended by itself meanwhile.

        On a machine that answers late it must end, and what was to be shown is not shown then.
        """
        for left in reversed(range(TRIES)):
            self.arm(mode)
            try:
                act()
                return
            except Exception:
                if left == 0 or self.holds("state.car.driving"):
                    raise

    def arm(self, mode: str | None = "manual") -> None:
        """Arms and chooses a mode; again, when a busy machine made the drive stop for a late
        reply.
        """
        for _ in range(TRIES):
            if self.holds("state.radio.stopped_by"):
                self.until("!state.car.driving")
                self.page.click("#reset")
                self.until("!state.radio.stopped_by")
            self.until("!state.car.driving && !document.getElementById('arm').disabled", 30.0)
            self.page.click("#arm")
            self.until("state.car.driving")
            self.until("state.car.said.startsWith('waiting') || !state.car.driving", 60.0)
            if not self.holds("state.car.driving"):
                continue
            if mode is None:
                return
            self.until("state.radio.armed || !state.car.driving")
            self.page.locator(f"input[value={mode}]").evaluate("box => box.click()")
            self.until(f"state.radio.report.mode === '{mode}' || !state.car.driving")
            if self.holds("state.car.driving"):
                return
        raise AssertionError(self.page.evaluate("state.car.said"))


def wait_for(condition: Any, seconds: float, what: str = "") -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"did not come: {what}"
        time.sleep(0.02)
