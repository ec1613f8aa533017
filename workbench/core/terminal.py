"""Writes lines to a terminal or a pipe without waiting for whoever reads them.

A terminal that is stopped (Ctrl-S) or a reader that no longer reads would hold up the program in
`write`, and with it a car that is driven. Lines that cannot be written yet are kept until the next
line comes, and at the end of the program for at most `_LAST_WAIT`.
"""

import atexit
import os
import select
import stat
import sys
import threading
import time
from contextlib import suppress

_LAST_WAIT = 2.0
"""Longest wait for a reader at the end of the program, s."""
_POLL_PERIOD = 0.02
"""Time between two attempts to write at the end of the program, s."""
_CHUNK = 128
"""Number of bytes that a terminal or a socket accepts at once when it reports that it is ready."""
_FLAGS = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY
_waiting = {"stdout": b"", "stderr": b""}
_lock = threading.RLock()


def say(text: str, err: bool = False) -> None:
    """Writes a line to stdout or stderr and returns at once; the line is dropped if its reader has
    gone or the disk is full.
    """
    name = "stderr" if err else "stdout"
    with _lock:
        _waiting[name] += f"{text}\n".encode(errors="backslashreplace")
        _write(name)


def say_error(text: str) -> None:
    """Writes a line to stderr as `say` does."""
    say(text, err=True)


def await_reader() -> None:
    """Waits until all lines are written, for at most `_LAST_WAIT`."""
    end = time.monotonic() + _LAST_WAIT
    while any(_waiting.values()) and time.monotonic() < end:
        time.sleep(_POLL_PERIOD)
        with _lock:
            for name in _waiting:
                _write(name)


def _write(name: str) -> None:
    """Writes as many waiting bytes of a stream as its reader accepts now.

    The stream is opened anew: a flag that is set on its descriptor would be set for the shell too.
    """
    stream = getattr(sys, name)
    data = _waiting[name]
    _waiting[name] = b""
    try:
        number = stream.fileno()
    except (OSError, ValueError, AttributeError):  # a stream in memory
        print(data.decode(), end="", file=stream, flush=True)
        return
    with suppress(OSError):  # the reader has gone, or the disk is full
        if stat.S_ISREG(os.fstat(number).st_mode):  # accepts everything, at its own offset
            stream.flush()
            os.write(number, data)
            return
        try:
            opened = os.open(f"/proc/self/fd/{number}", _FLAGS)
        except OSError:  # a socket, the terminal of another user, a system without this way
            _waiting[name] = _write_while_ready(number, data)
            return
        try:
            while data:
                data = data[os.write(opened, data) :]
        except BlockingIOError:
            _waiting[name] = data
        finally:
            os.close(opened)


def _write_while_ready(number: int, data: bytes) -> bytes:
    """Writes what a blocking descriptor accepts without waiting; returns the rest."""
    poll = select.poll()
    poll.register(number, select.POLLOUT)
    while data and poll.poll(0):
        data = data[os.write(number, data[:_CHUNK]) :]
    return data


atexit.register(await_reader)
