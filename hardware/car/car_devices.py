"""The open devices of a car, whichever way it is wired; what was opened is closed again when a later one fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from aerodima.hardware.car.bus_watch import BusWatch
from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.device_states import FramePort
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.devices.radio_link import RadioLink
from aerodima.hardware.devices.sensor_threads import Bno055Session, GpsSession, SensorThread
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.devices.ublox import GpsSample
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.device_lock import DeviceLock, can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink, SerialSettings, open_serial
from aerodima.workbench.errors import HardwareError


@dataclass
class Devices:
    """The open devices of a car.

    Attributes:
        group: the motors, on the CAN bus or, in the bridge, on the Teensy itself.
        teensy: servo, throttle, sail. imu, gps, radio: None where it is not fitted.
        closers: called at the end, in order.
        watchdog: on the motors' bus; None in the bridge, where the strings are the heartbeat.
        traffic_error: what stopped the log of the CAN traffic; empty while it works, or when there is none.
    """

    group: MotorGroup
    teensy: TeensyLink
    imu: SensorThread[Bno055Sample]
    gps: SensorThread[GpsSample] | None
    radio: RadioLink | None
    watchdog: BusWatch | None
    closers: list[Callable[[], None]]
    traffic_error: Callable[[], str] = lambda: ""


_SENSOR_TIMEOUT = 0.01


@contextmanager
def closing_on_error(lock: DeviceLock) -> Iterator[list[Callable[[], None]]]:
    """A list of what to close; all of it is closed when the block raises. The lock is given back after all else."""
    closers: list[Callable[[], None]] = []
    try:
        yield closers
    except BaseException:
        for close in reversed(closers):
            close()
        lock.close()
        raise
    closers.append(lock.close)


def lock_car(ports: CarPorts, can: CanSettings | None = None) -> DeviceLock:
    """The locks of every device of a car for a drive. Raises `HardwareError` as `lock_devices` does."""
    adapter = [] if can is None else [can_address(can)]
    return lock_devices([*adapter, *ports.serial_paths.values()], "a drive")


def open_common(
    ports: CarPorts,
    motors: tuple[MotorSettings, ...],
    safety: DriveSafety,
    closers: list[Callable[[], None]],
    motor_port: Callable[[TeensyLink], FramePort],
) -> Devices:
    """Teensy, IMU, GPS and radio, and what `motor_port` makes of the Teensy's link.

    Raises:
        HardwareError: names the device that cannot be opened.
    """
    serial = _open("teensy", ports.teensy, closers)
    teensy = TeensyLink(serial, ports.motor_ids, ports.profile)
    group = MotorGroup(motors, motor_port(teensy))
    with _named("imu"):
        imu = SensorThread("IMU", lambda: open_serial(ports.imu, _SENSOR_TIMEOUT), Bno055Session(), safety.imu_silence)
    closers.append(imu.close)
    gps = None
    if (device := ports.gps) is not None:
        with _named("gps"):
            gps = SensorThread("GPS", lambda: open_serial(device, _SENSOR_TIMEOUT), GpsSession(), safety.gps_silence)
        closers.append(gps.close)
    radio = None
    if ports.radio is not None:
        link = _open("radio", ports.radio, closers)
        radio = RadioLink(link, safety.operator_silence, ports.radio.operator, ports.radio.escaped)
    return Devices(group, teensy, imu, gps, radio, None, closers)


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
