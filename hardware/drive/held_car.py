"""A car whose tail is held by its motors, for first contact: armed without a guard, off on every way out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from aerodima.hardware.car.car_ports import CarPorts, read_ports
from aerodima.hardware.car.direct_can import direct_can
from aerodima.hardware.car.latency import DRIVE_PRIORITY
from aerodima.hardware.car.teensy_bridge import teensy_bridge
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import CarCommand, wiring_name
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.hardware.drive.plain_loop import PERIOD, wait_until
from aerodima.hardware.transport.can_settings import CanSettings
from aerodima.hardware.transport.device_lock import DeviceLock, Say, tell_on_stderr
from aerodima.hardware.watchdog.test_record import require_watchdog_test
from aerodima.hardware.watchdog.watchdog_process import WatchdogProcess
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.signal_table import STATUS
from aerodima.workbench.errors import HardwareError
from aerodima.workbench.realtime import prefer_realtime, restore_ordinary

_HEARD = 0.5
"""s in which Teensy and watchdog are heard."""


def connect(
    ports: str | Path | CarPorts,
    scenario: str | Scenario,
    wiring: str = "teensy_bridge",
    traffic: Path | None = None,
    say: Say = tell_on_stderr,
) -> WiredCar:
    """The car of a scenario with its watchdog, to be armed after a recorded watchdog test only; opens nothing yet.

    Args:
        ports: the ports file, or what is in it.
        scenario: itself, its name or its file; for the tail and the gains of its controller.
        wiring: of `aerodima.hardware.car.wiring.WIRINGS`.
        traffic: a new `.blf` file for every frame on the adapter; not with `teensy_bridge`.
        say: is told when the watchdog of an earlier drive is waited for.

    Raises:
        HardwareError: unknown wiring, a ports file that cannot be read, and as `direct_can`.
    """
    name = wiring_name(wiring)
    there = ports if isinstance(ports, CarPorts) else read_ports(Path(ports))
    chosen = load_scenario(scenario) if isinstance(scenario, str) else scenario

    def authorise() -> None:
        require_watchdog_test(name, there)

    if name == "teensy_bridge":
        return teensy_bridge(chosen, there, authorise, say=say)

    def start_watchdog(can: CanSettings, lock: DeviceLock) -> WatchdogProcess:
        return WatchdogProcess(can, there.motor_ids, lock=lock)

    return direct_can(chosen, there, authorise, start_watchdog, traffic, say=say, name=name)


@contextmanager
def held(car: WiredCar) -> Iterator[WiredCar]:
    """Starts and arms a car; the block begins when the tail is held where it is, and ends with the motors off.

    Args:
        car: of `connect`, not started yet.

    Raises:
        HardwareError: no watchdog test of its wiring, a port that cannot be opened, motors that do not answer.
    """
    safety = load_motor_safety()
    car.authorise()
    prefer_realtime(DRIVE_PRIORITY)
    try:
        car.start()
        run_cycles(car, CarCommand(), _HEARD)
        car.arm()
        run_cycles(car, CarCommand(), safety.enter_timeout + safety.gain_ramp)
        if not car.reading.status[STATUS.index("armed")]:
            raise HardwareError(f"not armed: {car.reading.fault_text or 'the motors do not answer'}")
        yield car
    finally:
        car.stop("the tail is let go")
        restore_ordinary()


def run_cycles(car: WiredCar, command: CarCommand | Callable[[float], CarCommand], seconds: float = PERIOD) -> None:
    """Cycles of 10 ms, one at least; `car.reading` is of the last one.

    Args:
        command: of every cycle, or as a function of the time since the first (s). All zeros hold a joint where it is.
    """
    begin = time.monotonic()
    for cycle in range(max(1, round(seconds / PERIOD))):
        now = time.monotonic()
        car.read(now)
        car.write(command if isinstance(command, CarCommand) else command(cycle * PERIOD), now)
        wait_until(begin + (cycle + 1) * PERIOD)
