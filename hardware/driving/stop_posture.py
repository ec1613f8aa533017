"""Causes of a stop, and the posture of the tail between a stop and the exit of its motors.

A tail that stays where it is in mid-swerve may turn the car over, and so may one that goes limp.
While the car moves, most causes therefore leave the pitch motor on until the car is at rest or
`max_tail_hold` has passed: the drive holds pitch and moves roll to the middle, unless the roll
motor has failed. A fault of the pitch motor or of the Teensy, a fall, an emergency stop or a signal
switches the motors off at once. The pilot's commands no longer reach the car: its schedule or its
operator may still steer, but the wheels do not follow.
"""

from enum import IntEnum
from typing import Literal

from aerodima.hardware.devices.device_states import SourceFault
from aerodima.workbench.core.array_types import FloatArray

StopCause = Literal[
    "emergency stop",
    "signal",
    "fallen",
    "pitch motor",
    "teensy",
    "motors off",
    "arming",
    "roll motor",
    "controller",
    "late loop",
    "current",
    "imu",
    "radio",
    "speed",
    "mode",
    "log",
]
"""Causes of a stop. `motors off`: the motors are off without a fault; `speed`: the GPS speed is too
high, or lost; `mode`: the operator has left the mode; `log`: the log takes no rows."""
GONE = (SourceFault.SILENT, SourceFault.LOST, SourceFault.REPORTED)
"""Faults of a device that is no longer heard, or cannot be relied on."""


class Posture(IntEnum):
    """State of the tail of a car that stops; a higher posture gives up more."""

    HELD = 0
    """Pitch is held; roll too, in the middle while the car moves, unless its motor has failed."""
    OFF = 1
    """The motors are switched off."""


HELD, OFF = Posture


def posture_after(cause: StopCause, moves: bool) -> Posture:
    """Returns the posture that a cause of a stop asks for; `moves` says that the car may move."""
    if cause in ("roll motor", "controller", "late loop", "current"):
        return HELD if moves else OFF
    return HELD if cause in ("imu", "radio", "speed", "mode", "log") else OFF


def fault_causes(faults: FloatArray, has_tail: bool) -> list[StopCause]:
    """Returns the causes of a stop in the fault codes of a status (6,); empty for a healthy car."""
    pitch, roll, sail, imu, speed, operator = faults
    present: dict[StopCause, bool] = {
        "emergency stop": operator == SourceFault.STOPPED,
        "pitch motor": has_tail and pitch,
        "roll motor": has_tail and roll,
        "teensy": sail > SourceFault.NOT_FITTED,
        "radio": operator,
        "imu": imu,
        "speed": speed in GONE,
    }
    return [cause for cause, holds in present.items() if holds]
