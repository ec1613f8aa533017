"""The ports file of a car: which device is where, and how its parts are mounted (`--ports
FILE.json`).

```json
{"schema": "aerodima/ports/1", "firmware_profile": "ak70_10_v1_0_8",
 "can": {"interface": "socketcan", "channel": "can0"}, "teensy": {"path": "/dev/ttyACM0"},
 "imu": {"path": "/dev/ttyUSB0"}, "gps": {"path": "/dev/ttyACM1"},
 "radio": {"path": "/dev/ttyUSB1"},
 "tail_pitch": {"motor_id": 1, "zero": 0.0}, "tail_roll": {"motor_id": 2, "zero": 0.0}}
```
The file of the operator's computer has `console` and, for a car with a number, `car`:
`{"schema": "aerodima/ports/1", "console": {"path": "/dev/ttyUSB0"}}`. An emulator writes a ports
file too, beside other files; `is_emulated_port` tells its ports from those of real devices.
"""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field, PrivateAttr, model_validator

from aerodima.hardware.protocol.ak70 import MAX_ID, MIN_ID, FirmwareProfile, firmware_profile
from aerodima.hardware.protocol.xbee import BROADCAST
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.serial_link import SerialSettings
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.file_reading import Json, read_json, read_text, reading
from aerodima.workbench.core.quantity import quantity
from aerodima.workbench.core.yaml_files import StrictModel, checked, require_mapping

SCHEMA = "aerodima/ports/1"
Joint = Literal["tail_pitch", "tail_roll"]
JOINTS: tuple[Joint, Joint] = ("tail_pitch", "tail_roll")
SerialDevice = Literal["teensy", "imu", "gps", "radio"]
SERIAL_DEVICES: tuple[SerialDevice, ...] = get_args(SerialDevice)
"""Fields of `CarPorts` with the serial devices on the car; the operator's `console` is not one."""
READY_FILE = "ready.json"
"""File that exists once an emulated car answers."""
PORTS_FILE = "ports.json"
"""File with the ports of an emulated car, for `connect` and `aerodima drive run --ports`."""
EVENTS_FILE = "events.jsonl"
"""File with the events of an emulated car, for `read_events`."""
TRAFFIC_FILE = "traffic.blf"
TRUTH_FILE = "truth.parquet"
PORTS_FOLDER = "ports"
READY_SCHEMA = "aerodima/emulator/1"


class GpsDevice(SerialSettings):
    """Serial port of the GPS receiver."""

    rate: int = Field(38_400, gt=0)


class RadioDevice(SerialSettings):
    """The car's XBee module; `operator` is the 64-bit serial number of the operator's module (None:
    any).
    """

    operator: int | None = Field(None, ge=0, lt=2**64)


class ConsoleDevice(SerialSettings):
    """The operator's own XBee module, where `aerodima console` runs; `receiver` is the serial
    number of the car's module.
    """

    receiver: int = Field(BROADCAST, ge=0, lt=2**64)


class MountedMotor(StrictModel):
    """One tail motor: its id on the bus, its angle at joint angle 0, and the sign of its angle
    relative to the joint's.
    """

    motor_id: int = Field(ge=MIN_ID, le=MAX_ID)
    zero: float = quantity("rad", "motor angle at joint angle 0", "[-12.5, 12.5]", default=0.0)
    direction: Literal[1, -1] | None = None
    """Sign of the motor's angle relative to the joint's; None takes that of `mounting.yaml`."""


class OperatorPorts(StrictModel):
    """Ports of the operator's computer, where `aerodima console` runs.

    `car` is the number of the car among those that share a radio channel: its reports carry it, and
    the console ignores those of other cars.
    """

    schema_: Literal["aerodima/ports/1"] = Field("aerodima/ports/1", alias="schema")
    car: int = Field(0, ge=0, le=255)
    console: ConsoleDevice | None = None


class CarPorts(OperatorPorts):
    """Ports of all devices; a device that is None is not fitted.

    `can` is needed by `watched_can` only, `console` by `aerodima console` only.
    """

    firmware_profile: str = "ak70_10_v1_0_8"
    can: CanSettings | None = None
    teensy: SerialSettings
    imu: SerialSettings
    gps: GpsDevice | None = None
    radio: RadioDevice | None = None
    tail_pitch: MountedMotor = MountedMotor(motor_id=1)
    tail_roll: MountedMotor = MountedMotor(motor_id=2)
    _file: str = PrivateAttr("")

    @model_validator(mode="after")
    def _has_two_ids(self) -> CarPorts:
        if self.tail_pitch.motor_id == self.tail_roll.motor_id:
            raise ValueError(
                f"both motors have the id {self.tail_pitch.motor_id}; each needs its own"
            )
        return self

    @property
    def file(self) -> str:
        """File from which the ports were read, for messages; empty for ports of no file."""
        return self._file

    @property
    def profile(self) -> FirmwareProfile:
        """Firmware profile of both motors; raises `HardwareError` for an unknown name."""
        return firmware_profile(self.firmware_profile)

    @property
    def serial_paths(self) -> dict[str, str]:
        """Paths of those serial devices that are fitted, by their names in `SERIAL_DEVICES`."""
        devices: dict[str, SerialSettings | None] = {
            name: getattr(self, name) for name in SERIAL_DEVICES
        }
        return {name: device.path for name, device in devices.items() if device is not None}

    def adapter(self, wiring: str) -> CanSettings:
        """Returns the CAN adapter that a wiring needs; raises `HardwareError` if there is none."""
        if self.can is None:
            raise HardwareError(f"ports: can: missing; wiring {wiring} needs a CAN adapter")
        return self.can

    @property
    def motor_ids(self) -> tuple[int, int]:
        """Ids of the pitch and the roll motor."""
        return self.tail_pitch.motor_id, self.tail_roll.motor_id


def read_ports(path: str | Path | CarPorts) -> CarPorts:
    """Reads a ports file; returns ports that were already read as they are.

    Raises:
        HardwareError: no such file, not JSON, unknown key, value not allowed, one device named
            twice; names the place.
    """
    if isinstance(path, CarPorts):
        return path
    ports = ports_from_dict(read_json(Path(path), HardwareError), str(path))
    ports._file = str(path)
    return ports


def read_operator_ports(path: Path) -> OperatorPorts:
    """Reads the ports file of the operator's computer, or that of a whole car.

    Raises:
        HardwareError: as `read_ports`.
    """
    data = read_json(path, HardwareError)
    if isinstance(data, dict) and "teensy" in data:
        return read_ports(path)
    return checked(OperatorPorts, data, str(path), HardwareError, schema=SCHEMA)


def ports_from_dict(data: Any, where: str = "ports") -> CarPorts:
    """Checks the ports in plain data; see `read_ports`."""
    ports = checked(CarPorts, data, where, HardwareError, schema=SCHEMA)
    names: dict[str, str] = {}
    paths = {f"{name}.path": path for name, path in ports.serial_paths.items()}
    if ports.console is not None:
        paths["console.path"] = ports.console.path
    if ports.can is not None and ports.can.interface == "slcan":
        paths["can.channel"] = ports.can.channel.partition("@")[0]  # of PORT@BAUD_RATE
    for key, path in paths.items():
        if path in names:
            raise HardwareError(f"{where}: {key}: {path} is that of {names[path]} too")
        names[path] = key
    ports.profile  # noqa: B018 - raises if it is unknown
    return ports


def is_emulated_port(path: str) -> bool:
    """Returns whether a device is a pseudo-terminal that an emulator made.

    A pseudo-terminal alone is no proof: other programs put real devices behind one.
    """
    place = Path(path)
    if place.parent.name != PORTS_FOLDER or not os.path.realpath(path).startswith("/dev/pts/"):
        return False
    try:
        ready = read_json(place.parent.parent / READY_FILE, HardwareError)
    except HardwareError:
        return False
    return isinstance(ready, dict) and ready.get("schema") == READY_SCHEMA


def read_events(path: str | Path) -> list[Json]:
    """Reads the events of an emulated car so far, also while it runs; leaves out an incomplete
    line.

    Raises `HardwareError` for a file that is damaged.
    """
    with reading(path, "events", HardwareError):
        lines = read_text(Path(path)).split("\n")[:-1]
        return [require_mapping(json.loads(line), str(path), HardwareError) for line in lines]


def emulator_delay(path: str, since: float) -> float:
    """Returns the largest delay (s) of the emulated car behind a port since a time (s, monotonic);
    0 for a real car, one that kept its pace, or events that cannot be read.
    """
    delays = [0.0]
    if is_emulated_port(path):
        with contextlib.suppress(HardwareError):
            events = read_events(Path(path).parent.parent / EVENTS_FILE)
            delays += [e.get("delay_s", 0.0) for e in events if e.get("time_s", 0.0) >= since]
    return max(delays)
