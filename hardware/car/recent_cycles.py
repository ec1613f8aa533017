"""What a wired car remembers of the last cycles: the frames that came in, and the sail's angles."""

from __future__ import annotations

import math
from collections import deque

from aerodima.hardware.car.mounting import Mounting
from aerodima.hardware.devices.motor_group import FramePort, PassingPort
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.protocol.can_frame import CanFrame

_HEARD = 400
"""Frames that are kept: two seconds of two motors."""
_RATE_WINDOW = 0.02
"""s; of the sail's rate, as the simulated encoder has it."""


class ListeningPort(PassingPort):
    """A port that keeps the newest frames, for the check of the firmware profile."""

    def __init__(self, port: FramePort) -> None:
        super().__init__(port)
        self.heard: deque[tuple[float, CanFrame]] = deque(maxlen=_HEARD)

    def poll(self) -> list[tuple[float, CanFrame]]:
        """The port's frames, which are kept too."""
        frames = self._port.poll()
        self.heard.extend(frames)
        return frames


class SailRate:
    """Sail angle and its rate from the Teensy's replies, each with the time at which the Teensy sent it."""

    def __init__(self) -> None:
        self._past: deque[tuple[float, float]] = deque(maxlen=64)
        self._seen = (0.0, 0.0)

    def of(self, teensy: TeensyLink, mounting: Mounting) -> tuple[float, float]:
        """Angle in [0, 2 pi) rad and rate rad/s; zeros before the first reply."""
        sent = teensy.sent_time
        if not math.isfinite(sent) or (self._past and sent <= self._past[-1][0]):
            return self._seen
        angle = mounting.sail_angle(teensy.sail)
        self._past.append((sent, angle))
        while len(self._past) > 2 and sent - self._past[1][0] >= _RATE_WINDOW - 1e-3:
            self._past.popleft()
        span = sent - self._past[0][0]
        rate = math.remainder(angle - self._past[0][1], 2.0 * math.pi) / span if span > 1e-3 else 0.0
        self._seen = angle, rate
        return self._seen
