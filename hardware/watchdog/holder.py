"""A drive process to be killed: `python -m hardware.watchdog.holder SETTINGS` enters the motors and holds them.

SETTINGS is JSON: `scenario` (resolved), `ports`, `report`. It prints `holding` once the motors hold, with
the gains of the scenario's controller, and goes on until it is killed. Only a watchdog test starts it.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from hardware.motor_group import MotorGroup
from hardware.transport.can_bus import CanBus
from hardware.watchdog.process import WatchdogProcess
from hardware.wiring.car_ports import ports_from_dict
from hardware.wiring.mounting import load_mounting
from hardware.wiring.open_ports import tail_motors
from workbench.errors import HardwareError, UserError
from workbench.scenario import scenario_from_dict

PERIOD = 0.01
SETTLING = 50
"""Cycles of holding before the cut: the gains have come on."""


def hold(scenario: dict, ports_data: dict, report: Path) -> None:
    """Enters and holds until something fails; raises `HardwareError` then."""
    ports = ports_from_dict(ports_data)
    if ports.can is None:
        raise HardwareError("ports: can: missing; wiring direct_can needs a CAN adapter")
    settings = ports.can.settings
    bus = CanBus.open(settings, listen={0, *ports.motor_ids})
    watchdog = WatchdogProcess(settings, ports.motor_ids, report)
    motors = tail_motors(scenario_from_dict(scenario), ports, load_mounting())
    with MotorGroup(motors, bus) as group:
        watchdog.arm()
        group.set_enter(time.monotonic())
        due, cycles = time.monotonic(), 0
        while not group.fault_text:
            now = time.monotonic()
            group.step(now)
            watchdog.beat()
            cycles = cycles + 1 if group.ready else 0
            if cycles == SETTLING:
                print("holding", flush=True)
            due = max(due + PERIOD, now)
            time.sleep(due - now)
        raise HardwareError(group.fault_text)


def main() -> int:
    """2 if the motors cannot be held; otherwise it does not return."""
    settings = json.loads(sys.argv[1])
    try:
        hold(settings["scenario"], settings["ports"], Path(settings["report"]))
    except UserError as error:
        print(f"error: {error}", flush=True)
    return 2


if __name__ == "__main__":
    sys.exit(main())
