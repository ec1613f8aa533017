"""Scripts of what happens to the emulated car (faults of its devices, the operator at the radio),
and the log of the events of a run.

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
"""Parts that a fault may affect, as `part` of a script names them; none where there is no
choice."""


_Angle = Annotated[float, Field(ge=-3.14, le=3.14)]


class _Entry(StrictModel):
    time: float = Field(ge=0.0, description="time on the clock of the script, s")


class FaultEntry(_Entry):
    """One fault.

    Attributes:
        fault: name of the fault.
        part: part that it affects; None where there is no choice.
        duration: duration of the fault, s; None for ever.
        count: number of replies or transmissions that it affects; None for all.
        code: fault code that the motor reports, for `motor_fault`.
        delay: age of what the replies tell, for `reply_stale`, or lateness of the IMU's answers,
            for `answer_late`, s.
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
    """Commands of the operator from a time on.

    Attributes:
        mode: position of the switch; `auto_when_asked` is AUTO once the car asks for a choice and
            IDLE before, `manual_when_asked` likewise.
        throttle: commanded throttle, -1 to 1.
        steering: commanded steering angle, rad.
        pitch_tail: commanded pitch angle of the tail, rad.
        roll_tail: commanded roll angle of the tail, rad.
        stop: whether the operator sends an emergency stop.
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
        """Returns the command that a frame carries; `asked` says whether the car's last prompt was
        for a choice.
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
    """Script of an emulation: its clock, the faults and the operator's commands."""

    schema_: Literal["aerodima/emulation/1"] = Field(default="aerodima/emulation/1", alias="schema")
    clock: Clock = "entered"
    faults: tuple[FaultEntry, ...] = ()
    operator: tuple[OperatorEntry, ...] = (OperatorEntry(time=0.0),)


def read_script(path: Path) -> Script:
    """Reads a script.

    Raises a `HardwareError` that names file, key, value and what is allowed.
    """
    return checked(Script, read_yaml(path, HardwareError), str(path), HardwareError, schema=SCHEMA)


class FaultBoard:
    """Switchboard of the faults, by the clock of the script.

    Attributes:
        time: time on the script's clock, s; negative infinity before it runs.
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
        """Notes that the event from which a clock counts has come; starts the script, for good, if
        that is its clock.
        """
        if clock == self._script.clock and self._begin is None:
            self._begin = now
            self._events.add("script_begins", clock=clock)

    def update(self, now: float) -> None:
        """Switches faults on and off by the clock, and notes each change."""
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
        """Returns whether a fault is on, and if so counts one occurrence of it."""
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
    """Log of events in a file; every line has left the process as soon as it is written.

    A line has `time_s` (`time.monotonic`), `event`, and the facts of the event.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, "x", encoding="utf-8", buffering=1)  # noqa: SIM115 - open as long as the emulator runs

    def add(self, event: str, **facts: Any) -> None:
        """Adds an event, now."""
        self._file.write(json.dumps({"time_s": time.monotonic(), "event": event, **facts}) + "\n")

    def close(self) -> None:
        """Closes the file."""
        self._file.close()
