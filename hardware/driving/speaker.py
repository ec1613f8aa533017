"""Lines of text for the listener of a drive, passed on without waiting for the listener."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable

Say = Callable[[str], None]
"""Function that receives a line of text for the user."""
_LAST_WAIT = 2.0
"""Longest wait for the listener at the end, s."""


class Speaker:
    """Passes lines on in their order, each on a thread: a listener that takes none, such as `print`
    on a stopped terminal, holds up neither the loop nor the log, and one that raises ends no drive.

    A thread has the scheduling of its caller: one of ordinary priority could be displaced while it
    holds the interpreter's lock, and the loop would wait.
    """

    def __init__(self, listener: Say) -> None:
        self._listener = listener
        self._lines: deque[str] = deque()
        self._turn = threading.Lock()

    def __call__(self, text: str) -> None:
        """Passes a line on and returns at once."""
        self._lines.append(text)
        threading.Thread(target=self._speak, name="speaker", daemon=True).start()

    def flush(self) -> None:
        """Waits until all lines are taken, for `_LAST_WAIT` s at most."""
        end = time.monotonic() + _LAST_WAIT
        while (self._lines or self._turn.locked()) and time.monotonic() < end:
            time.sleep(0.001)

    def _speak(self) -> None:
        with self._turn, contextlib.suppress(Exception):
            self._listener(self._lines.popleft())
