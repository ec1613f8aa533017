"""What the car tells the operator by radio, 20 times per second: armed, faults, and what the plots show.

Class 4, packed little-endian: class, sequence, flags (1 armed, 2 the emergency stop came, 4 and 8 what the car asks the
operator for, 16 the car has no tail), number of the car, mode last heard, fault codes of
`aerodima.workbench.config.signal_table.STATUS_SOURCES`, eight 32-bit floats, then the worst fault in words.
43 to 100 bytes, as many as the smallest modules carry.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from enum import IntEnum

from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.radio import RadioMode

REPORT_CLASS = 4
PERIOD = 0.05
"""s between two reports."""
_HEAD = struct.Struct("<BBBBB6B8f")
_MOST_BYTES = 100
_ARMED, _STOPPED = 1, 2
_ASKS_SHIFT = 2
_NO_TAIL = 16
_NUMBERS = 8


class Asks(IntEnum):
    """What an armed car wants of its operator before it drives."""

    NOTHING = 0
    REST = 1
    """The switch stands on AUTO, MANUAL or CONTROL from before: it must be seen in IDLE first."""
    CHOICE = 2
    """It was seen in IDLE; AUTO, MANUAL and CONTROL are obeyed from now on."""


@dataclass(frozen=True, slots=True)
class CarReport:
    """One report.

    Attributes:
        armed: the car takes commands. stopped: the operator's emergency stop came and stays.
        mode: of the last command that the car heard.
        faults: codes of tail pitch, tail roll, sail, imu, speed, operator; 0 for none.
        yaw_rate: rad/s. roll: of the chassis, rad. tail_pitch, tail_roll: rad. torque_pitch, torque_roll: N m.
        speed: m/s. operator_age: s since the operator was heard alive, infinite before.
        text: the worst fault in words, cut to what the frame holds.
        asks: what the operator must do before the car drives.
        car: number of the car among those that share a radio channel, 0 to 255.
        has_tail: the car has tail motors; without them their faults, angles and torques say nothing.
    """

    armed: bool
    stopped: bool
    mode: RadioMode
    faults: tuple[int, int, int, int, int, int] = (0, 0, 0, 0, 0, 0)
    yaw_rate: float = 0.0
    roll: float = 0.0
    tail_pitch: float = 0.0
    tail_roll: float = 0.0
    torque_pitch: float = 0.0
    torque_roll: float = 0.0
    speed: float = 0.0
    operator_age: float = math.inf
    text: str = ""
    asks: Asks = Asks.NOTHING
    has_tail: bool = True
    car: int = 0


def make_report(report: CarReport, sequence: int = 0) -> bytes:
    """The bytes of a report; the sequence is taken modulo 256."""
    flags = _ARMED * report.armed | _STOPPED * report.stopped | report.asks << _ASKS_SHIFT
    flags |= _NO_TAIL * (not report.has_tail)
    numbers = (
        report.yaw_rate,
        report.roll,
        report.tail_pitch,
        report.tail_roll,
        report.torque_pitch,
        report.torque_roll,
        report.speed,
        report.operator_age,
    )
    head = _HEAD.pack(REPORT_CLASS, sequence % 256, flags, report.car, report.mode, *report.faults, *numbers)
    return head + report.text.encode()[: _MOST_BYTES - _HEAD.size]


def decode_report(data: bytes) -> CarReport:
    """The report in a frame.

    Raises:
        FrameError: another class or length, an unknown mode or flag, or NaN.
    """
    if not _HEAD.size <= len(data) <= _MOST_BYTES:
        raise FrameError(f"car report of {len(data)} bytes; allowed are {_HEAD.size} to {_MOST_BYTES}")
    report_class, _, flags, car, mode, *rest = _HEAD.unpack_from(data)
    if report_class != REPORT_CLASS:
        raise FrameError(f"car report of class {report_class}; allowed is {REPORT_CLASS}")
    if mode not in tuple(RadioMode):
        raise FrameError(f"car report: mode {mode}; allowed: {', '.join(str(item.value) for item in RadioMode)}")
    asks = (flags & ~_NO_TAIL) >> _ASKS_SHIFT
    if asks not in tuple(Asks):
        most = (max(Asks) + 1) << _ASKS_SHIFT
        raise FrameError(f"car report: flags {flags}; allowed is less than {most}, and {_NO_TAIL} more without a tail")
    faults, numbers = rest[:-_NUMBERS], rest[-_NUMBERS:]
    if any(math.isnan(number) for number in numbers):
        raise FrameError(f"car report with NaN: {numbers}")
    report = CarReport(bool(flags & _ARMED), bool(flags & _STOPPED), RadioMode(mode), tuple(faults), *numbers)
    text = data[_HEAD.size :].decode(errors="ignore")
    return replace(report, text=text, asks=Asks(asks), has_tail=not flags & _NO_TAIL, car=car)
