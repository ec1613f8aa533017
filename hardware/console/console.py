"""Reaction of the console to its pages: what they ask for, which one controls the car, and the
record; no network in here.

Times are in s, monotonic.
"""

from __future__ import annotations

import contextlib
import json
import time
from pathlib import Path
from typing import Any, Final, TextIO

from aerodima.hardware.console.emulated_car import EmulatedCarProcess
from aerodima.hardware.console.operator_radio import OperatorRadio
from aerodima.hardware.console.page_messages import (
    HeartbeatClock,
    Logging,
    Message,
    PageHeartbeat,
    Stop,
    radio_state,
)
from aerodima.hardware.protocol.radio import RadioMode
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.core.file_reading import Json

GONE_AFTER: Final = 2.0
"""Time without a message after which a page counts as gone although its connection stands, s: it is
hidden, frozen or asleep."""


class Console:
    """Pages, radio, record and the car, if it is one that is started here.

    Pages are known by a number. One page controls, at the beginning the first one; any number look
    on.

    Args:
        radio: console's end of the operator's radio.
        record: file that records what happens.
        limits: ranges of the sliders `steering`, `pitch` and `roll`, rad; throttle is -1 to 1.
        car: emulated car whose drive the console starts and ends; None where the car is armed
            elsewhere.

    Attributes:
        failure: reason why the console must end, in words; empty while it works.
    """

    def __init__(
        self,
        radio: OperatorRadio,
        record: ConsoleRecord,
        limits: dict[str, float],
        car: EmulatedCarProcess | None = None,
    ) -> None:
        self.radio = radio
        self._record = record
        self._limits = limits
        self._car = car
        self._clocks: dict[int, HeartbeatClock] = {}
        self._pages = 0
        self._controller: int | None = None
        self._received = 0.0
        self._recorded: object = None
        self._radio_fault = ""
        self.failure = ""

    @property
    def view(self) -> str | None:
        """Address of the Meshcat view; None where there is none."""
        return None if self._car is None else self._car.view

    def connect(self, now: float) -> int:
        """Connects a page; returns its number."""
        self._pages += 1
        self._clocks[self._pages] = HeartbeatClock()
        if self._pages == 1:
            self._controller = 1
            self._received = now
        return self._pages

    def disconnect(self, page: int) -> None:
        """Disconnects a page; a car that it drove goes to rest."""
        del self._clocks[page]
        if self._controller == page:
            self._controller = None
            self.radio.send_idle()
            self._record.add("controller_gone")

    def handle(self, page: int, message: Message, now: float) -> None:
        """Does what a page asks for.

        Every page may stop the car; everything else is for the one that controls, while the console
        has not failed.

        Raises:
            UserError: the page may not do that; the message is for the operator.
        """
        if isinstance(message, Stop):
            self.radio.stop(message.by, now)
            self._record.add("stop", by=message.by, page=page, sent=not self.radio.fault(now))
            return
        if self.failure:
            return
        if not isinstance(message, PageHeartbeat) and message.type == "take":
            if self._controller != page and not self._control_is_free(now):
                raise UserError("another page controls the car")
            self._controller = page
            self._received = now
            self._record.add("control", page=page)
            return
        if self._controller != page:
            raise UserError("this page is read-only: another one controls the car")
        self._received = now
        if isinstance(message, PageHeartbeat):
            self._heartbeat(page, message, now)
        elif isinstance(message, Logging):
            self._record.switch(message.on)
        else:
            self._request(message.type)

    def poll(self, now: float) -> None:
        """Polls the radio and repeats a stop; to be called every few milliseconds."""
        self.radio.poll(now)
        fault = self.radio.fault(now)
        if fault != self._radio_fault:
            self._radio_fault = fault
            self._record.add("radio", fault=fault)
        report = self.radio.report
        if report is not None and report is not self._recorded:
            self._recorded = report
            self._record.add("report", **radio_state(self.radio, now))

    def fail(self, error: Exception) -> None:
        """Notes that a part of the console has died: the car goes to rest if it can still be
        reached, and the console must end.
        """
        if self.failure:
            return
        self.failure = type(error).__name__
        if str(error):
            self.failure += f": {error}"
        with contextlib.suppress(Exception):  # the radio may be what has died
            self.radio.send_idle()
        with contextlib.suppress(Exception):
            self._record.add("failure", text=self.failure)

    def state(self, page: int, now: float) -> Json:
        """Returns what a page shows, as plain data."""
        car = self._car
        record = self._record
        controls = self._controller == page
        return {
            "type": "state",
            "time": now,
            "controls": controls,
            "can_take": not controls and self._control_is_free(now),
            "radio": radio_state(self.radio, now),
            "recording": {"on": record.on, "path": str(record.path), "error": record.error},
            "car": None if car is None else {"driving": car.driving, "said": car.said},
        }

    def welcome(self) -> Json:
        """Returns what a page must know once."""
        return {"type": "welcome", "limits": self._limits, "view": self.view}

    def _control_is_free(self, now: float) -> bool:
        """Returns whether the controlling page has gone."""
        return self._controller is None or now - self._received > GONE_AFTER

    def _heartbeat(self, page: int, heartbeat: PageHeartbeat, now: float) -> None:
        if not self._clocks[page].in_time(heartbeat.time, now):  # it was held up on its way
            return
        before = self.radio.mode
        sent = self.radio.heartbeat(heartbeat.count, heartbeat.command, now)
        if self.radio.mode is not before:
            self._record.add("mode", mode=self.radio.mode.name)
        if sent:
            self._record.add("command", **heartbeat.model_dump(exclude={"type", "time"}))

    def _request(self, request: str) -> None:
        if request == "reset":
            self.radio.reset()
            self._record.add("reset")
        elif self._car is None:
            raise UserError("this car is armed by the drive on its own computer")
        elif request == "disarm":
            self._car.disarm()
        elif self.radio.stopped:
            raise UserError("emergency stop: reset it first")
        elif self.radio.mode is not RadioMode.IDLE:
            raise UserError("the mode must be rest while the car is armed")
        else:
            self._record.add("arm")
            self._car.arm()


class ConsoleRecord:
    """A file that is begun with the first recording and continued by later ones.

    A line has `time_s` (seconds since 1970) and `event`.

    Args:
        path: path of the file, which must not exist.

    Attributes:
        error: error that ended the recording; empty while it works.
    """

    def __init__(self, path: Path) -> None:
        if path.exists():
            raise LogError(f"{path}: exists already; choose another --record")
        self.path = path
        self.error = ""
        self._file: TextIO | None = None

    @property
    def on(self) -> bool:
        """Returns whether it records."""
        return self._file is not None

    def switch(self, on: bool) -> None:
        """Begins or ends the recording; `error` has the failure of the disk."""
        if on == self.on:
            return
        try:
            if self._file is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._file = open(self.path, "a", encoding="utf-8", buffering=1)  # noqa: SIM115 - until switched off
                self.error = ""
            else:
                self._file.close()
                self._file = None
        except OSError as error:
            self._file = None
            self.error = f"{self.path}: {error.strerror}"

    def add(self, event: str, **facts: Any) -> None:
        """Adds a line, if it records."""
        if self._file is None:
            return
        try:
            self._file.write(json.dumps({"time_s": time.time(), "event": event, **facts}) + "\n")
        except OSError as error:
            self._file = None
            self.error = f"{self.path}: {error.strerror}"
