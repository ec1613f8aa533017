"""The watchdog's own handle on the adapter: raw bytes to a slcan terminal, or a second connection of python-can."""

from __future__ import annotations

import contextlib
import os
import termios
from typing import Protocol

import can

from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.transport.can_adapter import CanSettings, open_bus
from aerodima.workbench.errors import HardwareError

_BITRATES = {
    10_000: "S0",
    20_000: "S1",
    50_000: "S2",
    100_000: "S3",
    125_000: "S4",
    250_000: "S5",
    500_000: "S6",
    750_000: "S7",
    1_000_000: "S8",
}
"""Commands of slcan adapters that set the bit rate, bit/s."""
_SEND_TIMEOUT = 0.002


class ExitLine(Protocol):
    """How exit frames reach the bus. Nothing here raises or waits."""

    def send_exits(self, repeats: int) -> bool:
        """Sends that many exit frames to every motor; whether the driver took them all."""
        ...

    def reopen(self) -> None:
        """Opens the channel anew: it may be closed, or in bus-off."""
        ...

    def drain(self, alone: bool) -> None:
        """Throws away what came in. alone: nobody else reads this adapter any more."""
        ...


class SlcanLine:
    """A second file descriptor on the terminal of a slcan adapter, only written to while the drive process lives.

    A write reaches the terminal whole, so its lines do not mix with those of the drive process; a line that the drive
    process did not finish is ended first.

    An adapter that was unplugged is looked for again with every write: exit frames leave when it is back.

    Raises:
        HardwareError: no such device, no terminal, no permission, or another program has it for itself.
    """

    def __init__(self, settings: CanSettings, motor_ids: tuple[int, ...]) -> None:
        if settings.bitrate not in _BITRATES:
            raise HardwareError(f"{settings}: bit rate {settings.bitrate}; allowed: {', '.join(map(str, _BITRATES))}")
        self._path = settings.channel.partition("@")[0]
        self._channel = f"\rC\r{_BITRATES[settings.bitrate]}\rO\r".encode()
        self._exits = "".join(_slcan(make_exit(motor_id)) for motor_id in motor_ids).encode()
        try:
            self._file = _open_terminal(self._path)
        except OSError as error:
            raise HardwareError(f"{settings}: the watchdog cannot open it: {error.strerror}") from None
        except termios.error:
            raise HardwareError(f"{settings}: is no serial device") from None

    def send_exits(self, repeats: int) -> bool:
        """See `ExitLine`."""
        return self._write(b"\r" + self._exits * repeats)

    def reopen(self) -> None:
        """See `ExitLine`."""
        self._write(self._channel)

    def drain(self, alone: bool) -> None:
        """See `ExitLine`."""
        with contextlib.suppress(OSError):
            while alone and self._file >= 0 and os.read(self._file, 4096):
                pass

    def _write(self, data: bytes) -> bool:
        try:
            if self._file < 0:
                self._file = _open_terminal(self._path)
                os.write(self._file, self._channel)
            return os.write(self._file, data) == len(data)
        except BlockingIOError:
            return False
        except (OSError, termios.error):
            if self._file >= 0:
                os.close(self._file)
            self._file = -1
            return False


class CanLine:
    """A connection of python-can of its own: socketcan, socketcand and others that can be opened twice.

    Raises:
        HardwareError: as `open_bus` does; an interface that lives inside one process.
    """

    def __init__(self, settings: CanSettings, motor_ids: tuple[int, ...]) -> None:
        if settings.interface == "virtual":
            raise HardwareError(f"{settings}: lives inside one process; a watchdog cannot reach it from outside")
        self._settings = settings
        self._frames = [make_exit(motor_id) for motor_id in motor_ids]
        self._bus: can.BusABC | None = open_bus(settings)

    def send_exits(self, repeats: int) -> bool:
        """See `ExitLine`."""
        taken = [self._send(frame) for _ in range(repeats) for frame in self._frames]
        return all(taken)

    def reopen(self) -> None:
        """See `ExitLine`."""
        try:
            if self._bus is not None:
                self._bus.shutdown()
            self._bus = None
            self._bus = open_bus(self._settings)
        except Exception:  # whatever the driver says, the next attempt must get its chance
            pass

    def drain(self, alone: bool) -> None:
        """See `ExitLine`."""
        del alone
        try:
            for _ in range(100):
                if self._bus is None or self._bus.recv(0) is None:
                    return
        except Exception:  # a lost adapter: the exit frames are still tried
            return

    def _send(self, frame: CanFrame) -> bool:
        message = can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False)
        try:
            if self._bus is not None:
                self._bus.send(message, timeout=_SEND_TIMEOUT)
            return self._bus is not None
        except Exception:
            return False


def open_line(settings: CanSettings, motor_ids: tuple[int, ...]) -> ExitLine:
    """The line of an adapter. Raises `HardwareError` as the classes do."""
    return (SlcanLine if settings.interface == "slcan" else CanLine)(settings, motor_ids)


def _slcan(frame: CanFrame) -> str:
    return f"t{frame.arbitration_id:03X}{len(frame.data)}{frame.data.hex().upper()}\r"


def _open_terminal(path: str) -> int:
    """A file descriptor without echo and translation; the rest, such as the rate, stays as the drive process set it."""
    file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        attributes = termios.tcgetattr(file)
        attributes[1] &= ~termios.OPOST
        attributes[3] &= ~(termios.ECHO | termios.ICANON | termios.ISIG | termios.IEXTEN)
        termios.tcsetattr(file, termios.TCSANOW, attributes)
    except termios.error:
        os.close(file)
        raise
    return file
