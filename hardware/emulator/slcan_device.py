"""The far side of a serial CAN adapter: lines of the slcan protocol in and out (as CANable and Lawicel adapters)."""

from __future__ import annotations

import random

from aerodima.hardware.emulator.emulated_bus import EmulatedBus
from aerodima.hardware.emulator.fault_board import FaultBoard
from aerodima.hardware.emulator.fault_script import Fault
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError

_OK, _ERROR = b"\r", b"\a"
_LONGEST_LINE = 64
_MOST_HEARD = 4096


class SlcanAdapter:
    """Bytes from the computer to frames on the bus, answers to bytes.

    Frames pass only while the channel is open; a refused line is answered by the bell.
    """

    def __init__(self, bus: EmulatedBus, board: FaultBoard, seed: int = 0) -> None:
        self._bus, self._board = bus, board
        self._random = random.Random(seed)
        self._line = b""
        self._open = False
        self._heard = b""

    def hear(self, frame: CanFrame) -> None:
        """A frame of another node on the bus."""
        if self._open and len(self._heard) < _MOST_HEARD:
            self._heard += write_frame(frame)

    def take(self) -> bytes:
        """What other nodes have sent since the last call, for the computer."""
        heard, self._heard = self._heard, b""
        return b"" if self._board.meets(Fault.SILENT, "can") else heard

    def feed(self, data: bytes) -> bytes:
        """What the adapter sends back for these bytes."""
        *lines, rest = (self._line + data).split(b"\r")
        self._line = rest[-_LONGEST_LINE:]
        return b"".join(self._obey(line) for line in lines if line)

    def _obey(self, line: bytes) -> bytes:
        kind = line[:1]
        if kind in (b"t", b"T"):
            return self._transmit(line)
        if kind == b"O":
            if self._open:
                return _ERROR
            self._open = True
            self._bus.reopened()
        elif kind == b"C":
            self._open = False
        elif kind not in (b"S", b"s", b"Y"):
            return _ERROR
        return _OK

    def _transmit(self, line: bytes) -> bytes:
        frame = read_frame(line)
        if frame is None or not self._open or self._bus.off:
            return _ERROR
        answers = b"".join(write_frame(answer) for answer in self._bus.carry(frame))
        if self._board.meets(Fault.SILENT, "can"):
            return b""
        if self._board.meets(Fault.SERIAL_NOISE, "can"):
            return self._random.randbytes(8) + answers[3:]
        return answers


def read_frame(line: bytes) -> CanFrame | None:
    """The frame of a `t` or `T` line without its end; None if it is none."""
    digits = 3 if line[:1] == b"t" else 8
    try:
        identifier, length = int(line[1 : 1 + digits], 16), int(line[1 + digits : 2 + digits], 16)
        data = bytes.fromhex(line[2 + digits :].decode("ascii"))
        return CanFrame(identifier, data, extended=digits == 8) if len(data) == length else None
    except (ValueError, FrameError):
        return None


def write_frame(frame: CanFrame) -> bytes:
    """The line that reports a frame, with its end."""
    head = f"T{frame.arbitration_id:08X}" if frame.extended else f"t{frame.arbitration_id:03X}"
    return f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode()
