"""Opens the devices that both wirings have; what was opened is closed again when a later one fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from aerodima.hardware.car.car_devices import Devices
from aerodima.hardware.car.car_ports import CarPorts, MountedMotor
from aerodima.hardware.car.drive_safety import DriveSafety
from aerodima.hardware.car.firmware_settings import MotorLimits, motor_limits
from aerodima.hardware.car.mounting import Mounting, load_mounting
from aerodima.hardware.devices.motor_group import FramePort, check_distinct_ids
from aerodima.hardware.devices.motor_settings import MotorSettings, load_motor_safety, motor_settings
from aerodima.hardware.devices.radio_link import RadioLink
from aerodima.hardware.devices.sensor_readers import gps_thread, imu_thread
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.transport.can_settings import CanSettings
from aerodima.hardware.transport.device_lock import DeviceLock, Say, can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink, SerialSettings, open_serial
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.errors import HardwareError

_SENSOR_TIMEOUT = 0.01


def tail_motors(scenario: Scenario, ports: CarPorts, mounting: Mounting) -> tuple[MotorSettings, ...]:
    """Settings of the pitch and the roll motor; none for a scenario without a tail.

    Raises:
        HardwareError: two motors with one id, or a zero at which a joint's range does not fit the firmware profile.
    """
    if scenario.tail.mode == "none":
        return ()
    safety = load_motor_safety()
    gains = (scenario.controller.hold_kp, scenario.controller.hold_kd)

    def settings(name: str, part: MountedMotor, limit: float, direction: int) -> MotorSettings:
        return motor_settings(
            name,
            part.motor_id,
            ports.profile,
            scenario.tail_motor,
            (-limit, limit),
            gains,
            direction=part.direction or direction,
            zero=part.zero,
            safety=safety,
        )

    motors = (
        settings("tail pitch", ports.tail_pitch, scenario.tail.pitch_limit, mounting.tail_pitch_direction),
        settings("tail roll", ports.tail_roll, scenario.tail.roll_limit, mounting.tail_roll_direction),
    )
    check_distinct_ids(motors)
    return motors


def firmware_limits(scenario: Scenario, ports: CarPorts) -> tuple[MotorLimits, MotorLimits] | None:
    """What the firmware lets through to the motors of a scenario on these ports; None for a car without a tail."""
    motors = tail_motors(scenario, ports, load_mounting())
    return (motor_limits(motors[0]), motor_limits(motors[1])) if motors else None


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
