"""The record of a watchdog test: without one for its wiring, real motors are not armed (design section 14)."""

from __future__ import annotations

import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from aerodima.hardware.car.car_ports import CarPorts, is_emulated_port
from aerodima.hardware.car.safety_settings import load_watchdog_timing
from aerodima.hardware.car.wiring import WiringName, wiring_name
from aerodima.hardware.firmware.firmware_sketch import firmware_hash
from aerodima.hardware.protocol.teensy import StringForm
from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.checked_files import StrictModel, checked
from aerodima.workbench.errors import HardwareError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.resources import model_path

SCHEMA = "aerodima/watchdog_test/1"


class WatchdogTest(StrictModel):
    """What a watchdog test has shown.

    Attributes:
        time_to_exit: s from the cut to the first exit frame handed to the bus.
        cut: what was cut. seen_off_by: who saw that the motors were off.
        emulated: made on an emulator; worth nothing for real motors.
        firmware: `teensy_hash`. watchdog: `watchdog_hash` of the process.
        ports: as `CarPorts`.
    """

    schema_: Literal["aerodima/watchdog_test/1"] = Field(default="aerodima/watchdog_test/1", alias="schema")
    wiring: WiringName
    cut: str
    time_to_exit: float = Field(ge=0.0)
    seen_off_by: str = Field(min_length=1)
    emulated: bool
    firmware: str
    watchdog: str
    created: str
    versions: dict[str, str]
    ports: dict[str, Any]


def new_record(wiring: WiringName, ports: CarPorts, cut: str, time_to_exit: float, seen_off_by: str) -> WatchdogTest:
    """The record of a test made now.

    Raises:
        HardwareError: the exit frames came later than `longest_test` of the watchdog's parameters.
    """
    longest = load_watchdog_timing().longest_test
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
            "watchdog": watchdog_hash(),
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
            has shown has changed since: adapter or Teensy, motor ids, firmware profile, firmware, watchdog, timing.
    """
    path = record_path(wiring, folder)
    again = f"make one with `aerodima drive SCENARIO --wiring {wiring} --watchdog-test`"
    if not path.exists():
        raise HardwareError(f"no watchdog test of {wiring} is recorded ({path}); {again}")
    record = read_record(path)
    emulated = is_emulated(wiring, ports)
    changed = [] if emulated else _changed_ports(wiring, record, ports)
    unchecked = wiring != "direct_can" and ports.string_form is not StringForm.CHECKED
    reasons = (
        (unchecked, "cannot speak for string_form published: its replies hide a silent motor; allowed: checked"),
        (record.wiring != wiring, f"is of the wiring {record.wiring}; allowed: {wiring}"),
        (record.emulated and not emulated, "was made on the emulator; the motors are real"),
        (record.firmware != teensy_hash(), "was made with another firmware of the Teensy, or other timing"),
        (record.watchdog != watchdog_hash(), "was made with another watchdog process, or other timing"),
        (bool(changed), f"was made with other ports: {', '.join(changed)}"),
        (record.time_to_exit > load_watchdog_timing().longest_test, f"took {record.time_to_exit:g} s: too long"),
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


def watchdog_hash() -> str:
    """SHA-256 over the watchdog process, its frames, its adapter and its timing; 64 hexadecimal digits."""
    folder = Path(__file__).parent
    used = [folder.parent / "protocol" / "ak70.py", folder.parent / "transport" / "can_adapter.py"]
    return _hash_of([*sorted(folder.glob("*.py")), *used, model_path("parameters/hardware/watchdog.yaml")])


def teensy_hash() -> str:
    """SHA-256 over `firmware_hash` and the timing that is exported with the firmware; 64 hexadecimal digits."""
    return _hash_of([model_path("parameters/hardware/teensy_firmware.yaml")], firmware_hash().encode())


def _hash_of(paths: list[Path], begin: bytes = b"") -> str:
    digest = hashlib.sha256(begin)
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _changed_ports(wiring: WiringName, record: WatchdogTest, ports: CarPorts) -> list[str]:
    """What the test was made with and is not so now: the way to the motors, and who they are."""
    ways = {"direct_can": ["can"], "teensy_bridge": ["teensy"], "watched_can": ["can", "teensy"]}[wiring]
    now = ports.model_dump(mode="json", by_alias=True)

    def motor(data: dict[str, Any], joint: str) -> Any:
        return (data.get(joint) or {}).get("motor_id")

    changed = [key for key in (*ways, "firmware_profile", "string_form") if record.ports.get(key) != now[key]]
    return changed + [f"{j}.motor_id" for j in ("tail_pitch", "tail_roll") if motor(record.ports, j) != motor(now, j)]


def refuse_unwatched(wiring: WiringName, ports: CarPorts, accepted: bool) -> None:
    """Real motors on `direct_can` hold their last command when drive and watchdog die together: only by a flag.

    Raises:
        HardwareError: the motors are real and nobody has named the risk.
    """
    if wiring == "direct_can" and not accepted and not is_emulated(wiring, ports):
        raise HardwareError(
            "wiring direct_can: when this computer dies, its watchdog dies with it and the motors hold their last "
            "command for ever; use teensy_bridge or watched_can, or name the risk with --motors-may-run-on"
        )
