"""A CAN adapter: how it is named and opened, and the log of its traffic.

Opening puts python-can's interfaces behind one clear error each. The log is a BLF file that a
thread of its own writes, so that a slow or full disk never holds up the loop.
"""

from __future__ import annotations

import queue
import re
import socket
import threading
import time
from io import RawIOBase
from pathlib import Path
from typing import BinaryIO, cast

from pydantic import Field

from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.extras import install_command
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.yaml_files import StrictModel

try:
    import can as can
    from can.exceptions import error_check
    from can.interfaces.slcan import slcanBus

    from aerodima.hardware.transport.serial_link import READ_TIMEOUT, reason_of
except ImportError:
    raise HardwareError(
        f"the ports of the car need python-can, pyserial and pyubx2: {install_command('hardware')}"
    ) from None

BITRATE = 1_000_000
"""Bit rate of the tail motors, bit/s (manual V1.0.8)."""
_LINE = re.compile(rb"[^\r\a]*[\r\a]")
"""A line of slcan."""
_MAX_LINE = 64
"""Largest number of bytes kept without the end of their line: a frame takes 27."""
_HEADS = {"t": 5, "T": 10}
"""Number of characters before the data in a line of slcan; the last one is the data's length in
bytes."""
_CONTAINER_BYTES = 2048
"""Size at which a block goes to the disk, bytes: about 20 frames, a tenth of a second of two motors
at 100 Hz."""
_MAX_WAITING = 10_000
"""Largest number of messages that wait for the disk."""


class CanSettings(StrictModel):
    """A CAN bus as python-can names it.

    Attributes:
        interface: interface of python-can: `socketcan`, `slcan`, `socketcand`, `virtual`, ...
        channel: channel of the interface, such as `can0` or `/dev/ttyACM0`.
        bitrate: bit rate, bit/s, for the interfaces that set it themselves (socketcan does not:
            `ip link` does).
        options: further arguments of the interface, such as `host` and `port` of socketcand.
    """

    interface: str
    channel: str
    bitrate: int = Field(BITRATE, gt=0)
    options: Json = Field(default_factory=dict)

    def __str__(self) -> str:
        return f"CAN {self.interface}:{self.channel}"


def open_bus(settings: CanSettings) -> can.BusABC:
    """Opens the adapter. Never configures a network interface and never asks for rights.

    Raises:
        HardwareError: unknown interface, missing device, missing permission, interface down, server
            not reached.
    """
    interface = settings.interface
    if interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise HardwareError(f"CAN interface {interface!r} is unknown; allowed: {known}")
    arguments: Json = {
        "interface": interface,
        "channel": settings.channel,
        **settings.options,
    }
    if interface == "socketcand":
        _reach(settings)
    elif interface not in ("socketcan", "virtual"):
        arguments.setdefault("bitrate", settings.bitrate)
    try:
        if interface == "slcan":
            return _Slcan(**{"timeout": READ_TIMEOUT, **arguments})
        return can.Bus(**{"ignore_config": True, **arguments})
    except can.CanInterfaceNotImplementedError as error:
        raise HardwareError(f"{settings}: this computer has no driver for it: {error}") from None
    except (can.CanError, OSError, ValueError, TypeError) as error:
        raise HardwareError(f"{settings}: cannot be opened: {reason_of(error)}") from None


class _Slcan(slcanBus):
    """The slcan bus of python-can with a faster read: the original reads byte by byte and takes a
    quarter of a core at 400 frames/s.

    This one reads all available bytes at once. A line that is no text, has no end, or carries
    another number of bytes than it names (time stamps are never switched on) is dropped with a
    `ValueError`.
    """

    def _read(self, timeout: float | None) -> str | None:
        end = time.monotonic() + (timeout or 0.0)
        late = False
        port = self.serialPortOrig
        while not (found := _LINE.match(self._buffer)):
            if late:
                return None
            if len(self._buffer) > _MAX_LINE:
                self._buffer.clear()
                raise ValueError(f"more than {_MAX_LINE} bytes without an end of line")
            with error_check("Could not read from serial device"):
                self._buffer += port.read(max(1, port.in_waiting))
            late = time.monotonic() > end
        line = bytes(self._buffer[: found.end()])
        del self._buffer[: found.end()]
        text = line.decode()
        head = _HEADS.get(text[0])
        if head is not None and len(text) - 1 - head != 2 * int(text[head - 1 : head]):
            raise ValueError(f"{text!r}: another number of bytes than it names")
        return text


def _reach(settings: CanSettings) -> None:
    """Makes one attempt to connect with a time limit: python-can would retry for ten seconds at
    full CPU load.
    """
    host = settings.options.get("host")
    port = settings.options.get("port")
    if not isinstance(host, str) or not isinstance(port, int):
        raise HardwareError(f"{settings}: needs the options host (text) and port (number)")
    try:
        socket.create_connection((host, port), timeout=2.0).close()
    except OSError as error:
        raise HardwareError(f"{settings}: no socketcand at {host}:{port}: {error}") from None


class TrafficLog:
    """BLF file of the frames that were sent and received.

    Args:
        file: open file without a buffer of its own. `TrafficLog.create` opens one.

    Attributes:
        error: reason why the writing stopped; empty while it works. The bus goes on without its
            log.
        lost: number of frames that were not written because the disk was too slow or failed.
    """

    def __init__(self, file: RawIOBase) -> None:
        self._file = file
        self.error = ""
        self.lost = 0
        self._waiting: queue.Queue[can.Message | None] = queue.Queue(_MAX_WAITING)
        self._thread = threading.Thread(target=self._write, name="can-traffic-log", daemon=True)
        self._thread.start()

    @classmethod
    def create(cls, path: Path) -> TrafficLog:
        """Opens a log in a new file, `.blf`.

        Raises `HardwareError` if it exists already or cannot be made.
        """
        try:
            return cls(open(path, "x+b", buffering=0))
        except FileExistsError:
            raise HardwareError(
                f"{path}: exists already; a traffic log is never overwritten"
            ) from None
        except OSError as error:
            raise HardwareError(f"{path}: cannot be written: {error.strerror}") from None

    def add(self, message: can.Message) -> None:
        """Takes a frame; returns at once."""
        try:
            self._waiting.put_nowait(message)
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Writes what is waiting, finishes the file and waits for it for at most a second."""
        try:
            self._waiting.put_nowait(None)
            self._thread.join(1.0)
        except queue.Full:
            self.lost += 1
        if not self.error and (self.lost or self._thread.is_alive()):
            self.error = f"CAN traffic log: the disk is too slow, {self.lost} frames are lost"

    def _write(self) -> None:
        try:
            writer = can.BLFWriter(cast(BinaryIO, self._file), max_container_size=_CONTAINER_BYTES)
            while (message := self._waiting.get()) is not None:
                writer.on_message_received(message)
            writer.stop()
        except Exception as error:  # whatever it is, the bus must go on
            self.error = f"CAN traffic log stopped: {error}"
            while self._waiting.get() is not None:
                self.lost += 1
