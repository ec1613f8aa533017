"""The Teensy of the emulated car: the firmware's own core between a serial port, the bus, the pins and the encoder."""

from __future__ import annotations

import math
import random

from aerodima.hardware.car.firmware_settings import FirmwareSettings
from aerodima.hardware.emulator.emulated_bus import EmulatedBus
from aerodima.hardware.emulator.event_log import EventLog
from aerodima.hardware.emulator.fault_board import FaultBoard
from aerodima.hardware.emulator.fault_script import Fault
from aerodima.hardware.firmware.firmware_core import CoreState, TeensyCore
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.protocol.sail_encoder import encode_angle
from aerodima.hardware.protocol.teensy import THROTTLE_PULSES, TeensyStatus


class EmulatedTeensy:
    """The core with what hangs on it.

    A hung Teensy does nothing, its outputs stay as they are; the processor's own watchdog restarts it after a while.

    Args:
        bus: None in the wiring `direct_can`. watches: it is the second node there, beside the computer's adapter.
        restart_time: s, of the processor's watchdog.
    """

    def __init__(
        self,
        settings: FirmwareSettings,
        bus: EmulatedBus | None,
        board: FaultBoard,
        events: EventLog,
        restart_time: float,
        now: float,
        watches: bool = False,
    ) -> None:
        self._watches = watches
        if watches and bus is not None:
            bus.watch = self._hear
        self._settings, self._bus, self._board, self._events = settings, bus, board, events
        self._restart_time = restart_time
        self._core = TeensyCore(settings, now)
        self._hung_since: float | None = None
        self._random = random.Random(0)
        self._last = CoreState(0, 0, TeensyStatus.WATCHDOG_ACTED, 0)
        self.turn(now)

    @property
    def state(self) -> CoreState:
        """Pulses and status."""
        return self._core.state

    @property
    def driving(self) -> bool:
        """Whether the throttle pulse is not the neutral one."""
        return self._last.throttle != THROTTLE_PULSES[1]

    def feed(self, data: bytes, now: float) -> None:
        """Takes bytes from the computer."""
        if self._hung_since is None or math.isinf(self._hung_since):
            self._core.feed(data, now)

    def set_sail(self, angle: float) -> None:
        """Angle of the sail, rad."""
        self._core.set_sail_word(encode_angle(angle, self._settings.encoder))

    def turn(self, now: float) -> bytes:
        """One turn of the firmware's loop; bytes for the computer."""
        if not self._runs(now):
            return b""
        self._core.step(now)
        for frame in self._core.frames():
            if self._board.entry(Fault.TEENSY_OFF_BUS) is not None:
                continue
            if self._watches and self._bus is not None:
                self._bus.carry_from_watch(frame)
            elif self._bus is not None:
                for answer in self._bus.carry(frame):
                    self._core.receive(answer)
        self._core.step(now)  # a reply that waited for the motors goes out at once
        self._note()
        reply = self._core.reply()
        if self._board.meets(Fault.SILENT, "teensy"):
            return b""
        if reply and self._board.meets(Fault.SERIAL_NOISE, "teensy"):
            return self._random.randbytes(12) + reply[7:]
        return reply

    def _hear(self, frame: CanFrame) -> None:
        runs = self._hung_since is None or math.isinf(self._hung_since)
        if runs and self._board.entry(Fault.TEENSY_OFF_BUS) is None:
            self._core.receive(frame)

    def _runs(self, now: float) -> bool:
        if self._board.entry(Fault.TEENSY_HUNG) is None:
            self._hung_since = None
            return True
        if self._hung_since is None:
            self._hung_since = now
        if now - self._hung_since <= self._restart_time:
            return False
        if not math.isinf(self._hung_since):
            self._events.add("teensy_restarted")
            self._core = TeensyCore(self._settings, now)
            self._hung_since = -math.inf
        return True

    def _note(self) -> None:
        state = self._core.state
        if state.status is not self._last.status:
            self._events.add("watchdog_acted" if state.status else "watchdog_released")
        idle = THROTTLE_PULSES[1]
        if (state.throttle == idle) is not (self._last.throttle == idle):
            self._events.add("throttle_neutral" if state.throttle == idle else "throttle_on")
        self._last = state
