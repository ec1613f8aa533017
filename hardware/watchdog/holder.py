"""Drive process to kill: `python -m aerodima.hardware.watchdog.holder SETTINGS` enters the motors and holds them.

SETTINGS is JSON: `scenario` (resolved), `ports`, `report`, `wiring`. It prints `holding` and the id of its watchdog
once the motors hold, with
the gains of the scenario's controller, and goes on until it is killed. Only a watchdog test starts it.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from aerodima.hardware.car.bus_watch import BusWatch, Watchdogs
from aerodima.hardware.car.car_devices import Watchdog
from aerodima.hardware.car.car_ports import ports_from_dict
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.open_ports import tail_motors
from aerodima.hardware.car.watchdog_settings import load_watchdog_timing
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.protocol.heartbeat import ANSWER_ID
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.device_lock import can_address, lock_devices
from aerodima.hardware.watchdog.watchdog_process import WatchdogProcess
from aerodima.workbench.config.scenario import scenario_from_dict
from aerodima.workbench.errors import HardwareError, UserError

PERIOD = 0.01
SETTLING = 50
"""Cycles of holding before the cut: the gains have come on."""


def hold(scenario: dict, ports_data: dict, report: Path, wiring: str) -> None:
    """Enters and holds until something fails; raises `HardwareError` then."""
    ports = ports_from_dict(ports_data)
    settings = ports.adapter(wiring).settings
    lock = lock_devices([can_address(settings)], "a watchdog test")
    bus = CanBus.open(settings, listen={0, ANSWER_ID, *ports.motor_ids})
    process = WatchdogProcess(settings, ports.motor_ids, report, lock)
    watch = BusWatch(bus, load_watchdog_timing())
    watched = wiring == "watched_can"
    watchdog: Watchdog = Watchdogs(process, watch) if watched else process
    motors = tail_motors(scenario_from_dict(scenario), ports, load_mounting())
    with MotorGroup(motors, watch if watched else bus) as group:
        _hear_the_teensy(group, watchdog)
        watchdog.arm()
        group.set_enter(time.monotonic())
        due, cycles = time.monotonic(), 0
        while not group.fault_text:
            now = time.monotonic()
            group.step(now)
            watchdog.beat()
            if not watchdog.healthy:
                raise HardwareError(watchdog.reason)
            cycles = cycles + 1 if group.ready else 0
            if cycles == SETTLING:
                print(f"holding {process.pid}", flush=True)
            due = max(due + PERIOD, now)
            time.sleep(due - now)
        raise HardwareError(group.fault_text)


def _hear_the_teensy(group: MotorGroup, watchdog: Watchdog) -> None:
    """Beats until every watchdog is well, for a second at most."""
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        group.step(time.monotonic())
        watchdog.beat()
        time.sleep(PERIOD)
        if watchdog.healthy and end - time.monotonic() < 1.0 - 10 * PERIOD:
            return


def main() -> int:
    """2 if the motors cannot be held; otherwise it does not return."""
    settings = json.loads(sys.argv[1])
    try:
        hold(settings["scenario"], settings["ports"], Path(settings["report"]), settings["wiring"])
    except UserError as error:
        print(f"error: {error}", flush=True)
    return 2


if __name__ == "__main__":
    sys.exit(main())
