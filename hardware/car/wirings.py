"""The two ways in which a car is wired, each as a `WiredCar` that is not opened yet. In both the Teensy watches.

`teensy_bridge`, that of the thesis: the Teensy owns the CAN bus and the computer sends it strings. Its firmware
switches the motors off when the strings stop. `watched_can`: the motors are on a CAN adapter of the computer, and the
Teensy drives servo, throttle and sail. It is on the same bus and switches the motors off when the heartbeat stops.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from aerodima.hardware.car.bus_watch import ANSWER_ID, BusWatch
from aerodima.hardware.car.car_devices import Devices, closing_on_error, lock_car, open_common
from aerodima.hardware.car.car_ports import CarPorts, MountedMotor
from aerodima.hardware.car.mounting import Mounting, load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.devices.motor_settings import MotorSettings, load_motor_safety, motor_settings
from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.workbench.config.scenario import Scenario


def tail_motors(scenario: Scenario, ports: CarPorts, mounting: Mounting) -> tuple[MotorSettings, ...]:
    """Settings of the pitch and the roll motor; none for a scenario without a tail.

    Raises:
        HardwareError: a zero at which a joint's range does not fit the firmware profile.
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

    return (
        settings("tail pitch", ports.tail_pitch, scenario.tail.pitch_limit, mounting.tail_pitch_direction),
        settings("tail roll", ports.tail_roll, scenario.tail.roll_limit, mounting.tail_roll_direction),
    )


def watched_can(
    scenario: Scenario, ports: CarPorts, authorise: Callable[[], None], traffic_log: Path | None = None
) -> WiredCar:
    """The car of a scenario on this wiring; opens nothing yet.

    Args:
        authorise: raises `HardwareError` while no watchdog test of this wiring is recorded.
        traffic_log: a new `.blf` file for every frame on the bus.

    Raises:
        HardwareError: the ports name no CAN adapter, or the motors' settings do not fit.
    """
    can, limits, mounting = ports.adapter("watched_can"), load_drive_safety(), load_mounting()
    motors = tail_motors(scenario, ports, mounting)

    def open_devices() -> Devices:
        with closing_on_error(lock_car(ports, can)) as closers:
            bus = CanBus.open(can, traffic_log, listen={0, ANSWER_ID, *ports.motor_ids})
            closers += [bus.close, lambda: _switch_off(bus, ports)]  # the other way round after a failed start
            watchdog = BusWatch(bus, limits.heartbeat_answer)
            devices = open_common(ports, motors, limits, closers, lambda _: watchdog)
            devices.traffic_error = lambda: bus.log_error
            devices.watchdog = watchdog
            return devices

    return WiredCar("watched_can", bool(motors), mounting, open_devices, authorise, ports.car)


def _switch_off(bus: CanBus, ports: CarPorts) -> None:
    """Exit frames to motors that an earlier program may have left on."""
    for motor_id in ports.motor_ids:
        for _ in range(load_motor_safety().exit_burst):
            bus.send(make_exit(motor_id), urgent=True)


def teensy_bridge(scenario: Scenario, ports: CarPorts, authorise: Callable[[], None]) -> WiredCar:
    """The car of a scenario on this wiring; opens nothing yet. Arguments and errors as for `watched_can`."""
    limits, mounting = load_drive_safety(), load_mounting()
    motors = tail_motors(scenario, ports, mounting)

    def open_devices() -> Devices:
        with closing_on_error(lock_car(ports)) as closers:
            return open_common(ports, motors, limits, closers, lambda teensy: teensy)

    return WiredCar("teensy_bridge", bool(motors), mounting, open_devices, authorise, ports.car)
