"""The operator's radio: commands with their age, a heartbeat that must live, and a stop that
latches.

The link only reports; what follows from silence (throttle 0, tail to hold, then exit) is decided
where the car is driven.
"""

import math

from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.radio import (
    EmergencyStop,
    Heartbeat,
    OperatorCommand,
    RadioMode,
    decode,
)
from aerodima.hardware.protocol.xbee import ApiStream, make_transmit
from aerodima.hardware.transport.serial_link import SerialLink

IDLE = OperatorCommand(RadioMode.IDLE)
_MAX_AHEAD = 64
"""Largest step of the count from one heartbeat to the next. Whoever counts upwards from anywhere
satisfies it within 192 counts (9.6 s at 20 Hz); a shorter recording that is sent for ever never
does."""


class RadioLink:
    """Commands of the operator, from an XBee module in API mode.

    Args:
        link: open serial link; the caller closes it.
        silent: age of command and heartbeat at which the operator counts as silent, s.
        operator: 64-bit serial number of the operator's module; others are ignored. None accepts
            whoever sends.

    Attributes:
        command: last command; idle before the first.
        stopped: whether an emergency stop came; nothing clears it.
        rejected: number of frames that are no message.
        last_error: reason why the last of these was rejected; empty before the first.
    """

    def __init__(self, link: SerialLink, silent: float, operator: int | None = None) -> None:
        self._link = link
        self._silent = silent
        self._operator = operator
        self._stream = ApiStream()
        self._sender: int | None = None
        self._counter: int | None = None
        self._set_back = False
        self._command_time = -math.inf
        self._heartbeat_time = -math.inf
        self.command = IDLE
        self.stopped = False
        self.rejected = 0
        self.last_error = ""

    def poll(self) -> None:
        """Reads what came in. A damaged or foreign frame renews no age."""
        for arrival, data in self._link.poll():
            for packet in self._stream.feed(data):
                if self._operator in (None, packet.address):
                    self._receive(packet.data, arrival, packet.address)

    def age(self, now: float) -> float:
        """Returns the seconds since the older of the last command and the last heartbeat that
        counts upwards: the age that the dead-man switch uses.

        Both are needed: a transmitter that repeats its last command or heartbeat for ever is not an
        operator.
        """
        return now - min(self._command_time, self._heartbeat_time)

    def fault(self, now: float) -> tuple[SourceFault, str]:
        """Returns why the operator cannot be relied on at present, and the same in words."""
        if self.stopped:
            return SourceFault.STOPPED, "the operator asked for an emergency stop"
        if self._link.fault:
            return SourceFault.LOST, f"the radio's port is lost: {self._link.fault}"
        age = self.age(now)
        if math.isinf(age):
            text = "the operator's radio has not been heard yet"
            if self.rejected:
                text += f" ({self.rejected} frames rejected: {self.last_error})"
            return SourceFault.NO_SAMPLE_YET, text
        if age > self._silent:
            again = "; its heartbeat does not count on from the last one" if self._set_back else ""
            return SourceFault.SILENT, f"the operator's radio is silent for {age:.2f} s{again}"
        return SourceFault.NONE, ""

    def report(self, data: bytes) -> None:
        """Sends data to the module that was heard last; to nobody before."""
        if self._sender is not None:
            self._link.write(make_transmit(data, self._sender))

    def _receive(self, data: bytes, arrival: float, sender: int) -> None:
        try:
            message = decode(data)
        except FrameError as error:
            self.rejected += 1
            self.last_error = str(error)
            return
        self._sender = sender
        if isinstance(message, EmergencyStop):
            self.stopped = True
        elif isinstance(message, Heartbeat):
            known = message.counter - 1 if self._counter is None else self._counter
            self._set_back = not 0 < (message.counter - known) % 256 <= _MAX_AHEAD
            if not self._set_back:
                self._counter = message.counter
                self._heartbeat_time = arrival
        else:
            self.command = message
            self._command_time = arrival
