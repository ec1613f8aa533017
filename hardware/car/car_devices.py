"""The open devices of a car, whichever way it is wired; what was opened is closed again when a later one fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.car.watchdogs import Watchdog
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.motor_group import FramePort
from aerodima.hardware.devices.radio_link import RadioLink
from aerodima.hardware.devices.sensor_threads import SensorThread, gps_thread, imu_thread
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.devices.ublox import GpsSample
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.device_lock import DeviceLock, Say, can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink, SerialSettings, open_serial
from aerodima.workbench.errors import HardwareError


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


_SENSOR_TIMEOUT = 0.01


@contextmanager
def closing_on_error(*last: DeviceLock) -> Iterator[list[Callable[[], None]]]:
    """A list of what to close; all of it is closed when the block raises. Locks are given back after all else."""
    closers: list[Callable[[], None]] = []
    try:
        yield closers
    except BaseException:
        for close in reversed(closers):
            close()
        for lock in last:
            lock.close()
        raise
    closers += [lock.close for lock in last]


def lock_car(ports: CarPorts, say: Say, can: CanSettings | None = None) -> list[DeviceLock]:
    """The locks of every device of a car for a drive; that of its CAN adapter first, for the watchdog to inherit.

    Raises `HardwareError` as `lock_devices` does, with nothing locked.
    """
    fitted = (ports.teensy, ports.imu, ports.gps, ports.radio)
    locks = [] if can is None else [lock_devices([can_address(can)], "a drive", say)]
    try:
        return [*locks, lock_devices([device.path for device in fitted if device is not None], "a drive", say)]
    except BaseException:
        for lock in locks:
            lock.close()
        raise


def open_common(
    ports: CarPorts,
    safety: DriveSafety,
    closers: list[Callable[[], None]],
    motor_port: Callable[[TeensyLink], FramePort],
) -> Devices:
    """Teensy, IMU, GPS and radio, and what `motor_port` makes of the Teensy's link.

    Raises:
        HardwareError: names the device that cannot be opened.
    """
    serial = _open("teensy", ports.teensy.settings, closers)
    teensy = TeensyLink(serial, ports.motor_ids, ports.profile, ports.string_form)
    port = motor_port(teensy)
    imu_settings = ports.imu.settings
    with _named("imu"):
        imu = imu_thread(lambda: open_serial(imu_settings, _SENSOR_TIMEOUT), safety.imu_silence)
    closers.append(imu.close)
    gps = None
    if ports.gps is not None:
        gps_settings = ports.gps.settings
        with _named("gps"):
            gps = gps_thread(lambda: open_serial(gps_settings, _SENSOR_TIMEOUT), safety.gps_silence)
        closers.append(gps.close)
    radio_serial = None if ports.radio is None else _open("radio", ports.radio.settings, closers)
    radio = None
    if ports.radio is not None and radio_serial is not None:
        radio = RadioLink(radio_serial, ports.radio.operator, ports.radio.escaped)
    return Devices(port, teensy, imu, gps, radio, radio_serial, None, closers)


def _open(name: str, settings: SerialSettings, closers: list[Callable[[], None]]) -> SerialLink:
    with _named(name):
        link = SerialLink.open(settings)
    closers.append(link.close)
    return link


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Says which of the devices it was."""
    try:
        yield
    except HardwareError as error:
        raise HardwareError(f"{name}: {error}") from None
