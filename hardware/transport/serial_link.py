"""A serial port with its own threads: it survives a broken cable and never holds up the loop."""

from __future__ import annotations

import errno
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

from pydantic import Field
from serial import Serial

from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.yaml_files import StrictModel

READ_TIMEOUT = 0.02
"""Longest wait of a read, s; it returns with the first byte, so that only a silent port waits that
long: 50 times a second."""
_WITHOUT_PORT = 0.002
"""Wait of the sending thread while there is no port, s."""
_WRITE_TIMEOUT = 0.1
"""Longest time of a write, s."""
RECONNECT = 0.25
"""Wait between two attempts to open the port again, s."""
_THREAD_SILENT = 0.5
"""Time without a pass of its loop after which a reading thread is taken for dead, s."""
_CLOSE = 0.2
"""Longest wait at the end for what is to be written, and for a thread, s."""
_MAX_CHUNKS = 4096
"""Largest number of pieces of received data that wait to be taken."""


class SerialSettings(StrictModel):
    """A serial device.

    Attributes:
        path: path of the device, such as `/dev/ttyACM0`.
        rate: bit rate, bit/s; a USB port ignores it.
    """

    path: str = Field(min_length=1)
    rate: int = Field(115_200, gt=0)


def open_serial(settings: SerialSettings, timeout: float = READ_TIMEOUT) -> Serial:
    """Opens the device for this program alone.

    Args:
        timeout: longest wait of a read, s.

    Raises:
        HardwareError: the device is missing, not permitted or in use.
    """
    try:
        return Serial(
            settings.path,
            settings.rate,
            timeout=timeout,
            write_timeout=_WRITE_TIMEOUT,
            exclusive=True,
        )
    except (OSError, ValueError) as error:
        raise HardwareError(f"{settings.path}: cannot be opened: {reason_of(error)}") from None


class SerialLink:
    """Bytes in and out of one serial device.

    What is written replaces what still waits: each text frame of the Teensy carries everything, and
    an old one must not be sent after a newer one was made. A device that was lost is opened again;
    that alone tells nobody to go on.

    Args:
        open_port: function that opens the device or raises `HardwareError`. The first call is made
            here, so that a wrong path is an error at once.

    Attributes:
        error: reason why the device is not open, or was not last time; empty before the first loss.
        losses: number of times that the device was lost or closed.
    """

    def __init__(self, open_port: Callable[[], Serial]) -> None:
        self._open_port = open_port
        self._port: Serial | None = open_port()
        self.error = ""
        self.losses = 0
        self._inbox: deque[tuple[float, bytes]] = deque(maxlen=_MAX_CHUNKS)
        self._waiting: bytes | None = None
        self._condition = threading.Condition()
        self._closing = threading.Event()
        self._alive = time.monotonic()
        self._threads = [
            threading.Thread(target=self._run, name="serial-receive", daemon=True),
            threading.Thread(target=self._run_writer, name="serial-send", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @classmethod
    def open(cls, settings: SerialSettings) -> SerialLink:
        """Opens a link to the device of these settings. Raises `HardwareError` as `open_serial`
        does.
        """
        return cls(lambda: open_serial(settings))

    @property
    def fault(self) -> str:
        """Reason why bytes do not go through now, in words; empty while they do."""
        dead = next((thread.name for thread in self._threads if not thread.is_alive()), "")
        if dead and not self._closing.is_set():
            return f"its thread {dead} has died; start the program again"
        if self._port is None:
            return self.error
        return (
            "" if time.monotonic() - self._alive < _THREAD_SILENT else "its driver does not answer"
        )

    def write(self, data: bytes) -> None:
        """Hands bytes to the sending thread and returns at once; replaces bytes that still wait."""
        with self._condition:
            self._waiting = data
            self._condition.notify_all()

    def poll(self) -> list[tuple[float, bytes]]:
        """Returns the bytes that came since the last call, in the pieces in which they came, each
        with its time of arrival, s on `time.monotonic`.
        """
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def flush(self, timeout: float = _CLOSE) -> bool:
        """Waits, at most `timeout` s, until everything is written; returns whether it is."""
        with self._condition:
            return self._condition.wait_for(lambda: self._waiting is None, timeout)

    def close(self) -> None:
        """Writes what waits (at most 0.2 s) and closes the device. Never raises."""
        self.flush()
        self._closing.set()
        with self._condition:
            self._condition.notify_all()
        for thread in self._threads:
            thread.join(_CLOSE)
        port = self._port
        if port is not None:
            self._lose(port, "closed")

    def _lose(self, port: Serial, reason: str) -> None:
        """Closes a port after an error; `_run` opens the device again.

        Both threads may fail on one port; the later one must not close what was opened since.
        """
        with self._condition:
            if self._port is not port:
                return
            self.error = reason
            self._port = None
            self.losses += 1
        try:
            port.close()
        except Exception as error:  # a device that has gone cannot be closed properly
            self.error = f"{reason}; closing: {error}"

    # -- receiving thread, which also opens the device again

    def _run(self) -> None:
        while not self._closing.is_set():
            self._alive = time.monotonic()
            port = self._port
            if port is None:
                self._reopen()
                continue
            try:
                data = port.read(max(1, port.in_waiting))
            # pyserial raises OSError, TypeError and others on a lost device.
            except Exception as error:
                self._lose(port, f"reading failed: {reason_of(error)}")
                continue
            if data:
                self._inbox.append((time.monotonic(), data))

    def _reopen(self) -> None:
        try:
            port = self._open_port()
        except Exception as error:  # whatever the driver says, the thread must live to try again
            self.error = reason_of(error)
            self._closing.wait(RECONNECT)
            return
        with self._condition:
            self._waiting = None  # made before the device was lost: too old
            self._port = port

    # -- sending thread

    def _run_writer(self) -> None:
        while not self._closing.is_set():
            with self._condition:
                self._condition.wait_for(
                    lambda: self._waiting is not None or self._closing.is_set(), 0.1
                )
                data = self._waiting
                # Taken together: data from before a loss must not meet the port opened after it.
                port = self._port
            if data is None:
                continue
            if port is None:
                self._closing.wait(_WITHOUT_PORT)
                continue
            try:
                port.write(data)
            except Exception as error:
                self._lose(port, f"writing failed: {reason_of(error)}")
            with self._condition:
                if self._waiting is data:
                    self._waiting = None
                self._condition.notify_all()


def reason_of(error: BaseException) -> str:
    """Returns what went wrong with a device and what to do, from the first system error in the
    chain.
    """
    chain = list(causes(error))
    root = next((cause for cause in chain if getattr(cause, "errno", None) is not None), error)
    number = getattr(root, "errno", None)
    # What `termios` says of a file that is no terminal has no error number.
    if number == errno.EISDIR or any(cause.args[:1] == (errno.ENOTTY,) for cause in chain):
        return "is no serial device"
    if number in (errno.EACCES, errno.EPERM):
        return "permission denied; is the user in the group that owns the device (often dialout)?"
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return "there is no such device; is it plugged in?"
    if number in (errno.EBUSY, errno.EAGAIN):
        return "another program uses it"
    return " ".join(str(root).split())


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yields an error and what caused it, from the last one to the first."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
