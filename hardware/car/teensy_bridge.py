"""Wiring `teensy_bridge`, that of the thesis: the Teensy owns the CAN bus, the computer sends it strings.

The watchdog is the firmware of the Teensy: it switches the motors off when the strings stop.
"""

from __future__ import annotations

from collections.abc import Callable

from aerodima.hardware.car.car_devices import Devices
from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.drive_safety import DriveSafety, load_drive_safety
from aerodima.hardware.car.mounting import Mounting, load_mounting
from aerodima.hardware.car.open_ports import closing_on_error, lock_car, open_common, tail_motors
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.transport.device_lock import Say, tell_on_stderr
from aerodima.workbench.config.scenario import Scenario


def teensy_bridge(
    scenario: Scenario,
    ports: CarPorts,
    authorise: Callable[[], None],
    mounting: Mounting | None = None,
    safety: DriveSafety | None = None,
    say: Say = tell_on_stderr,
) -> WiredCar:
    """The car of a scenario on this wiring; opens nothing yet. Arguments and errors as for `direct_can`."""
    limits = safety or load_drive_safety()

    def open_devices() -> Devices:
        with closing_on_error(*lock_car(ports, say)) as closers:
            return open_common(ports, limits, closers, lambda teensy: teensy)

    table = mounting or load_mounting()
    motors = tail_motors(scenario, ports, table)
    return WiredCar("teensy_bridge", motors, table, limits, open_devices, authorise, ports.car)
