"""What a wired car remembers of the last cycles and tells the operator: frames, sail angles, reports by radio."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from aerodima.hardware.car.mounting import Mounting
from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.motor_group import FramePort, PassingPort
from aerodima.hardware.devices.radio_link import RadioLink
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.protocol.radio import REPORT_PERIOD, Asks, CarReport, make_report
from aerodima.workbench.config.signal_table import IMU, STATUS, STATUS_SOURCES, TAIL_STATE, TAIL_TORQUE

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


_REST_FIRST = "put the switch in IDLE first"
_UNKNOWN_FAULT = 255
"""Codes of the status port are small; a larger one is still a fault."""


class CarReporter:
    """One car's reports.

    Args:
        has_tail: the car has tail motors. car: its number, which tells it from others on the channel.
    """

    def __init__(self, has_tail: bool = True, car: int = 0) -> None:
        self._has_tail, self._car = has_tail, car
        self._due = 0.0
        self._sequence = 0

    def turn(
        self, radio: RadioLink, reading: CarReading, now: float, asks: Asks = Asks.NOTHING, at_once: bool = False
    ) -> None:
        """Sends a report when one is due (`now` in s, monotonic), or at once."""
        if now < self._due and not at_once:
            return
        self._due = now + REPORT_PERIOD
        self._sequence += 1
        report = replace(report_of(reading, radio.stopped, asks, self._has_tail), car=self._car)
        radio.report(make_report(report, self._sequence))


def report_of(reading: CarReading, stopped: bool, asks: Asks = Asks.NOTHING, has_tail: bool = True) -> CarReport:
    """What a reading tells the operator; `stopped`: the emergency stop came; `asks`: what is wanted of the operator."""
    status, tail = STATUS.read(reading.status), TAIL_STATE.read(reading.tail_state)
    imu, torque = IMU.read(reading.imu), TAIL_TORQUE.read(reading.tail_torque)
    codes = [int(getattr(status, f"{source}_fault")) for source in STATUS_SOURCES]
    return CarReport(
        armed=status.armed == 1.0,
        stopped=stopped,
        mode=reading.operator.mode,
        faults=tuple(min(code, _UNKNOWN_FAULT) for code in codes),  # type: ignore[arg-type]
        yaw_rate=imu.gyro_z,
        roll=imu.roll,
        tail_pitch=tail.pitch_angle,
        tail_roll=tail.roll_angle,
        torque_pitch=torque.pitch,
        torque_roll=torque.roll,
        speed=float(reading.speed[0]),
        operator_age=status.operator_age,
        text=reading.fault_text or _REST_FIRST * (asks is Asks.REST),
        asks=asks,
        has_tail=has_tail,
    )
