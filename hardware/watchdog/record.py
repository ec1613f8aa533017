"""The record of a watchdog test: without one for its wiring, real motors are not armed (design section 14)."""

from __future__ import annotations

import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hardware.firmware.build import firmware_hash
from hardware.watchdog.settings import load_watchdog_timing
from hardware.wiring.base import WIRINGS, WiringName
from hardware.wiring.car_ports import CarPorts
from workbench.atomic_write import write_atomically
from workbench.errors import HardwareError
from workbench.logs.schema import software_versions
from workbench.quantity import explain

SCHEMA = "aerodima/watchdog_test/1"


class WatchdogTest(BaseModel):
    """What a watchdog test has shown.

    Attributes:
        time_to_exit: s from the cut to the first exit frame handed to the bus.
        cut: what was cut. seen_off_by: who saw that the motors were off.
        emulated: made on pseudo-terminals; worth nothing for real motors.
        firmware: `firmware_hash` of the Teensy. watchdog: `watchdog_hash` of the process.
        ports: as `CarPorts`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)

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
            "firmware": firmware_hash(),
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
    path = record_path(record.wiring, folder)
    return write_atomically(path, lambda target: _write(target, text), True, HardwareError)


def read_record(path: Path) -> WatchdogTest:
    """Reads a record. Raises `HardwareError` that names the file and what is wrong."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise HardwareError(f"{path}: cannot be read as JSON: {error}") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise HardwareError(f"{path}: schema: is no watchdog test; allowed: {SCHEMA!r}")
    try:
        return WatchdogTest.model_validate(data)
    except ValidationError as error:
        raise HardwareError(str(explain(error, str(path), WatchdogTest))) from None


def require_watchdog_test(wiring: WiringName, ports: CarPorts, folder: Path | None = None) -> WatchdogTest:
    """The record that allows arming the motors of these ports.

    Raises:
        HardwareError: there is none for the wiring, it was made on the emulator and the motors are real, or firmware or
            watchdog have changed since.
    """
    path = record_path(wiring, folder)
    again = f"make one with `aerodima drive SCENARIO --wiring {wiring} --watchdog-test`"
    if not path.exists():
        raise HardwareError(f"no watchdog test of {wiring} is recorded ({path}); {again}")
    record = read_record(path)
    reasons = (
        (record.wiring != wiring, f"is of the wiring {record.wiring}; allowed: {wiring}"),
        (record.emulated and not is_emulated(wiring, ports), "was made on the emulator; the motors are real"),
        (record.firmware != firmware_hash(), "was made with another firmware of the Teensy"),
        (record.watchdog != watchdog_hash(), "was made with another watchdog process"),
        (record.time_to_exit > load_watchdog_timing().longest_test, f"took {record.time_to_exit:g} s: too long"),
    )
    for wrong, text in reasons:
        if wrong:
            raise HardwareError(f"{path}: the watchdog test {text}; {again}")
    return record


def is_emulated(wiring: WiringName, ports: CarPorts) -> bool:
    """Whether the motors hang on a pseudo-terminal or on this computer's own socket, where no real motor can be."""
    if wiring not in WIRINGS:
        raise HardwareError(f"wiring {wiring!r} is unknown; allowed: {', '.join(WIRINGS)}")
    if wiring == "teensy_bridge":
        return _is_pseudo_terminal(ports.teensy.path)
    can = ports.can
    if can is None:
        raise HardwareError("ports: can: missing; wiring direct_can needs a CAN adapter")
    local = can.interface == "socketcand" and can.options.get("host") in ("127.0.0.1", "localhost")
    return local or can.interface == "virtual" or (can.interface == "slcan" and _is_pseudo_terminal(can.channel))


def watchdog_hash() -> str:
    """SHA-256 over the sources of the watchdog process, 64 hexadecimal digits."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _is_pseudo_terminal(path: str) -> bool:
    return os.path.realpath(path).startswith("/dev/pts/")


def _write(target: Path, text: str) -> None:
    target.write_text(text, encoding="utf-8")
