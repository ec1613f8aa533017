"""Every frame of a run as a BLF file, written by its own thread so that a slow or full disk never holds up the loop."""

from __future__ import annotations

import queue
import threading
from io import RawIOBase
from pathlib import Path
from typing import BinaryIO, cast

import can

from aerodima.workbench.errors import HardwareError

_CONTAINER_BYTES = 2048
"""A block goes to the disk when it holds that much: about 20 frames, a tenth of a second of two motors at 100 Hz."""
_MOST_WAITING = 10_000


class TrafficLog:
    """BLF file of the frames that were sent and received.

    Args:
        file: written without a buffer of its own. `TrafficLog.create` makes one.

    Attributes:
        error: what stopped the writing, empty while it works. The bus goes on without its log.
        lost: frames that were not written since the disk was too slow or failed.
    """

    def __init__(self, file: RawIOBase) -> None:
        self._file = file
        self.error = ""
        self.lost = 0
        self._waiting: queue.Queue[can.Message | None] = queue.Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._write, name="can-traffic-log", daemon=True)
        self._thread.start()

    @classmethod
    def create(cls, path: Path) -> TrafficLog:
        """A log in a new file, `.blf`. Raises `HardwareError` if it exists already or cannot be made."""
        try:
            return cls(open(path, "x+b", buffering=0))
        except FileExistsError:
            raise HardwareError(f"{path}: exists already; a traffic log is never overwritten") from None
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
