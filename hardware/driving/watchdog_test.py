"""Watchdog test: the motors hold, the link is cut, and somebody sees that the motors are off."""

import time
from collections.abc import Callable
from pathlib import Path

from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import CarCommand, WiringName
from aerodima.hardware.car.wirings import wire_car
from aerodima.hardware.driving.held_car import holding, run_cycles
from aerodima.hardware.driving.watchdog_record import (
    WatchdogRecord,
    new_record,
    write_record,
)
from aerodima.hardware.protocol.teensy import TeensyStatus
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import Scenario

QUESTION = "The link was cut. Are both motors off: does the tail move freely by hand?"
_HOLD_TIME = 0.5
"""Time for which the motors hold before the cut, s."""
_ACT_TIME = 2.0
"""Time in which the Teensy must act after the cut, s."""
_POLL_PERIOD = 0.002
"""Period of the polls of the Teensy, s."""
_CUTS = {
    "teensy_bridge": ("strings stopped", TeensyStatus.WATCHDOG_ACTED),
    "watched_can": ("heartbeat stopped", TeensyStatus.HEARTBEAT_STOPPED),
}
"""Cut of each wiring, and the status that the Teensy reports then."""


def run_watchdog_test(
    scenario: Scenario,
    ports: CarPorts,
    wiring: WiringName,
    confirm: Callable[[str], bool],
    seen_by: str = "operator",
) -> tuple[WatchdogRecord, Path]:
    """Makes a watchdog test and records it: the motors hold, the link is cut, and somebody sees
    that they are off.

    In the bridge all text frames stop; in `watched_can` the text frames continue and the heartbeat
    stops. The Teensy reports that it has acted. No report shows what the motors do, so nothing is
    sent before `confirm` has answered.

    Args:
        confirm: function that puts `QUESTION` to somebody who sees the motors; returns True if they
            are off.
        seen_by: who confirms it, for the record.

    Raises:
        HardwareError: the motors cannot be held, the watchdog did not act in time, or the motors
            were not seen off. No record is written then.
    """
    if not scenario.has_tail:
        raise HardwareError("tail.mode: none; a watchdog test needs the motors of a tail")
    cut, answer = _CUTS[wiring]
    # The page that is the radio of an emulated car is not there yet.
    without_radio = ports.model_copy(update={"radio": None})
    with holding(wire_car(scenario, without_radio, wiring, lambda: None)) as car:
        run_cycles(car, CarCommand(), _HOLD_TIME)
        last = time.monotonic()
        car.read(last)
        car.write(CarCommand(), last)
        if car.reading.fault_text:
            raise HardwareError(f"watchdog test: {car.reading.fault_text}")
        time_to_exit = _await_status(car, answer) - last
        if not confirm(QUESTION):
            raise HardwareError(
                f"watchdog test of {wiring}: the motors were not seen off; nothing is recorded"
            )
    record = new_record(wiring, ports, cut, time_to_exit, seen_by)
    return record, write_record(record, ports)


def _await_status(car: WiredCar, expected: TeensyStatus) -> float:
    """Waits until the Teensy reports that it has acted; returns that time, s (monotonic)."""
    assert car.devices is not None
    teensy = car.devices.teensy
    end = time.monotonic() + _ACT_TIME
    while teensy.status is not expected:
        if time.monotonic() > end:
            raise HardwareError(
                f"watchdog test: the Teensy did not act within {_ACT_TIME:g} s; cut the power"
            )
        if car.name == "watched_can":
            teensy.commit()
        time.sleep(_POLL_PERIOD)
        teensy.poll()
    return time.monotonic()
