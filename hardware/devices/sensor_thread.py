"""A thread that keeps one serial sensor open and its newest sample at hand."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from aerodima.hardware.devices.source_fault import SourceFault
from aerodima.hardware.transport.serial_link import SerialPort

_RECONNECT = 0.25
_CLOSE = 0.5

T = TypeVar("T")
Found = TypeVar("Found", covariant=True)


class Session(Protocol[Found]):
    """One life of an open device: sets it up, then reads from it once per call."""

    def begin(self, port: SerialPort) -> None:
        """Sets the device up; raises `HardwareError` if it is not what it should be."""

    def read(self, port: SerialPort) -> tuple[float, Found] | None:
        """The next sample and when it was taken (s, monotonic); None after a short wait without one."""
        ...

    def align(self, due: float) -> None:
        """A sample is wanted at `due` (s, monotonic) and every period after it; for devices that are asked."""
        ...

    @property
    def fault_text(self) -> str:
        """What the device itself reports, empty while it is well."""
        ...


class SensorThread(Generic[T]):
    """Reads a sensor for ever; a device that was lost is opened and set up again.

    Args:
        name: for messages.
        open_port: opens the device; raises `HardwareError`. The first call is made here, so that a wrong path is an
            error at once.
        session: of the device.
        silent: age of a sample at which the sensor counts as silent, s.

    Attributes:
        count: samples so far. losses: how often the device was lost. error: of the last loss.
    """

    def __init__(self, name: str, open_port: Callable[[], SerialPort], session: Session[T], silent: float) -> None:
        self.name = name
        self._open_port = open_port
        self._session = session
        self._silent = silent
        self._port: SerialPort | None = open_port()
        self._newest: tuple[float, T] | None = None
        self.count = self.losses = 0
        self.error = ""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def newest(self) -> tuple[float, T] | None:
        """When the newest sample was taken (s, monotonic), and the sample; None before the first."""
        return self._newest

    def age(self, now: float) -> float:
        """Seconds since the newest sample was taken; infinite before the first."""
        newest = self._newest
        return math.inf if newest is None else max(0.0, now - newest[0])

    def align(self, due: float) -> None:
        """A sample is wanted at `due` (s, monotonic) and every period after it."""
        self._session.align(due)

    def fault(self, now: float) -> tuple[SourceFault, str]:
        """Why the sensor cannot be trusted at present, and the same in words."""
        if not self._thread.is_alive() and not self._closing.is_set():
            return SourceFault.LOST, f"the reading thread of the {self.name} ended: {self.error}"
        if self._port is None:
            return SourceFault.LOST, f"the port of the {self.name} is lost: {self.error}"
        if self._session.fault_text:
            return SourceFault.REPORTED, self._session.fault_text
        if self._newest is None:
            return SourceFault.NO_SAMPLE_YET, f"no sample of the {self.name} yet" + (
                f": {self.error}" * bool(self.error)
            )
        if (age := self.age(now)) > self._silent:
            return SourceFault.SILENT, f"the {self.name} is silent for {age:.2f} s"
        return SourceFault.NONE, ""

    def close(self) -> None:
        """Ends the thread and closes the device. Never raises."""
        self._closing.set()
        self._thread.join(_CLOSE)
        self._lose("closed")

    def _lose(self, reason: str) -> None:
        port, self._port = self._port, None
        if port is None:
            return
        self.error = " ".join(reason.split())
        try:
            port.close()
        except Exception as error:  # a device that has gone cannot be closed properly
            self.error = f"{self.error}; closing: {error}"

    def _run(self) -> None:
        ready = False
        while not self._closing.is_set():
            port = self._port
            try:
                if port is None:
                    self._port = self._open_port()
                    ready = False
                elif not ready:
                    self._session.begin(port)
                    ready = True
                elif (found := self._session.read(port)) is not None:
                    self._newest = found
                    self.count += 1
            except Exception as error:  # pyserial raises OSError, TypeError and others on a lost device
                self.losses += port is not None
                self._lose(str(error))
                self.error = " ".join(str(error).split())
                self._closing.wait(_RECONNECT)
