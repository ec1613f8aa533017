"""The Teensy as the watchdog on the bus of the computer's adapter, in the wiring `watched_can`.

The computer sends the Teensy a heartbeat every cycle, and the Teensy answers each on the same bus.
A missing answer stops the car: a Teensy that is dead, or that cannot reach the bus, would not
switch the motors off either.
"""

import math
import time
from enum import IntEnum

from aerodima.hardware.devices.device_states import FramePort
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError, TimedFrames
from aerodima.hardware.protocol.teensy import SWITCHED_OFF, TeensyStatus
from aerodima.workbench.core.errors import HardwareError

HEARTBEAT_ID = 0x7A0
"""CAN id of the computer's heartbeat."""
ANSWER_ID = 0x7A1
"""CAN id of the Teensy's answer to it."""
_MAGIC = 0xAD
"""First byte of heartbeats and answers."""


class HeartbeatState(IntEnum):
    """State that the computer reports.

    TRIP: the Teensy must switch the motors off, since the computer cannot.
    """

    OFF = 0
    ARMED = 1
    TRIP = 2


def make_heartbeat(state: HeartbeatState, counter: int) -> CanFrame:
    """Makes the heartbeat; the counter is taken modulo 256 and must count upwards."""
    counter %= 256
    return CanFrame(HEARTBEAT_ID, bytes([_MAGIC, state, counter, ~(state ^ counter) & 0xFF]))


def decode_answer(frame: CanFrame) -> tuple[TeensyStatus, int]:
    """Decodes the status of the Teensy and the counter of the heartbeat that it answers.

    Raises `FrameError` for any other frame.
    """
    data = frame.data
    named = not frame.extended and frame.arbitration_id == ANSWER_ID
    sound = len(data) == 4 and data[0] == _MAGIC and data[3] == ~(data[1] ^ data[2]) & 0xFF
    if not named or not sound or data[1] not in tuple(TeensyStatus):
        raise FrameError(f"{frame}: is no answer of id {ANSWER_ID:#x}")
    return TeensyStatus(data[1]), data[2]


class BusWatch:
    """A `FramePort` that takes the Teensy's answers out of what comes from the bus, and sends the
    heartbeats.

    Args:
        port: open bus.
        answer_timeout: longest time that an answer may take, s.
    """

    def __init__(self, port: FramePort, answer_timeout: float) -> None:
        self._port = port
        self._timeout = answer_timeout
        self._state = HeartbeatState.OFF
        self._counter = 0
        self._unanswered_since: float | None = None
        self._polled = -math.inf
        self._status: TeensyStatus | None = None

    # -- as a port

    @property
    def fault(self) -> int:
        """Fault code of the port."""
        return self._port.fault

    @property
    def fault_text(self) -> str:
        """Fault of the port in words."""
        return self._port.fault_text

    def send(self, frame: CanFrame, urgent: bool = False) -> bool:
        """Passes a frame on."""
        return self._port.send(frame, urgent)

    def flush(self) -> bool:
        """Waits for a short while until the port has sent everything."""
        return self._port.flush()

    def poll(self) -> TimedFrames:
        """Returns the port's frames without the answers of the Teensy."""
        frames = self._port.poll()
        self._polled = time.monotonic()
        for _, frame in frames:
            if frame.arbitration_id == ANSWER_ID:
                self._receive(frame)
        return [(when, frame) for when, frame in frames if frame.arbitration_id != ANSWER_ID]

    # -- as a watchdog

    @property
    def reason(self) -> str:
        """Reason not to rely on the watchdog; empty while the Teensy answers and has not switched
        everything off.
        """
        # Counted until the bus was last polled: a loop that has stood still since is no silence of
        # the Teensy.
        waited = 0.0 if self._unanswered_since is None else self._polled - self._unanswered_since
        if waited > self._timeout:
            return f"the Teensy does not answer on the CAN bus for {waited:.2f} s"
        if self._status is None:
            return (
                "the Teensy has not answered on the CAN bus yet; was it built with --wiring "
                "watched_can?"
            )
        return SWITCHED_OFF.get(self._status, "")

    def arm(self) -> None:
        """Makes the Teensy wait for heartbeats.

        Raises `HardwareError` if it does not answer, or has acted.
        """
        if self.reason:
            raise HardwareError(self.reason)
        self._send(HeartbeatState.ARMED)

    def heartbeat(self) -> None:
        """Sends a heartbeat as a sign that the loop lives."""
        self._send(self._state)

    def disarm(self) -> None:
        """Makes the following heartbeats report that the motors are off."""
        self._send(HeartbeatState.OFF)

    def trip(self) -> None:
        """Asks the Teensy to switch the motors off."""
        self._send(HeartbeatState.TRIP)

    def _send(self, state: HeartbeatState) -> None:
        self._state = state
        self._counter += 1
        if self._unanswered_since is None:
            self._unanswered_since = time.monotonic()
        self._port.send(make_heartbeat(state, self._counter))

    def _receive(self, frame: CanFrame) -> None:
        try:
            status, counter = decode_answer(frame)
        except FrameError:
            return
        # An answer that waited in a buffer still shows that the Teensy lives.
        if (self._counter - counter) % 256 < 128:
            self._status = status
            self._unanswered_since = None
