"""The open devices of a car, whichever way it is wired."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.motor_group import FramePort
from aerodima.hardware.devices.radio_link import RadioLink
from aerodima.hardware.devices.sensor_thread import SensorThread
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.devices.ublox import GpsSample
from aerodima.hardware.transport.serial_link import SerialLink


class Watchdog(Protocol):
    """What switches the motors off when this process dies, as a `WatchdogProcess` does."""

    @property
    def healthy(self) -> bool:
        """Whether it lives and has not acted."""
        ...

    @property
    def reason(self) -> str:
        """Why it is not healthy."""
        ...

    def arm(self) -> None:
        """From now on it waits for heartbeats; `HardwareError` if it is not healthy."""
        ...

    def beat(self) -> None:
        """The loop lives."""
        ...

    def disarm(self) -> None:
        """The motors are off; no heartbeats follow."""
        ...

    def trip(self) -> None:
        """Asks it to switch the motors off."""
        ...

    def close(self) -> None:
        """Ends it in order."""
        ...


@dataclass
class Devices:
    """The open devices of a car.

    Attributes:
        motor_port: where the motors' frames go: the CAN bus, or the Teensy itself in the bridge.
        teensy: servo, throttle, sail. imu, gps, radio: None where it is not fitted.
        closers: called at the end, in order.
        watchdog: None where the Teensy's firmware is the watchdog.
        radio_serial: under `radio`, to tell a lost port from a silent operator.
        traffic_error: what stopped the log of the CAN traffic; empty while it works, or when there is none.
    """

    motor_port: FramePort
    teensy: TeensyLink
    imu: SensorThread[Bno055Sample]
    gps: SensorThread[GpsSample] | None
    radio: RadioLink | None
    radio_serial: SerialLink | None
    watchdog: Watchdog | None
    closers: list[Callable[[], None]]
    traffic_error: Callable[[], str] = lambda: ""
