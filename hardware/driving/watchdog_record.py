"""The record of a watchdog test, which allows the motors of a wiring to be armed.

`aerodima.hardware.driving.watchdog_test.run_watchdog_test` makes one.
"""

import hashlib
import json
import os
import shlex
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from pydantic import Field

from aerodima.hardware.car.car_ports import JOINTS, CarPorts, is_emulated_port
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import WiringName
from aerodima.hardware.firmware.teensy_firmware import firmware_hash
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.file_reading import Json, read_json
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import StrictModel, checked
from aerodima.workbench.logs.schema import software_versions

SCHEMA = "aerodima/watchdog_test/2"


class WatchdogRecord(StrictModel):
    """Result of a watchdog test.

    Attributes:
        wiring: wiring that was tested.
        cut: way in which the link was cut, in words.
        time_to_exit: time from the cut to the Teensy's report that it has switched the motors off,
            s.
        seen_off_by: who saw that the motors were off.
        emulated: whether the test was made on an emulator; it is then void for real motors.
        firmware: hash of the Teensy's firmware and timing, by `teensy_hash`.
        ports: ports of the car as plain data, in the form of `CarPorts`.
    """

    schema_: Literal["aerodima/watchdog_test/2"] = Field(
        default="aerodima/watchdog_test/2", alias="schema"
    )
    wiring: WiringName
    cut: str
    time_to_exit: float = Field(ge=0.0)
    seen_off_by: str = Field(min_length=1)
    emulated: bool
    firmware: str
    created: str
    versions: dict[str, str]
    ports: Json


def new_record(
    wiring: WiringName, ports: CarPorts, cut: str, time_to_exit: float, seen_off_by: str
) -> WatchdogRecord:
    """Makes the record of a test that was made just now; `WatchdogRecord` explains the arguments.

    Raises:
        HardwareError: the exit frames came later than `longest_watchdog_test` of the drive's
            limits.
    """
    longest = load_drive_safety().longest_watchdog_test
    if time_to_exit > longest:
        raise HardwareError(
            f"watchdog test of {wiring}: exit frames {time_to_exit:.3f} s after the cut; allowed "
            f"is {longest:g} s"
        )
    return WatchdogRecord.model_validate(
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


def record_path(wiring: WiringName, ports: CarPorts) -> Path:
    """Returns the path of the record of a wiring, in the user's state folder (`XDG_STATE_HOME`).

    The record of an emulated car is beside its ports, so that the record of the real car is kept.
    """
    if is_emulated_port(ports.teensy.path):
        folder = Path(ports.teensy.path).parent.parent
    else:
        state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
        folder = state / "aerodima" / "watchdog_tests"
    return folder / f"{wiring}.json"


def write_record(record: WatchdogRecord, ports: CarPorts) -> Path:
    """Writes a record over an older one; raises `HardwareError` if it cannot be written."""
    text = json.dumps(record.model_dump(mode="json", by_alias=True), indent=1) + "\n"
    return write_atomically(record_path(record.wiring, ports), text, True, HardwareError)


def read_record(path: Path) -> WatchdogRecord:
    """Reads a record. Raises a `HardwareError` that names the file and what is wrong."""
    data = read_json(path, HardwareError)
    return checked(WatchdogRecord, data, str(path), HardwareError, schema=SCHEMA)


def require_watchdog_test(
    wiring: WiringName, ports: CarPorts, scenario: str = "YOUR_SCENARIO"
) -> WatchdogRecord:
    """Returns the record that allows the motors of these ports to be armed; an error message
    proposes the test, with the scenario's name or file.

    Raises:
        HardwareError: there is no record for the wiring, it was made on the emulator and the motors
            are real, its exit frames came too late, or what it has shown has changed since: adapter
            or Teensy, motor ids, firmware profile, firmware, timing.
    """
    path = record_path(wiring, ports)
    words = [scenario, "--ports", ports.file or "YOUR_PORTS_FILE", "--wiring", wiring]
    again = f"make one with `aerodima drive watchdog-test {shlex.join(words)}`"
    if not path.exists():
        raise HardwareError(f"no watchdog test of {wiring} is recorded ({path}); {again}")
    record = read_record(path)
    emulated = is_emulated(wiring, ports)
    changed = [] if emulated else _changed_ports(wiring, record, ports)
    reason = ""
    if record.wiring != wiring:
        reason = f"is of the wiring {record.wiring}; allowed: {wiring}"
    elif record.emulated and not emulated:
        reason = "was made on the emulator; the motors are real"
    elif record.firmware != teensy_hash():
        reason = "was made with another firmware of the Teensy, or other timing"
    elif changed:
        reason = f"was made with other ports: {', '.join(changed)}"
    elif record.time_to_exit > load_drive_safety().longest_watchdog_test:
        reason = f"took {record.time_to_exit:g} s: too long"
    if reason:
        raise HardwareError(f"{path}: the watchdog test {reason}; {again}")
    return record


def is_emulated(wiring: WiringName, ports: CarPorts) -> bool:
    """Returns whether the motors are on a port of an emulator or on a bus within this process,
    where no real motor can be.

    A socketcand of this computer counts as real: a real adapter may be behind it.
    """
    if wiring == "teensy_bridge":
        return is_emulated_port(ports.teensy.path)
    can = ports.adapter(wiring)
    return can.interface == "virtual" or (
        can.interface == "slcan" and is_emulated_port(can.channel)
    )


def teensy_hash() -> str:
    """Returns the SHA-256 over `firmware_hash` and the timing that is exported with the firmware,
    as 64 hexadecimal digits.
    """
    timing = model_path("parameters/hardware/teensy_firmware.yaml")
    return hashlib.sha256(firmware_hash().encode() + b"\0" + timing.read_bytes()).hexdigest()


def _changed_ports(wiring: WiringName, record: WatchdogRecord, ports: CarPorts) -> list[str]:
    """Returns the keys of the ports file that have changed since the test: those of the path to the
    motors, of the firmware profile and of the motor ids.
    """
    before = record.ports
    now = ports.model_dump(mode="json", by_alias=True)
    ways = {"teensy_bridge": ["teensy"], "watched_can": ["can", "teensy"]}[wiring]
    changed = [key for key in (*ways, "firmware_profile") if before.get(key) != now[key]]
    others = [j for j in JOINTS if (before.get(j) or {}).get("motor_id") != now[j]["motor_id"]]
    return [*changed, *(f"{joint}.motor_id" for joint in others)]
