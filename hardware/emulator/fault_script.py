"""Scripts of what happens to the emulated car: faults of its devices, the operator at the radio,
and the events of a run.

```yaml
schema: aerodima/emulation/1
clock: entered          # seconds since the first motor was entered;
                        # driving: since the throttle first left neutral;
                        # start: since the emulator was ready
faults:
  - {time: 1.0, fault: reply_lost, part: tail_roll, duration: 0.1}
  - {time: 3.0, fault: unplugged, part: can}
operator:
  - {time: 0.0, mode: auto_when_asked}
  - {time: 5.0, stop: true}
```
An operator in `auto_when_asked`, as without a script, keeps IDLE until the car reports that it
waits for a choice, and goes back to IDLE when the car asks for that. One in `auto` sends AUTO
whatever the car says.
"""

from __future__ import annotations

import json
import math
import random
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from aerodima.hardware.car.car_ports import JOINTS, SERIAL_DEVICES, SerialDevice
from aerodima.hardware.protocol.radio import OperatorCommand, RadioMode
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml

SCHEMA = "aerodima/emulation/1"
Device = SerialDevice | Literal["can", "console"]
Clock = Literal["entered", "driving", "start"]
_PLUGS = ("can", *SERIAL_DEVICES)


_MotorFaultName = Literal[
    "reply_lost",
    "reply_corrupted",
    "reply_short",
    "reply_long",
    "foreign_id",
    "double_id",
    "v3_frame",
    "over_temperature",
    "motor_fault",
    "encoder_jump",
    "out_of_range",
    "motor_off",
    "blocked",
    "reply_stale",
    "feedback_reversed",
    "motor_reversed",
]
_CarFaultName = Literal[
    "bus_off",
    "teensy_hung",
    "teensy_off_bus",
    "teensy_unpowered",
    "tipped_over",
    "over_speed",
    "attitude_stuck",
    "answer_late",
    "fix_lost",
    "foreign_module",
]
_PlugFaultName = Literal["silent", "unplugged", "renamed", "serial_noise"]
Fault = Literal[_MotorFaultName, _CarFaultName, _PlugFaultName, "frozen"]
FAULT_PARTS: dict[Fault, tuple[str, ...]] = {
    **dict.fromkeys(get_args(_MotorFaultName), JOINTS),
    **dict.fromkeys(get_args(_CarFaultName), ()),
    **dict.fromkeys(get_args(_PlugFaultName), _PLUGS),
    "frozen": ("imu", "gps", *JOINTS),
}
"""Parts to which a fault may happen, as `part` of a script names them; none where there is no
choice."""


_Angle = Annotated[float, Field(ge=-3.14, le=3.14)]


class _Entry(StrictModel):
    time: float = Field(ge=0.0, description="s, on the clock of the script")


class FaultEntry(_Entry):
    """One fault. duration: s, None for ever. count: of the replies that it meets, None all. code:
    of `motor_fault`.

    delay: s; age of what the replies tell, of `reply_stale`, or lateness of the IMU's answers, of
    `answer_late`.
    """

    fault: Fault
    part: str | None = None
    duration: float | None = Field(default=None, gt=0.0)
    count: int | None = Field(default=None, ge=1)
    code: int = Field(default=2, ge=1, le=255)
    delay: float = Field(default=0.05, gt=0.0, le=1.0)

    @model_validator(mode="after")
    def _has_its_part(self) -> FaultEntry:
        allowed = FAULT_PARTS[self.fault]
        if self.part not in (allowed or (None,)):
            raise ValueError(
                f"part of {self.fault}: {self.part!r}; allowed: {', '.join(allowed) or 'none'}"
            )
        return self


class OperatorEntry(_Entry):
    """Commands of the operator from that time on. throttle: -1 to 1. steering, tails: rad. stop:
    emergency stop.

    mode: as the switch stands; `auto_when_asked`: AUTO once the car asks for a choice, IDLE before;
    `manual_when_asked` likewise.
    """

    mode: Literal["idle", "manual", "auto", "control", "auto_when_asked", "manual_when_asked"] = (
        "auto_when_asked"
    )
    throttle: float = Field(default=0.0, ge=-1.0, le=1.0)
    steering: _Angle = 0.0
    pitch_tail: _Angle = 0.0
    roll_tail: _Angle = 0.0
    stop: bool = False

    def command(self, asked: bool) -> OperatorCommand:
        """Returns the command that a frame carries; `asked`: the car asks for a choice, or did so
        last.
        """
        chosen, waits, _ = self.mode.partition("_when_asked")
        if not waits:
            mode = RadioMode[self.mode.upper()]
        elif asked:
            mode = RadioMode[chosen.upper()]
        else:
            mode = RadioMode.IDLE
        return OperatorCommand(mode, self.throttle, self.steering, self.pitch_tail, self.roll_tail)


class Script(StrictModel):
    """The whole script."""

    schema_: Literal["aerodima/emulation/1"] = Field(default="aerodima/emulation/1", alias="schema")
    clock: Clock = "entered"
    faults: tuple[FaultEntry, ...] = ()
    operator: tuple[OperatorEntry, ...] = (OperatorEntry(time=0.0),)


def read_script(path: Path) -> Script:
    """Reads a script.

    Raises `HardwareError` that names file, key, value and what is allowed.
    """
    return checked(Script, read_yaml(path, HardwareError), str(path), HardwareError, schema=SCHEMA)


class FaultBoard:
    """Faults by the clock of the script.

    Attributes:
        time: s on the script's clock; negative before it runs.
    """

    def __init__(self, script: Script, events: EventLog) -> None:
        self._script = script
        self._events = events
        self._begin: float | None = None
        self._met: Counter[int] = Counter()
        self._on: dict[int, FaultEntry] = {}
        self._random = random.Random(0)
        self.time = -math.inf

    def begin(self, clock: Clock, now: float) -> None:
        """Notes that what a clock counts from has come; starts the script for good, if that is its
        clock.
        """
        if clock == self._script.clock and self._begin is None:
            self._begin = now
            self._events.add("script_begins", clock=clock)

    def update(self, now: float) -> None:
        """Switches faults on and off by the clock, and notes it."""
        if self._begin is None:
            return
        self.time = now - self._begin
        for index, entry in enumerate(self._script.faults):
            spent = self._met[index] == entry.count
            end = entry.time + (entry.duration or math.inf)
            on = entry.time <= self.time < end and not spent
            if on and index not in self._on:
                self._on[index] = entry
                self._note("fault_on", entry)
            elif not on and index in self._on:
                del self._on[index]
                self._note("fault_off", entry)

    def entry(self, fault: Fault, part: str | None = None) -> FaultEntry | None:
        """Returns the entry of a fault that is on; None while it is not."""
        return next((entry for _, entry in self._active(fault, part)), None)

    def consume(self, fault: Fault, part: str | None = None) -> bool:
        """Returns whether a fault is on, and counts one of its times."""
        for index, entry in self._active(fault, part):
            self._met[index] += 1
            if self._met[index] == entry.count:
                del self._on[index]
                self._note("fault_off", entry)
            return True
        return False

    def _active(self, fault: Fault, part: str | None) -> Iterator[tuple[int, FaultEntry]]:
        """Yields the entries of a fault that are on, with their indices in the script."""
        for index, entry in self._on.items():
            if (entry.fault, entry.part) == (fault, part):
                yield index, entry

    def corrupt(self, device: Device, data: bytes) -> bytes:
        """Returns what silence and noise leave of the bytes that a device sends."""
        if self.consume("silent", device):
            return b""
        if data and self.consume("serial_noise", device):
            return self._random.randbytes(9) + data[4:]
        return data

    def _note(self, event: str, entry: FaultEntry) -> None:
        self._events.add(event, fault=entry.fault, part=entry.part, script_time_s=entry.time)


class EventLog:
    """Appends to a file; every line is on the disk's side of the process as soon as it is written.

    A line has `time_s` (`time.monotonic`) and `event`, and what belongs to the event.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, "x", encoding="utf-8", buffering=1)  # noqa: SIM115 - open as long as the emulator runs

    def add(self, event: str, **facts: Any) -> None:
        """Adds an event, now."""
        self._file.write(json.dumps({"time_s": time.monotonic(), "event": event, **facts}) + "\n")

    def close(self) -> None:
        """Closes the file."""
        self._file.close()
