"""A device's end of a pseudo-terminal, under a name that stays the same when it is plugged in again."""

from __future__ import annotations

import os
import pty
import tty
from pathlib import Path

from aerodima.workbench.errors import HardwareError

_MOST_BYTES = 4096


class PtyPort:
    """One port. The computer opens `link`, a symbolic link to the terminal.

    Attributes:
        link: path for the computer.
        plugged: whether there is a terminal now.
        dropped: writes that did not fit since the computer does not read.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.plugged = False
        self.dropped = 0
        self._master = self._slave = -1
        self.plug()

    def fileno(self) -> int:
        """Of the device's end; -1 while unplugged."""
        return self._master

    def plug(self) -> None:
        """Makes a new terminal, unless there is one."""
        if self.plugged:
            return
        try:
            self._master, self._slave = pty.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            temporary = self.link.with_name(f".{self.link.name}.new")
            temporary.unlink(missing_ok=True)
            temporary.symlink_to(os.ttyname(self._slave))
            os.replace(temporary, self.link)
        except OSError as error:
            raise HardwareError(f"{self.link}: no pseudo-terminal can be made: {error.strerror}") from None
        self.plugged = True

    def unplug(self) -> None:
        """Pulls the plug: the computer's end reads an error from now on."""
        if self.plugged:
            self.plugged = False
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1
            self.link.unlink(missing_ok=True)

    def read(self) -> bytes:
        """What has come; empty if nothing has."""
        try:
            return os.read(self._master, _MOST_BYTES) if self.plugged else b""
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Sends bytes; what does not fit is lost, as on a real line."""
        if not self.plugged or not data:
            return
        try:
            written = os.write(self._master, data)
        except OSError:
            written = 0
        self.dropped += written < len(data)
