"""How far resumable work is: one line, and one sentence when it is stopped."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from aerodima.workbench.batch.worker_record import Say

BAR = 24
"""Width of the bar, characters."""


class Progress:
    """A bar with the time that is left, from the pace of this call.

    Args:
        say: told a line per piece.
        total: pieces of the whole work.
        there: of them done before.
    """

    def __init__(self, say: Say, total: int, there: int = 0) -> None:
        self.total, self.done, self._there, self._say = total, there, there, say
        self._start = time.monotonic()

    def one_more(self, what: str = "") -> None:
        """Counts a piece; `what` is said of it."""
        self.done += 1
        left = (time.monotonic() - self._start) / (self.done - self._there) * (self.total - self.done)
        filled = BAR * self.done // self.total
        count = f"{self.done:>{len(str(self.total))}}/{self.total}"
        self._say(f"[{'#' * filled + '.' * (BAR - filled)}] {count} {what:8} {left:5.0f} s to go")


@contextmanager
def saying_how_to_go_on(say: Say, kept: Callable[[], str]) -> Iterator[None]:
    """Whatever stops the work (Ctrl-C, an error): says what of it is kept, `kept()`, and how to go on."""
    try:
        yield
    except BaseException:
        say(f"stopped: {kept()} are kept; the same command goes on with the rest")
        raise


def terminal() -> Say:
    """Writes lines to stderr; on a terminal each takes the place of the one before, except messages of a stop."""
    shown = 0

    def say(line: str) -> None:
        nonlocal shown
        if not sys.stderr.isatty():
            print(line, file=sys.stderr, flush=True)
            return
        end = "" if line.startswith("[") or line.endswith("...") else "\n"
        print("\r" + line.ljust(shown), end=end, file=sys.stderr, flush=True)
        shown = 0 if end else len(line)

    return say
