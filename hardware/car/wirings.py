"""The two ways in which a car is wired, as a `WiredCar` that is not opened yet.

In both the Teensy is the watchdog.

`teensy_bridge`, the wiring of the thesis: the Teensy owns the CAN bus and the computer sends it
text frames. Its firmware switches the motors off when the text frames stop. `watched_can`: the
motors are on a CAN adapter of the computer, and the Teensy drives servo, throttle and sail. It is
on the same bus and switches the motors off when the heartbeat stops.
"""

from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import TypeVar

from aerodima.hardware.car.bus_watch import ANSWER_ID, BusWatch
from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.mounting import Mounting, load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import Devices, WiringName
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.motor_settings import (
    MotorSettings,
    load_motor_safety,
    motor_settings,
)
from aerodima.hardware.devices.radio_link import RadioLink
from aerodima.hardware.devices.sensor_threads import (
    Bno055Session,
    GpsSession,
    SensorThread,
    Session,
)
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.device_lock import can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink, SerialSettings, open_serial
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import Scenario

_SENSOR_TIMEOUT = 0.01
"""Longest wait of a read from a sensor's port, s."""
T = TypeVar("T")


def tail_motors(
    scenario: Scenario, ports: CarPorts, mounting: Mounting
) -> tuple[MotorSettings, ...]:
    """Returns the settings of the pitch and the roll motor; none for a scenario without a tail.

    Raises:
        HardwareError: a zero at which a joint's range does not fit the firmware profile.
    """
    if not scenario.has_tail:
        return ()
    tail = scenario.tail
    joints = (
        ("tail pitch", ports.tail_pitch, tail.pitch_limit, mounting.tail_pitch_direction),
        ("tail roll", ports.tail_roll, tail.roll_limit, mounting.tail_roll_direction),
    )
    return tuple(
        motor_settings(
            name,
            part.motor_id,
            ports.profile,
            scenario.tail_motor,
            (-limit, limit),
            scenario.controller.hold_gains,
            part.direction or sign,
            part.zero,
        )
        for name, part, limit, sign in joints
    )


def wire_car(
    scenario: Scenario,
    ports: CarPorts,
    wiring: WiringName,
    authorise: Callable[[], None],
    traffic_log: Path | None = None,
) -> WiredCar:
    """Makes the car of a scenario on a wiring; opens nothing yet.

    Args:
        authorise: function that raises `HardwareError` while no watchdog test of this wiring is
            recorded.
        traffic_log: path of a new `.blf` file that records every frame on the bus of the adapter.

    Raises:
        HardwareError: the ports name no CAN adapter where one is needed, or the motors' settings do
            not fit.
    """
    can = ports.adapter(wiring) if wiring == "watched_can" else None
    mounting = load_mounting()
    motors = tail_motors(scenario, ports, mounting)

    def open_devices() -> Devices:
        with ExitStack() as closers:  # what was opened is closed again when a later one fails
            devices = list(ports.serial_paths.values())
            if can is not None:
                devices.append(can_address(can))
            closers.enter_context(lock_devices(devices, "a drive"))
            bus = None
            if can is not None:
                bus = CanBus.open(can, traffic_log, listen={0, ANSWER_ID, *ports.motor_ids})
                closers.callback(bus.close)
            opened = _open_on(bus, ports, motors, closers)
            opened.closers = closers.pop_all()
            return opened

    return WiredCar(wiring, bool(motors), mounting, open_devices, authorise, ports.car)


def _open_on(
    bus: CanBus | None, ports: CarPorts, motors: tuple[MotorSettings, ...], closers: ExitStack
) -> Devices:
    """Opens Teensy, IMU, GPS and radio; the motors are on the bus, or without one on the Teensy."""
    safety = load_drive_safety()
    watchdog = None
    if bus is not None:
        watchdog = BusWatch(bus, safety.heartbeat_answer)
        closers.push(partial(_switch_off, bus, ports))
    serial = closers.enter_context(closing(_named("teensy", lambda: SerialLink.open(ports.teensy))))
    teensy = TeensyLink(serial, ports.motor_ids, ports.profile)
    imu = _sensor("imu", ports.imu, Bno055Session(), safety.imu_silence)
    closers.callback(imu.close)
    gps = None
    radio = None
    if ports.gps is not None:
        gps = _sensor("gps", ports.gps, GpsSession(), safety.gps_silence)
        closers.callback(gps.close)
    if (module := ports.radio) is not None:
        link = closers.enter_context(closing(_named("radio", lambda: SerialLink.open(module))))
        radio = RadioLink(link, safety.operator_silence, module.operator)
    return Devices(
        MotorGroup(motors, watchdog or teensy), teensy, imu, gps, radio, closers, watchdog, bus
    )


def _sensor(
    name: str, settings: SerialSettings, session: Session[T], silence: float
) -> SensorThread[T]:
    open_port = partial(open_serial, settings, _SENSOR_TIMEOUT)
    return _named(name, lambda: SensorThread(name.upper(), open_port, session, silence))


def _named(name: str, open_device: Callable[[], T]) -> T:
    """Opens a device; adds its name to the error if it cannot be opened."""
    try:
        return open_device()
    except HardwareError as error:
        raise HardwareError(f"{name}: {error}") from None


def _switch_off(bus: CanBus, ports: CarPorts, failed: object, *_error: object) -> None:
    """Sends exit frames after a failed start: an earlier program may have left motors on."""
    if failed is None:
        return
    for motor_id in ports.motor_ids:
        for _ in range(load_motor_safety().exit_burst):
            bus.send(make_exit(motor_id), urgent=True)
