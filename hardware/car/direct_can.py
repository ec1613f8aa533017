"""Wiring `direct_can`: the motors on a CAN adapter of the computer, the Teensy for servo, throttle and sail only.

The Teensy does not command the motors here, so a process of its own watches this one (`aerodima.hardware.watchdog`). In
`direct_can` nothing else does: when both die together the motors hold their last command. In `watched_can` the Teensy
is on the same bus and switches them off when the heartbeat on it stops.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from aerodima.hardware.car.bus_watch import BusWatch, Watchdogs
from aerodima.hardware.car.car_devices import Devices, Watchdog
from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.drive_safety import DriveSafety, load_drive_safety
from aerodima.hardware.car.mounting import Mounting, load_mounting
from aerodima.hardware.car.open_ports import closing_on_error, lock_car, open_common, tail_motors
from aerodima.hardware.car.watchdog_settings import load_watchdog_timing
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.devices.motor_group import FramePort, exit_frames
from aerodima.hardware.protocol.heartbeat import ANSWER_ID
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.can_settings import CanSettings
from aerodima.hardware.transport.device_lock import DeviceLock, Say, tell_on_stderr
from aerodima.workbench.config.scenario import Scenario

StartWatchdog = Callable[[CanSettings, DeviceLock], Watchdog]


def direct_can(
    scenario: Scenario,
    ports: CarPorts,
    authorise: Callable[[], None],
    start_watchdog: StartWatchdog,
    traffic_log: Path | None = None,
    mounting: Mounting | None = None,
    safety: DriveSafety | None = None,
    say: Say = tell_on_stderr,
    name: Literal["direct_can", "watched_can"] = "direct_can",
) -> WiredCar:
    """The car of a scenario on this wiring; opens nothing yet.

    Args:
        authorise: raises `HardwareError` while no watchdog test of this wiring is recorded.
        start_watchdog: called once the adapter is open, with its lock for the watchdog to inherit.
        traffic_log: a new `.blf` file for every frame on the bus.
        say: is told when the watchdog of an earlier drive is waited for.
        name: `watched_can` with the Teensy as a second watchdog.

    Raises:
        HardwareError: the ports name no CAN adapter, or the motors' settings do not fit.
    """
    can, limits = ports.adapter(name).settings, safety or load_drive_safety()

    def open_devices() -> Devices:
        locks = lock_car(ports, say, can)
        with closing_on_error(*locks) as closers:
            bus = CanBus.open(can, traffic_log, listen={0, ANSWER_ID, *ports.motor_ids})
            closers += [bus.close, lambda: _switch_off(bus, ports)]  # the other way round after a failed start
            watch = BusWatch(bus, load_watchdog_timing())
            port: FramePort = watch if name == "watched_can" else bus
            devices = open_common(ports, limits, closers, lambda _: port)
            devices.traffic_error = lambda: bus.log_error
            process = start_watchdog(can, locks[0])
            devices.watchdog = Watchdogs(process, watch) if name == "watched_can" else process
            closers.append(devices.watchdog.close)
            return devices

    table = mounting or load_mounting()
    return WiredCar(name, tail_motors(scenario, ports, table), table, limits, open_devices, authorise, ports.car)


def _switch_off(bus: CanBus, ports: CarPorts) -> None:
    """Exit frames to motors that an earlier program may have left on."""
    for frame in exit_frames(ports.motor_ids):
        bus.send(frame, urgent=True)
