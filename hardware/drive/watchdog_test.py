"""The watchdog test: the motors hold, the link is cut, and somebody sees that they are off.

`watched_can`: a process that holds the motors is killed (SIGKILL); the Teensy reports that the heartbeat on the bus has
stopped. `teensy_bridge`: the strings stop; the Teensy reports that its watchdog has acted. No report shows what the
motors do: `confirm` asks the operator to move the tail by hand.

The process to kill is this module: `python -m aerodima.hardware.drive.watchdog_test SETTINGS` enters the motors and
holds them. SETTINGS is JSON: `scenario` (resolved) and `ports`. It prints `holding` once the motors hold, with the
gains of the scenario's controller, and goes on until it is killed.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from aerodima.hardware.car.bus_watch import ANSWER_ID, BusWatch
from aerodima.hardware.car.car_ports import CarPorts, is_emulated_port, ports_from_dict
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import WiringName, wiring_name
from aerodima.hardware.car.wirings import tail_motors
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.firmware.firmware_settings import firmware_hash
from aerodima.hardware.protocol.teensy import TeensyStatus
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.device_lock import can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink
from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.checked_files import StrictModel, checked
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.errors import HardwareError, UserError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.resources import model_path

SCHEMA = "aerodima/watchdog_test/2"


class WatchdogTest(StrictModel):
    """What a watchdog test has shown.

    Attributes:
        time_to_exit: s from the cut to the Teensy's report that it has switched the motors off.
        cut: what was cut. seen_off_by: who saw that the motors were off.
        emulated: made on an emulator; worth nothing for real motors.
        firmware: `teensy_hash`.
        ports: as `CarPorts`.
    """

    schema_: Literal["aerodima/watchdog_test/2"] = Field(default="aerodima/watchdog_test/2", alias="schema")
    wiring: WiringName
    cut: str
    time_to_exit: float = Field(ge=0.0)
    seen_off_by: str = Field(min_length=1)
    emulated: bool
    firmware: str
    created: str
    versions: dict[str, str]
    ports: dict[str, Any]


def new_record(wiring: WiringName, ports: CarPorts, cut: str, time_to_exit: float, seen_off_by: str) -> WatchdogTest:
    """The record of a test made now.

    Raises:
        HardwareError: the exit frames came later than `longest_watchdog_test` of the drive's limits.
    """
    longest = load_drive_safety().longest_watchdog_test
    if time_to_exit > longest:
        raise HardwareError(
            f"watchdog test of {wiring}: exit frames {time_to_exit:.3f} s after the cut; allowed is {longest:g} s"
        )
    return WatchdogTest.model_validate(
        {
            "wiring": wiring,
            "cut": cut,
            "time_to_exit": time_to_exit,
            "seen_off_by": seen_off_by,
            "emulated": is_emulated(wiring, ports),
            "firmware": teensy_hash(),
            "created": datetime.now(UTC).isoformat(),
            "versions": software_versions(),
            "ports": ports.model_dump(mode="json", by_alias=True),
        }
    )


def record_path(wiring: WiringName, folder: Path | None = None) -> Path:
    """Where the record of a wiring is; `folder` None: in the user's state folder (`XDG_STATE_HOME`)."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return (folder or state / "aerodima" / "watchdog_tests") / f"{wiring}.json"


def write_record(record: WatchdogTest, folder: Path | None = None) -> Path:
    """Writes a record in the place of an older one; `HardwareError` if it cannot be written."""
    text = json.dumps(record.model_dump(mode="json", by_alias=True), indent=1) + "\n"
    return write_atomically(record_path(record.wiring, folder), text, True, HardwareError)


def read_record(path: Path) -> WatchdogTest:
    """Reads a record. Raises `HardwareError` that names the file and what is wrong."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise HardwareError(f"{path}: cannot be read as JSON: {error}") from None
    return checked(WatchdogTest, data, str(path), HardwareError, schema=SCHEMA)


def require_watchdog_test(wiring: WiringName, ports: CarPorts, folder: Path | None = None) -> WatchdogTest:
    """The record that allows arming the motors of these ports.

    Raises:
        HardwareError: there is none for the wiring, it was made on the emulator and the motors are real, or what it
            has shown has changed since: adapter or Teensy, motor ids, firmware profile, firmware, timing.
    """
    path = record_path(wiring, folder)
    again = f"make one with `aerodima drive SCENARIO --wiring {wiring} --watchdog-test`"
    if not path.exists():
        raise HardwareError(f"no watchdog test of {wiring} is recorded ({path}); {again}")
    record = read_record(path)
    emulated = is_emulated(wiring, ports)
    changed = [] if emulated else _changed_ports(wiring, record, ports)
    reasons = (
        (record.wiring != wiring, f"is of the wiring {record.wiring}; allowed: {wiring}"),
        (record.emulated and not emulated, "was made on the emulator; the motors are real"),
        (record.firmware != teensy_hash(), "was made with another firmware of the Teensy, or other timing"),
        (bool(changed), f"was made with other ports: {', '.join(changed)}"),
        (record.time_to_exit > load_drive_safety().longest_watchdog_test, f"took {record.time_to_exit:g} s: too long"),
    )
    for wrong, text in reasons:
        if wrong:
            raise HardwareError(f"{path}: the watchdog test {text}; {again}")
    return record


def is_emulated(wiring: WiringName, ports: CarPorts) -> bool:
    """Whether the motors hang on a port of an emulator or on a bus within this process, where no real motor can be.

    A socketcand of this computer counts as real: it may stand before a real adapter.
    """
    if wiring_name(wiring) == "teensy_bridge":
        return is_emulated_port(ports.teensy.path)
    can = ports.adapter(wiring)
    return can.interface == "virtual" or (can.interface == "slcan" and is_emulated_port(can.channel))


def teensy_hash() -> str:
    """SHA-256 over `firmware_hash` and the timing that is exported with the firmware; 64 hexadecimal digits."""
    timing = model_path("parameters/hardware/teensy_firmware.yaml")
    return hashlib.sha256(firmware_hash().encode() + b"\0" + timing.read_bytes()).hexdigest()


def _changed_ports(wiring: WiringName, record: WatchdogTest, ports: CarPorts) -> list[str]:
    """What the test was made with and is not so now: the way to the motors, and who they are."""
    ways = {"teensy_bridge": ["teensy"], "watched_can": ["can", "teensy"]}[wiring]
    now = ports.model_dump(mode="json", by_alias=True)

    def motor(data: dict[str, Any], joint: str) -> Any:
        return (data.get(joint) or {}).get("motor_id")

    changed = [key for key in (*ways, "firmware_profile") if record.ports.get(key) != now[key]]
    return changed + [f"{j}.motor_id" for j in ("tail_pitch", "tail_roll") if motor(record.ports, j) != motor(now, j)]


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
        yield TeensyLink(serial, ports.motor_ids, ports.profile)


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
