"""Signals during a drive: those that end it, and the alarm that interrupts a slow controller."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.driving.plain_loop import Pilot, PilotStep

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class TickTimeout(BaseException):
    """Raised within a controller that takes too long; of no kind that it may want to catch."""


@contextmanager
def stop_on_signals(stop: Callable[[str], None]) -> Iterator[list[int]]:
    """Calls `stop` with the name of a signal that ends a drive; yields the numbers that came.

    Within the block SIGALRM raises `TickTimeout`, for `time_limit`.
    """
    numbers: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        del frame
        numbers.append(number)
        stop(signal.Signals(number).name)

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise TickTimeout("the controller does not come to an end")

    handlers = {number: signal.signal(number, handle) for number in _SIGNALS}
    handlers[signal.SIGALRM] = signal.signal(signal.SIGALRM, interrupt)
    try:
        yield numbers
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raises `TickTimeout` within the block, and again, once it takes longer; what no signal
    reaches goes on.
    """
    signal.setitimer(signal.ITIMER_REAL, seconds, seconds)
    try:
        yield
    finally:
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
