"""Faults of the car's sensors, its Teensy and its operator, as codes on the port `status`."""

from __future__ import annotations

from enum import IntEnum


class SourceFault(IntEnum):
    """Fault codes of sail, imu, speed and operator on `status`; those of the tail motors are `MotorFault`."""

    NONE = 0
    NOT_FITTED = 1
    """As the simulated station says it of parts that its car does not have."""
    NO_SAMPLE_YET = 2
    SILENT = 3
    LOST = 4
    """Its port has gone."""
    REPORTED = 5
    """The device itself reports a fault: error of the IMU, watchdog of the Teensy."""
    NO_FIX = 6
    """The GPS receiver lives and knows no speed."""
    STOPPED = 7
    """The operator asked for an emergency stop."""
