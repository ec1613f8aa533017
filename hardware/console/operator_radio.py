"""The console's end of the operator's radio: passes on what a page sent, repeats an emergency stop,
receives reports.

Heartbeats are never made here: without a page that lives the radio is silent, and the car's
dead-man acts. A connection that ends says sooner that the page has gone: the car is sent to rest at
once.
"""

import math

from aerodima.hardware.devices.radio_link import IDLE
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.radio import (
    CarReport,
    OperatorCommand,
    RadioMode,
    decode_report,
    make_command,
    make_emergency_stop,
    make_heartbeat,
)
from aerodima.hardware.protocol.xbee import BROADCAST, ApiStream, Packet, make_transmit
from aerodima.hardware.transport.serial_link import SerialLink

_REPEAT = 0.05
"""Time between two emergency stops, until the car reports the stop, s."""
REPORT_SILENCE = 0.5
"""Age beyond which the last report says nothing about the present car, s."""
_LOST_SHOWN = 1.0
"""Least time for which a port that was lost counts as lost, s: one that comes back only to fail
again is no link."""


class OperatorRadio:
    """Radio of the console: commands out, reports in. Times are in s, monotonic.

    Args:
        link: open serial link; the caller closes it.
        receiver: serial number of the car's module; reports of other modules are not believed.
            `BROADCAST`: the module that is heard first, as long as this object lives.
        car: number of the car; reports of another car are not believed.

    Attributes:
        stopped_by: source of the emergency stop, which stays until `reset`; empty for none.
        confirmed: whether the car has reported that stop.
        mode: mode of the last command that was passed on.
        report: last report of the car; None before the first.
        foreign: number of reports of other modules or cars.
    """

    def __init__(self, link: SerialLink, receiver: int = BROADCAST, car: int = 0) -> None:
        self._sender = None if receiver == BROADCAST else receiver
        self._car = car
        self._link = link
        self._receiver = receiver
        self._stream = ApiStream()
        self._stop_due = math.inf
        self._report_time = -math.inf
        self._lost = -math.inf
        self._losses = link.losses
        self.stopped_by = ""
        self.confirmed = False
        self.mode = RadioMode.IDLE
        self._was_idle = False
        self.report: CarReport | None = None
        self.foreign = 0

    @property
    def stopped(self) -> bool:
        """Returns whether an emergency stop is in force."""
        return bool(self.stopped_by)

    def report_age(self, now: float) -> float:
        """Returns the seconds since the car's last report; infinite before the first."""
        return now - self._report_time

    def fault(self, now: float) -> str:
        """Returns why nothing reaches the car from here; empty while the port takes frames."""
        if fault := self._link.fault:
            return f"the radio's port is lost: {fault}"
        if now - self._lost < _LOST_SHOWN:
            return f"the radio's port was lost: {self._link.error}"
        return ""

    def armed(self, now: float) -> bool:
        """Returns whether the car has just reported that it is armed, and can be reached."""
        heard = (
            self.report is not None and self.report.armed and self.report_age(now) <= REPORT_SILENCE
        )
        return heard and not self.fault(now)

    def heartbeat(self, count: int, command: OperatorCommand, now: float) -> bool:
        """Passes a page's heartbeat and command on; returns whether the port took them, which it
        does not while it has a fault.

        A car at rest leaves it only when it has just reported that it is armed, and only for a mode
        that was chosen after that: the page itself must have asked for rest since the last mode
        that was not passed on.

        Raises:
            FrameError: a value that no frame carries.
        """
        if self.fault(now):
            self.mode = RadioMode.IDLE
            self._was_idle = False
            return False
        leaves = self._was_idle and self.armed(now)
        allowed = not self.stopped and (self.mode is not RadioMode.IDLE or leaves)
        passed = command if allowed else IDLE
        if command.mode is RadioMode.IDLE:
            self._was_idle = True
        elif not allowed:
            self._was_idle = False
        frames = [make_command(passed), make_heartbeat(count)]
        self.mode = passed.mode
        self._send([*self._stops(), *frames])
        return True

    def stop(self, by: str, now: float) -> None:
        """Sends an emergency stop at once and until the car reports it."""
        self.stopped_by = self.stopped_by or by
        self.confirmed = False
        self.mode = RadioMode.IDLE
        self._was_idle = False
        self._stop_due = now + _REPEAT
        self._send([make_emergency_stop()])

    def send_idle(self) -> None:
        """Sends a car that is driven back to rest, once and without a heartbeat: whoever drove it
        has gone.

        A stop that the car has not reported yet goes out once more.
        """
        self._was_idle = False
        frames = [*self._stops(), *([] if self.mode is RadioMode.IDLE else [make_command(IDLE)])]
        self.mode = RadioMode.IDLE
        if frames:
            self._send(frames)

    def reset(self) -> None:
        """Forgets the emergency stop, by hand only.

        The car keeps its own until it is armed anew.
        """
        self.stopped_by = ""
        self.confirmed = False
        self._stop_due = math.inf

    def poll(self, now: float) -> None:
        """Reads what came in, checks the port and repeats a stop that is due."""
        if self._link.losses != self._losses:
            self._losses = self._link.losses
            self._lost = now
        for arrival, data in self._link.poll():
            for packet in self._stream.feed(data):
                self._receive(packet, arrival)
        if self._stops() and now >= self._stop_due:
            self._stop_due = now + _REPEAT
            self._send(self._stops())

    def _receive(self, packet: Packet, arrival: float) -> None:
        if self._sender not in (None, packet.address):
            self.foreign += 1
            return
        try:
            report = decode_report(packet.data)
        except FrameError:
            return
        if report.car != self._car:
            self.foreign += 1
            return
        self._sender = packet.address
        self.report = report
        self._report_time = arrival
        # A car that is armed anew under a stop is stopped again.
        self.confirmed = self.stopped and self.report.stopped

    def _stops(self) -> list[bytes]:
        if self.stopped and not self.confirmed:
            return [make_emergency_stop()]
        return []

    def _send(self, frames: list[bytes]) -> None:
        """Sends all frames of a moment in one piece: the next piece may replace it, and carries an
        unconfirmed stop as well.
        """
        self._link.write(b"".join(make_transmit(frame, self._receiver) for frame in frames))
