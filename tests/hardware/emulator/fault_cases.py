"""The faults of hardware/emulator/fault_table.csv, for both wirings, and what must follow of
each.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import CarCommand
from tests.hardware.emulator.breakers import (
    Blind,
    Breaker,
    ClockJumps,
    ControllerRaises,
    DiskFull,
    FolderRemoved,
    OpenedAgain,
    ReceiverDies,
    SecondProgram,
    ThrottleSteps,
    second_drive,
    watchdog_test,
)

PITCH = np.array([0.0, 0.0, 17.0, 5.0, 0.0])
ROLL = np.array([-math.pi / 2, 0.0, 17.0, 5.0, 0.0])
AT = 1.0
"""When the fault comes: s after the throttle was first opened, which is when the car drives."""
ASKED = {"time": 0.0, "mode": "auto_when_asked"}
HELD = load_drive_safety().max_tail_hold
"""For how long the tail of a car that moves is held after a fault, s, at most."""
_BOTH = ("watched_can", "teensy_bridge")


@dataclass(frozen=True)
class Case:
    """A fault of the table, and what must follow.

    Attributes:
        name: as the table calls it.
        also: further entries of the script, at `AT`.
        fault: entry of the script, at `AT` unless it has a time; None: `broken_command`, `breaker`
            or the operator.
        stops: whether the car must stop. within: s from the fault to the motors off, as long as the
            cause allows.
        throttle_within: s to the neutral pulse, where that takes longer; 0: as `within`.
        reason: part of the reason that the drive gives. acts: who switches the car off, for the
            table.
        breaker: what breaks in the computer itself. broken_command: what the controller commands
            from `AT` on, also as a function of the time since then (s).
        run_time: s, of a drive that nothing stops.
        held: the tail is held first: the motors go off up to `HELD` later.
    """

    name: str
    wiring: str
    fault: dict | None = None
    stops: bool = True
    within: float = 0.3
    throttle_within: float = 0.0
    reason: str = ""
    acts: str = "drive"
    operator: tuple[dict, ...] = (ASKED,)
    breaker: Callable[[], Breaker] = Breaker
    broken_command: CarCommand | Callable[[float], CarCommand] | None = None
    run_time: float = AT + 2.5
    held: bool = False
    also: tuple[dict, ...] = ()

    @property
    def of_the_computer(self):
        """Whether nothing of the emulated car breaks."""
        return self.fault is None and (
            self.broken_command is not None or self.breaker is not Breaker
        )


def _motor(name, fault, reason, on_the_bridge=None, **keys):
    """A fault of the roll motor on both wirings; `on_the_bridge`: the reason there, where it is
    another.
    """
    extra = {
        key: keys.pop(key) for key in ("duration", "count", "code", "delay", "time") if key in keys
    }
    entry = {"fault": fault, "part": "tail_roll", **extra}
    reasons = (reason, reason if on_the_bridge is None else on_the_bridge)
    return tuple(
        Case(name, wiring, entry, reason=why, held=True, **keys)
        for wiring, why in zip(_BOTH, reasons, strict=True)
    )


def _device(name, wiring, device, fault, duration=None, **keys):
    entry = {"fault": fault, "part": device} | ({} if duration is None else {"duration": duration})
    return Case(name, wiring, entry, **keys)


def _on_both(name, **keys):
    return tuple(Case(name, wiring, **keys) for wiring in _BOTH)


_MOVING = CarCommand(0.1, 0.3, PITCH, np.array([-0.6, 0.0, 17.0, 5.0, 0.0]))


def _swinging(since):
    """The roll joint to and fro between its stop and 10 degrees from upright, 1.5 times a
    second.
    """
    roll = -0.87 - 0.7 * math.cos(2.0 * math.pi * 1.5 * since)
    return CarCommand(0.1, 0.3, PITCH, np.array([roll, 0.0, 17.0, 5.0, 0.0]))


_PRESSING = CarCommand(0.1, 0.3, PITCH, np.array([-math.pi / 2 + 0.4, 0.0, 55.0, 1.0, 0.0]))
_SILENT = "tail"
_STOP = (ASKED, {"time": AT, "stop": True})
_BROKEN = CarCommand(0.1, math.nan, PITCH, math.nan * ROLL)

CASES: tuple[Case, ...] = (
    *_motor("reply lost once", "reply_lost", "", stops=False, count=1, acts="nothing stops"),
    *_motor("reply lost for 100 ms", "reply_lost", _SILENT, duration=0.1),
    *_motor("reply lost for ever", "reply_lost", _SILENT),
    *_motor("reply corrupted", "reply_corrupted", _SILENT),
    *_motor("reply short, 5 bytes", "reply_short", _SILENT),
    *_motor("reply long, 7 bytes", "reply_long", _SILENT),
    *_motor("reply under a foreign id", "foreign_id", _SILENT),
    *_motor("two motors with one id", "double_id", "tail roll", acts="drive: position jumped"),
    *_motor("V3 frame", "v3_frame", "V3", _SILENT),
    *_motor("over-temperature", "over_temperature", "95"),
    *_motor("motor fault code", "motor_fault", "over-current"),
    *_motor("encoder jump", "encoder_jump", "tail roll"),
    *_motor(
        "position beyond range",
        "out_of_range",
        "tail roll",
        within=1.3,
        acts="drive: reported torque",
    ),
    Case(
        "bus-off",
        "watched_can",
        {"fault": "bus_off"},
        reason=_SILENT,
        acts="firmware",
    ),
    Case(
        "bus-off for 0.4 s",
        "teensy_bridge",
        {"fault": "bus_off", "duration": 0.4},
        reason=_SILENT,
        within=0.7,
        acts="drive, once the bus is back",
    ),
    _device(
        "adapter unplugged for 0.5 s",
        "watched_can",
        "can",
        "unplugged",
        0.5,
        acts="firmware",
    ),
    _device("adapter silent", "watched_can", "can", "silent", reason=_SILENT),
    _device("noise on the adapter's line", "watched_can", "can", "serial_noise"),
    _device("Teensy unplugged", "teensy_bridge", "teensy", "unplugged", acts="firmware"),
    _device("Teensy silent (its strings are lost)", "watched_can", "teensy", "silent"),
    _device("Teensy silent (its strings are lost)", "teensy_bridge", "teensy", "silent"),
    _device("noise on the Teensy's line", "watched_can", "teensy", "serial_noise"),
    _device("noise on the Teensy's line", "teensy_bridge", "teensy", "serial_noise"),
    # Nobody but the Teensy's own processor can move the throttle then; it restarts after 0.5 s.
    Case(
        "Teensy hangs",
        "teensy_bridge",
        {"fault": "teensy_hung"},
        within=0.9,
        acts="processor's watchdog, after 0.5 s",
    ),
    *_on_both(
        "IMU silent",
        fault={"fault": "silent", "part": "imu"},
        reason="IMU",
        within=0.3,
        held=True,
        acts="drive, held",
    ),
    *_on_both(
        "GPS silent",
        fault={"fault": "silent", "part": "gps"},
        reason="GPS",
        within=1.3,
        held=True,
        acts="drive, held, after 1 s",
    ),
    *_on_both(
        "radio silent",
        fault={"fault": "silent", "part": "radio"},
        reason="radio",
        within=0.5,
        held=True,
        acts="drive, held, after 0.25 s",
    ),
    *_on_both("operator's emergency stop", operator=_STOP, reason="emergency"),
    *_on_both("commanded NaN", broken_command=_BROKEN, reason="NaN", held=True),
    *_on_both(
        "exception in the controller",
        breaker=ControllerRaises,
        reason="ZeroDivisionError",
        held=True,
    ),
    *_on_both(
        "clock jumps ahead by an hour",
        breaker=lambda: ClockJumps(3600.0),
        reason="tail",
    ),
    *_on_both(
        "clock jumps back by an hour",
        breaker=lambda: ClockJumps(-3600.0),
        reason="tail",
    ),
    *_on_both(
        "log disk full",
        breaker=DiskFull,
        reason="run.parquet",
        within=0.6,
        held=True,
        acts="drive, held, at the next rows",
    ),
    *_on_both("receive thread dies", breaker=ReceiverDies),
    *_motor(
        "motor off by itself, then told to move",
        "motor_off",
        "tail roll",
        broken_command=_MOVING,
        acts="drive: reported torque",
    ),
    *_on_both(
        "I2t: tail presses against what blocks it",
        fault={"fault": "blocked", "part": "tail_roll"},
        broken_command=_PRESSING,
        reason="tail roll",
        within=6.0,
        held=True,
        run_time=AT + 7.0,
        acts="drive, after 2 to 4 s",
    ),
    *_motor(
        "replies 50 ms old, the tail swings",
        "reply_stale",
        "tail roll",
        time=AT + 0.6,
        delay=0.05,
        broken_command=_swinging,
        acts="drive: reported torque",
    ),
    *_motor(
        "replies 200 ms old at rest, then told to move",
        "reply_stale",
        "tail roll",
        delay=0.2,
        broken_command=_MOVING,
        acts="drive: reported torque",
    ),
    *_motor(
        "reply frozen, the tail swings",
        "frozen",
        "tail roll",
        time=AT + 0.6,
        broken_command=_swinging,
        acts="drive: reported torque",
    ),
    *_motor(
        "feedback reversed while driving",
        "feedback_reversed",
        "tail roll",
        acts="drive: position jumped",
    ),
    *_motor(
        "motor reversed while driving",
        "motor_reversed",
        "tail roll",
        time=AT + 0.6,
        broken_command=_swinging,
    ),
    *_motor("low battery: motor reports under-voltage", "motor_fault", "under-voltage", code=4),
    *_motor("over-temperature flag", "motor_fault", "over-temperature", code=1),
    *_on_both(
        "IMU frozen while driving",
        fault={"fault": "frozen", "part": "imu"},
        reason="IMU",
        within=0.3,
        held=True,
        acts="drive, held, after 10 equal samples",
    ),
    *_on_both(
        "GPS frozen while driving",
        fault={"fault": "frozen", "part": "gps", "time": AT + 1.0},
        reason="GPS",
        within=1.4,
        held=True,
        run_time=AT + 4.0,
        acts="drive, held, after 10 equal speeds",
    ),
    *_on_both(
        "attitude stuck, the gyro lives",
        fault={"fault": "attitude_stuck", "time": AT + 1.0},
        reason="attitude",
        within=0.5,
        held=True,
        run_time=AT + 4.0,
        acts="drive, held, after 10 equal samples",
    ),
    *_on_both(
        "attitude stuck, the car lies on its side",
        fault={"fault": "attitude_stuck"},
        also=({"fault": "tipped_over"},),
        reason="attitude",
        within=0.4,
        acts="drive: accelerometer",
    ),
    *_on_both(
        "IMU answers once 60 ms late",
        fault={"fault": "answer_late", "delay": 0.06, "count": 1},
        stops=False,
        acts="nothing stops",
    ),
    *_on_both(
        "GPS loses its fix while driving",
        fault={"fault": "fix_lost"},
        reason="fix",
        within=1.3,
        held=True,
        acts="drive, held, after 1 s",
    ),
    *_on_both("car tips over", fault={"fault": "tipped_over"}, reason="degrees", acts="drive"),
    *_on_both(
        "car tips over, the drive goes on commanding",
        fault={"fault": "tipped_over"},
        breaker=Blind,
        reason="Teensy",
        acts="firmware",
    ),
    *_on_both(
        "over-speed",
        fault={"fault": "over_speed"},
        reason="6.7",
        within=0.6,
        held=True,
        acts="drive, held",
    ),
    *_on_both(
        "full throttle at once",
        broken_command=CarCommand(0.0, 1.0, PITCH, ROLL),
        breaker=ThrottleSteps,
        stops=False,
        run_time=AT + 1.0,
        acts="nothing stops; rate limited",
    ),
    Case(
        "Teensy loses its power",
        "watched_can",
        {"fault": "teensy_unpowered"},
        acts="drive; no pulses",
    ),
    Case(
        "Teensy loses its power for 0.4 s",
        "teensy_bridge",
        {"fault": "teensy_unpowered", "duration": 0.4},
        within=0.7,
        acts="firmware, when it starts again",
    ),
    *_on_both(
        "Teensy's port comes back under another name",
        fault={"fault": "renamed", "part": "teensy"},
        breaker=OpenedAgain,
        acts="drive or firmware; next drive refused",
    ),
    Case(
        "adapter comes back under another name",
        "watched_can",
        {"fault": "renamed", "part": "can"},
        breaker=OpenedAgain,
        acts="firmware; next drive refused",
    ),
    *_on_both(
        "log folder removed while driving",
        breaker=FolderRemoved,
        stops=False,
        acts="nothing stops; log is written",
    ),
    Case(
        "Teensy off the bus",
        "watched_can",
        {"fault": "teensy_off_bus"},
        reason="bus",
        acts="drive",
    ),
    Case(
        "Teensy hangs",
        "watched_can",
        {"fault": "teensy_hung"},
        throttle_within=0.9,
        acts="drive; throttle: processor's watchdog",
    ),
    Case(
        "Teensy unplugged",
        "watched_can",
        {"fault": "unplugged", "part": "teensy"},
        acts="drive; throttle: firmware",
    ),
    *_on_both(
        "second drive on the same devices",
        breaker=lambda: SecondProgram(second_drive),
        stops=False,
        acts="nothing stops; second refused",
    ),
    *_on_both(
        "watchdog test beside a drive",
        breaker=lambda: SecondProgram(watchdog_test),
        stops=False,
        run_time=AT + 6.0,
        acts="nothing stops; test refused",
    ),
)
