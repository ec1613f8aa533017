"""An operator at the console's radio who drives the emulated car in MANUAL and can press the
emergency stop.
"""

import threading
import time
from contextlib import ExitStack

from aerodima.hardware.console.operator_radio import OperatorRadio
from aerodima.hardware.emulator.fault_script import OperatorEntry
from aerodima.hardware.protocol.radio import OperatorPrompt, make_emergency_stop
from aerodima.hardware.transport.device_lock import lock_devices
from aerodima.hardware.transport.serial_link import SerialLink
from tests.hardware.fake_can import wait_until

MANUAL = OperatorEntry(time=0.0, mode="manual_when_asked", throttle=0.34, roll_tail=-1.57)
"""Tail held where it lies."""
_TURN, _BEAT = 0.005, 0.05


class _CountedLink(SerialLink):
    stops = 0

    def write(self, data):
        self.stops += make_emergency_stop() in data
        super().write(data)


class ConsoleOperator:
    """Beats as a page does, from the beginning to `close`."""

    def __init__(self, ports):
        self._locked = ExitStack()
        self._locked.enter_context(
            lock_devices([ports.console.path], "a console")
        )  # as `aerodima console` does
        self._link = _CountedLink.open(ports.console)
        self._radio = OperatorRadio(self._link, ports.console.receiver, ports.car)
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="console-operator", daemon=True)
        self._thread.start()

    def _run(self):
        count = 0
        due = 0.0
        asked = False
        while not self._end.wait(_TURN):
            now = time.monotonic()
            with self._lock:
                self._radio.poll(now)
                report = self._radio.report
                if report is not None and report.prompt is not OperatorPrompt.NONE:
                    asked = report.prompt is OperatorPrompt.SELECT_MODE
                if now >= due:
                    count = count + 1
                    due = now + _BEAT
                    self._radio.heartbeat(count, MANUAL.command(asked), now)

    def press_stop(self):
        """The emergency stop; its time, s, monotonic."""
        with self._lock:
            now = time.monotonic()
            self.foreign_before = self._radio.foreign
            self._radio.stop("button", now)
        return now

    def confirmed(self, until):
        """Whether the console takes the stop as confirmed before `until` (s, monotonic).

        One that is not was reported, by a module that is not believed, and goes on being sent.
        """
        if wait_until(lambda: self._radio.confirmed, until - time.monotonic()):
            return True
        assert self._radio.foreign > self.foreign_before, "the stop was not reported"
        sent = self._link.stops
        time.sleep(4 * _BEAT)
        assert self._link.stops >= sent + 2, "the stop is not sent any more"
        return False

    def close(self):
        """Ends it; the port is free again."""
        self._end.set()
        self._thread.join()
        self._link.close()
        self._locked.close()
