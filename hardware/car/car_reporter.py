"""Tells the operator over the radio what the car's loop knows, at its own slower pace."""

from __future__ import annotations

from dataclasses import replace

from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.radio_link import RadioLink
from aerodima.hardware.protocol.car_report import PERIOD, Asks, CarReport, make_report
from aerodima.workbench.config.signal_table import IMU, STATUS, STATUS_SOURCES, TAIL_STATE, TAIL_TORQUE

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
        self._due = now + PERIOD
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
