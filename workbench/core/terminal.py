"""Lines for a terminal or a pipe that may take none: nothing waits for whoever reads them.

A terminal that is stopped (Ctrl-S) or a reader that no longer reads would hold up the program in
`write`, and with it a car that is driven. Lines that are not taken wait for the next one, and for
`_LAST_WAIT` at the end of the program.
"""

import atexit
import os
import stat
import sys
import threading
import time

_LAST_WAIT = 2.0
"""Longest wait for a reader at the end of the program, s."""
_POLL_PERIOD = 0.02
"""Time between two attempts to write then, s."""
_FLAGS = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY
_waiting = {"stdout": b"", "stderr": b""}
_lock = threading.RLock()


def say(text: str, err: bool = False) -> None:
    """Writes a line to stdout or stderr and returns at once; one whose reader has gone is
    dropped.
    """
    name = "stderr" if err else "stdout"
    with _lock:
        _waiting[name] += f"{text}\n".encode(errors="backslashreplace")
        _write(name)


def say_error(text: str) -> None:
    """Writes a line to stderr as `say` does."""
    say(text, err=True)


def await_reader() -> None:
    """Waits until all lines are taken, `_LAST_WAIT` at most."""
    end = time.monotonic() + _LAST_WAIT
    while any(_waiting.values()) and time.monotonic() < end:
        time.sleep(_POLL_PERIOD)
        with _lock:
            for name in _waiting:
                _write(name)


def _write(name: str) -> None:
    """Writes what the reader of a stream takes now.

    The stream is opened anew: a flag that is set on its descriptor would be set for the shell too.
    """
    stream = getattr(sys, name)
    data = _waiting[name]
    _waiting[name] = b""
    try:
        number = stream.fileno()
        if stat.S_ISREG(os.fstat(number).st_mode):
            raise ValueError("a file takes everything, at its own place")
        number = os.open(f"/proc/self/fd/{number}", _FLAGS)
    except (OSError, ValueError, AttributeError):  # memory, or a system without this way
        print(data.decode(), end="", file=stream, flush=True)
        return
    try:
        while data:
            data = data[os.write(number, data) :]
    except BlockingIOError:
        _waiting[name] = data
    except OSError:  # the reader has gone
        pass
    finally:
        os.close(number)


atexit.register(await_reader)
