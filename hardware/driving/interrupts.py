"""Ways in which a drive ends from outside or within its controller: signals, the alarm that
interrupts a slow controller, and a controller that exits the program.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.driving.plain_loop import Pilot, PilotStep

Stop = Callable[[str], None]
"""Function that stops the car for a reason, given in words."""
Handler = Callable[[int, FrameType | None], object]
"""Function that handles a signal; it gets the signal's number and the interrupted frame."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_MAX_INTERRUPTS = 3
"""Number of interrupts of one tick after which a controller that catches them is given up."""
leave = os._exit
"""The original `os._exit`, which ends the program at once; `stop_on_exit` replaces the attribute
while a controller runs."""
_HANG_TIME = 3.0
"""Time beyond its limit after which a tick that no alarm interrupts is given up, s."""
_WATCH_PERIOD = 0.25
"""Time between two checks for such a tick, s."""
_interrupts: list[int] = []
"""Numbers of the alarm signals since the last `time_limit` began."""
_deadlines: list[float] = []
"""Instant at which the running tick is given up, s, monotonic; empty between ticks."""


class TickTimeout(BaseException):
    """Raised within a controller that takes too long; no `Exception`, which it might catch."""


class ControllerExit(BaseException):
    """Raised in place of an `os._exit`, after which no log would be written and no reason given."""


@contextmanager
def stop_on_exit(stop: Stop) -> Iterator[None]:
    """Calls `stop` and raises `ControllerExit` where the block calls `os._exit`, on any thread;
    processes that it forks exit as usual.
    """
    owner = os.getpid()

    def refuse(status: int) -> NoReturn:
        if os.getpid() != owner:
            leave(status)
        text = f"os._exit({status}) was called"
        stop(text)
        raise ControllerExit(text)

    os._exit = refuse
    try:
        yield
    finally:
        os._exit = leave


@contextmanager
def handling(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Handles signals within the block by the handlers of their numbers, and by the earlier
    handlers after it.
    """
    earlier = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


@contextmanager
def handling_an_end(handler: Handler) -> Iterator[None]:
    """Handles every signal that ends a program within the block; on another thread than the main
    one, which alone receives signals, nothing is changed.
    """
    is_main = threading.current_thread() is threading.main_thread()
    with handling(dict.fromkeys(_SIGNALS if is_main else (), handler)):
        yield


@contextmanager
def stop_on_signals(stop: Stop, give_up: Stop) -> Iterator[list[int]]:
    """Calls `stop` with the name of a signal that ends a drive; yields the list of the signal
    numbers received.

    Within the block SIGALRM raises `TickTimeout`, for `time_limit`, and calls `give_up` with the
    cause once the controller has caught it too often. A thread calls `give_up` for a tick that no
    signal reaches, such as that of a controller that blocks signals or waits in a library.
    """
    numbers: list[int] = []
    over = threading.Event()

    def watch() -> None:
        while not over.wait(_WATCH_PERIOD):
            if any(time.monotonic() > deadline for deadline in list(_deadlines)):
                give_up("the controller does not come to an end")
                return

    def handle(number: int, frame: FrameType | None) -> None:
        del frame
        numbers.append(number)
        stop(signal.Signals(number).name)

    def interrupt(number: int, frame: FrameType | None) -> None:
        if not _deadlines:  # the alarm of a tick that has ended
            return
        _interrupts.append(number)
        if len(_interrupts) >= _MAX_INTERRUPTS:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            give_up("the controller goes on after it was interrupted")
        raise TickTimeout("the controller does not come to an end")

    handlers = {**dict.fromkeys(_SIGNALS, handle), signal.SIGALRM: interrupt}
    threading.Thread(target=watch, name="hang-watch", daemon=True).start()
    try:
        with handling(handlers):
            yield numbers
    finally:
        over.set()


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raises `TickTimeout` within a block that takes longer than `seconds`, and again after every
    further `seconds`, at most 1 s; a block that no signal reaches is given up later.
    """
    _interrupts.clear()
    _deadlines[:] = [time.monotonic() + seconds + _HANG_TIME]
    signal.setitimer(signal.ITIMER_REAL, seconds, min(seconds, 1.0))
    try:
        yield
    finally:
        end_time_limit()


def end_time_limit() -> None:
    """Ends the alarms and the deadline of a tick; whoever catches a `TickTimeout` calls it too,
    since an alarm may come just before the block ends them itself.
    """
    _deadlines.clear()  # first: an alarm that comes now raises nothing
    signal.setitimer(signal.ITIMER_REAL, 0.0)


class TimedPilot(Pilot):
    """A pilot whose tick is interrupted after `max_time` s."""

    def __init__(self, pilot: Pilot, max_time: float) -> None:
        self.start = pilot.start  # type: ignore[method-assign]
        self._step = pilot.step
        self._max_time = max_time

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """Steps the pilot; see `Pilot`."""
        with time_limit(self._max_time):
            return self._step(time, reading)
