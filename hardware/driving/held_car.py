"""A car whose tail is held by its motors, for first tests: it is armed without a guard, and its
motors are switched off on every exit, also on that by a signal.
"""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from aerodima.hardware.car.car_ports import CarPorts, read_ports
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import PERIOD, CarCommand, wiring_name
from aerodima.hardware.car.wirings import wire_car
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.hardware.driving.interrupts import handling_an_end
from aerodima.hardware.driving.plain_loop import wait_until
from aerodima.hardware.driving.watchdog_record import require_watchdog_test
from aerodima.workbench.core.deprecation import renamed
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.realtime import DRIVE_PRIORITY, prefer_realtime, restore_ordinary
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

_ANSWER_TIME = 0.5
"""Time in which Teensy and watchdog must answer, s."""


def connect(
    ports: str | Path | CarPorts,
    scenario: str | Path | Scenario,
    wiring: str = "teensy_bridge",
    traffic: str | Path | None = None,
    scenario_name: str = "YOUR_SCENARIO",
) -> WiredCar:
    """Makes the car of a scenario with its watchdog; opens nothing yet.

    It can be armed only after a recorded watchdog test of its wiring.

    Args:
        ports: path of the ports file, or the ports that were read from it.
        scenario: scenario itself, its name or its file; gives the tail and its controller's gains.
        wiring: name of the wiring, one of `aerodima.hardware.car.wiring.WIRINGS`.
        traffic: path of a new `.blf` file that records every frame on the adapter; not with
            `teensy_bridge`.
        scenario_name: name or file of a scenario that is already loaded, for messages.

    Raises:
        HardwareError: unknown wiring, a ports file that cannot be read, or an error of `wire_car`.
    """
    name = wiring_name(wiring)
    car_ports = read_ports(ports)
    if isinstance(scenario, Scenario):
        loaded = scenario
    else:
        loaded = load_scenario(scenario)
        scenario_name = str(scenario)

    def authorise() -> None:
        require_watchdog_test(name, car_ports, scenario_name)

    return wire_car(loaded, car_ports, name, authorise, None if traffic is None else Path(traffic))


@contextmanager
def holding(car: WiredCar) -> Iterator[WiredCar]:
    """Starts and arms a car; the block begins when its motors hold the tail where it is, and ends
    with the motors disabled.

    Args:
        car: car made by `connect`, not started yet.

    Raises:
        HardwareError: no watchdog test of its wiring, a port that cannot be opened, motors that do
            not answer.
        KeyboardInterrupt: SIGINT, SIGTERM or SIGHUP within the block, on the main thread.
    """
    car.authorise()
    with handling_an_end(signal.default_int_handler):
        prefer_realtime(DRIVE_PRIORITY)
        try:
            car.start()
            run_cycles(car, CarCommand(), _ANSWER_TIME)
            car.arm()
            _await_armed(car)
            run_cycles(car, CarCommand(), load_motor_safety().gain_ramp)
            if not car.reading.named_status.armed:
                raise HardwareError(
                    f"not armed: {car.reading.fault_text or 'the motors do not answer'}"
                )
            yield car
        finally:
            with handling_an_end(lambda *_: None):  # a second signal must not cut the stop short
                car.stop("motors disabled")
                restore_ordinary()


held = renamed("held", holding)
"""Old name of `holding`."""


def _await_armed(car: WiredCar) -> None:
    """Runs cycles until the motors take commands, have a fault, or `arm_timeout` is over."""
    end = time.monotonic() + load_drive_safety().arm_timeout
    while time.monotonic() < end:
        if car.reading.named_status.armed or any(motor.fault for motor in car.motors):
            return
        run_cycles(car, CarCommand())


def run_cycles(
    car: WiredCar, command: CarCommand | Callable[[float], CarCommand], seconds: float = PERIOD
) -> None:
    """Runs cycles of 10 ms, at least one; `car.reading` is then that of the last cycle.

    Args:
        command: command of every cycle, or a function that returns it for the time since the first
            cycle (s). All zeros hold a joint where it is.
    """
    begin = time.monotonic()
    for cycle in range(max(1, round(seconds / PERIOD))):
        now = time.monotonic()
        car.read(now)
        car.write(command if isinstance(command, CarCommand) else command(cycle * PERIOD), now)
        wait_until(begin + (cycle + 1) * PERIOD)
