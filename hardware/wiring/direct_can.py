"""Wiring `direct_can`: the motors on a CAN adapter of the computer, the Teensy for servo, throttle and sail only.

The Teensy cannot switch the motors off here, so a process of its own watches this one (`hardware.watchdog`).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hardware.motor_group import exit_frames
from hardware.transport.can_bus import CanBus
from hardware.transport.can_settings import CanSettings
from hardware.wiring.car_ports import CarPorts
from hardware.wiring.devices import Devices, Watchdog
from hardware.wiring.drive_safety import DriveSafety, load_drive_safety
from hardware.wiring.mounting import Mounting, load_mounting
from hardware.wiring.open_ports import closing_on_error, open_common, tail_motors
from hardware.wiring.wired_car import WiredCar
from workbench.errors import HardwareError
from workbench.scenario import Scenario

StartWatchdog = Callable[[CanSettings], Watchdog]


def direct_can(
    scenario: Scenario,
    ports: CarPorts,
    authorise: Callable[[], None],
    start_watchdog: StartWatchdog,
    traffic_log: Path | None = None,
    mounting: Mounting | None = None,
    safety: DriveSafety | None = None,
) -> WiredCar:
    """The car of a scenario on this wiring; opens nothing yet.

    Args:
        authorise: raises `HardwareError` while no watchdog test of this wiring is recorded.
        start_watchdog: called once the adapter is open.
        traffic_log: a new `.blf` file for every frame on the bus.

    Raises:
        HardwareError: the ports name no CAN adapter, or the motors' settings do not fit.
    """
    if ports.can is None:
        raise HardwareError("ports: can: missing; wiring direct_can needs a CAN adapter")
    can, limits = ports.can.settings, safety or load_drive_safety()

    def open_devices() -> Devices:
        with closing_on_error() as closers:
            bus = CanBus.open(can, traffic_log, listen={0, *ports.motor_ids})
            closers += [bus.close, lambda: _switch_off(bus, ports)]  # the other way round after a failed start
            devices = open_common(ports, limits, closers, lambda _: bus)
            devices.traffic_error = lambda: bus.log_error
            devices.watchdog = start_watchdog(can)
            closers.append(devices.watchdog.close)
            return devices

    table = mounting or load_mounting()
    return WiredCar("direct_can", tail_motors(scenario, ports, table), table, limits, open_devices, authorise)


def _switch_off(bus: CanBus, ports: CarPorts) -> None:
    """Exit frames to motors that an earlier program may have left on."""
    for frame in exit_frames(ports.motor_ids):
        bus.send(frame, urgent=True)
