"""The watchdog test: the motors hold, the link is cut, and somebody sees that they are off.

`watched_can`: a process that holds the motors is killed (SIGKILL); the Teensy reports that the heartbeat on the bus has
stopped. `teensy_bridge`: the strings stop; the Teensy reports that its watchdog has acted. No report shows what the
motors do: `confirm` asks the operator to move the tail by hand.

The process to kill is this module: `python -m aerodima.hardware.drive.watchdog_test SETTINGS` enters the motors and
holds them. SETTINGS is JSON: `scenario` (resolved) and `ports`. It prints `holding` once the motors hold, with the
gains of the scenario's controller, and goes on until it is killed.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from aerodima.hardware.car.bus_watch import BusWatch
from aerodima.hardware.car.car_ports import CarPorts, ports_from_dict
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import WiringName
from aerodima.hardware.car.wirings import tail_motors
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.drive.watchdog_record import WatchdogTest, new_record, write_record
from aerodima.hardware.protocol.heartbeat import ANSWER_ID
from aerodima.hardware.protocol.teensy import StringForm, TeensyStatus
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.device_lock import can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.errors import HardwareError, UserError

QUESTION = "The link was cut. Are both motors off: does the tail move freely by hand?"
_START_TIME, _ACT_TIME = 30.0, 2.0


def run_watchdog_test(
    scenario: Scenario,
    ports: CarPorts,
    wiring: WiringName,
    confirm: Callable[[str], bool],
    seen_by: str = "operator",
    folder: Path | None = None,
) -> tuple[WatchdogTest, Path]:
    """Makes a watchdog test and records it. The motors hold where they are, with the scenario's gains, for a second.

    Args:
        confirm: puts `QUESTION` to somebody who sees the motors; True if they are off.
        seen_by: who that is.
        folder: of the record, see `record_path`.

    Raises:
        HardwareError: the motors cannot be held, the watchdog did not act in time, or the motors were not seen off. No
            record is written then.
    """
    if scenario.tail.mode == "none":
        raise HardwareError("tail.mode: none; a watchdog test needs the motors of a tail")
    time_to_exit, what = (_stop_strings if wiring == "teensy_bridge" else _kill_holder)(scenario, ports)
    if not confirm(QUESTION):
        raise HardwareError(f"watchdog test of {wiring}: the motors were not seen off; nothing is recorded")
    record = new_record(wiring, ports, what, time_to_exit, seen_by)
    return record, write_record(record, folder)


def _kill_holder(scenario: Scenario, ports: CarPorts) -> tuple[float, str]:
    """Nobody is left but the Teensy, which tells of itself over its own port."""
    with _neutral_strings(ports) as stopped:
        with _holding(scenario, ports) as holder:
            holder.kill()
            killed = time.monotonic()
            holder.wait()
        while not stopped:
            if time.monotonic() - killed > _ACT_TIME:
                raise HardwareError(f"watchdog test: the Teensy did not act within {_ACT_TIME:g} s; cut the power")
            time.sleep(0.001)
        return max(0.0, stopped[0] - killed), "drive process killed (SIGKILL)"


@contextmanager
def _teensy(ports: CarPorts) -> Iterator[TeensyLink]:
    """The Teensy behind its own port, which nobody else uses meanwhile."""
    with (
        closing(lock_devices([ports.teensy.path], "a watchdog test")),
        closing(SerialLink.open(ports.teensy)) as serial,
    ):
        yield TeensyLink(serial, ports.motor_ids, ports.profile, ports.string_form)


@contextmanager
def _neutral_strings(ports: CarPorts) -> Iterator[list[float]]:
    """Strings to the Teensy; the list gets the time (s) at which it first said that the heartbeat has stopped."""
    stopped: list[float] = []
    end = threading.Event()

    def turn() -> None:
        while not end.wait(PERIOD / 4):
            teensy.poll()
            if teensy.status is TeensyStatus.BEATS_STOPPED and not stopped:
                stopped.append(time.monotonic())
            teensy.commit()

    with _teensy(ports) as teensy:
        thread = threading.Thread(target=turn, name="neutral-strings", daemon=True)
        thread.start()
        try:
            yield stopped
        finally:
            end.set()
            thread.join()


@contextmanager
def _holding(scenario: Scenario, ports: CarPorts) -> Iterator[subprocess.Popen[str]]:
    """A process that holds the motors; it is dead at the end of the block."""
    content = {"scenario": scenario.resolved(), "ports": ports.model_dump(mode="json", by_alias=True)}
    holder = subprocess.Popen(
        [sys.executable, "-P", "-m", "aerodima.hardware.drive.watchdog_test", json.dumps(content)],
        stdout=subprocess.PIPE,
        text=True,
    )
    give_up = threading.Timer(_START_TIME, holder.kill)
    give_up.start()
    try:
        word, _, rest = (holder.stdout.readline().strip() if holder.stdout else "").partition(" ")
        give_up.cancel()
        if word != "holding":
            raise HardwareError(rest if word == "error:" else "watchdog test: the motors could not be held")
        yield holder
    finally:
        give_up.cancel()
        holder.kill()
        holder.wait()


def _stop_strings(scenario: Scenario, ports: CarPorts) -> tuple[float, str]:
    if ports.string_form is not StringForm.CHECKED:
        raise HardwareError("string_form: published; the Teensy reports its watchdog in the checked form only")
    with _teensy(ports) as teensy:
        group = MotorGroup(tail_motors(scenario, ports, load_mounting()), teensy)
        last = _hold_over_strings(group, teensy)
        while teensy.fault is not SourceFault.REPORTED:
            if time.monotonic() - last > _ACT_TIME:
                raise HardwareError(f"watchdog test: the Teensy did not act within {_ACT_TIME:g} s; cut the power")
            teensy.poll()
            time.sleep(0.001)
        return time.monotonic() - last, "strings stopped"


def _hold_over_strings(group: MotorGroup, teensy: TeensyLink) -> float:
    """Enters the motors and holds them for a while; when the last string left, s."""
    begin = due = time.monotonic()
    holding = 0
    while holding < SETTLING:
        now = time.monotonic()
        group.step(now)
        if not teensy.fault and not holding and all(motor.state.name == "OFF" for motor in group.motors):
            group.set_enter(now)
        teensy.commit()
        holding = holding + 1 if group.ready else 0
        if group.fault_text or now - begin > _START_TIME:
            reason = group.fault_text or teensy.fault_text or "the motors do not answer"
            group.exit_now(now)
            raise HardwareError(f"watchdog test: {reason}")
        due = max(due + PERIOD, now)
        time.sleep(due - now)
    teensy.flush()
    return time.monotonic()


PERIOD = 0.01
SETTLING = 50
"""Cycles of holding before the cut: the gains have come on."""


def hold(scenario: Scenario, ports: CarPorts) -> None:
    """Enters and holds until something fails; raises `HardwareError` then."""
    settings = ports.adapter("watched_can")
    _lock = lock_devices([can_address(settings)], "a watchdog test")
    bus = CanBus.open(settings, listen={0, ANSWER_ID, *ports.motor_ids})
    watchdog = BusWatch(bus, load_drive_safety().heartbeat_answer)
    with MotorGroup(tail_motors(scenario, ports, load_mounting()), watchdog) as group:
        _await_the_teensy(group, watchdog)
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
                print("holding", flush=True)
            due = max(due + PERIOD, now)
            time.sleep(due - now)
        raise HardwareError(group.fault_text)


def _await_the_teensy(group: MotorGroup, watchdog: BusWatch) -> None:
    """Sends heartbeats until the Teensy has answered for ten cycles, for a second at most."""
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
        hold(scenario_from_dict(settings["scenario"]), ports_from_dict(settings["ports"]))
    except UserError as error:
        print(f"error: {error}", flush=True)
    return 2


if __name__ == "__main__":
    sys.exit(main())
