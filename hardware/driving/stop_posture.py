"""Causes of a stop, and the posture of the tail between a stop and the exit of its motors.

A tail that goes limp in mid-swerve turns the car over, and so may one that stands still. So while
the car moves no single fault but one of the pitch motor itself switches that motor off, until the
car is at rest or `max_tail_hold` has passed: the tail follows its law where that still knows the
car, else the drive holds pitch and moves roll to the middle, unless its motor has failed.
"""

from enum import Enum, IntEnum, auto
from typing import Any

from aerodima.hardware.devices.device_states import MotorFault, SourceFault

_GONE = (SourceFault.SILENT, SourceFault.LOST, SourceFault.REPORTED)
_UNFITTED = (SourceFault.NONE, SourceFault.NOT_FITTED)


class StopCause(Enum):
    """What a stop comes from."""

    EMERGENCY = auto()
    """The operator's emergency stop."""
    SIGNAL = auto()
    """A signal, or a controller that has to be given up: the program ends."""
    FALLEN = auto()
    """The car has tipped over, or does not turn at full steering."""
    PITCH_MOTOR = auto()
    """A fault of the pitch motor or of the bus of both motors."""
    TEENSY = auto()
    """The Teensy is silent or its watchdog has acted."""
    MOTORS_OFF = auto()
    """The motors are off without a fault."""
    ARMING = auto()
    """The motors do not take commands, or a check of theirs failed."""
    ROLL_MOTOR = auto()
    """A fault of the roll motor alone."""
    CONTROLLER = auto()
    """The controller raises, leaves, is too slow, or commands what is not finite."""
    LATE_LOOP = auto()
    """Too many late cycles in a row."""
    CURRENT = auto()
    """The motors draw more than the fuse has."""
    IMU = auto()
    RADIO = auto()
    SPEED = auto()
    """The GPS is silent or has no fix, or the car is too fast."""
    LEFT_MODE = auto()
    """The operator has left the mode."""
    LOG = auto()
    """The log takes no rows."""
    REQUEST = auto()
    """The run is over, or has not begun."""


class Posture(IntEnum):
    """What becomes of the tail of a car that stops, in ascending order of what is given up."""

    LAW = 0
    """The pilot goes on commanding it, while throttle and steering are 0."""
    HELD = 1
    """Pitch is held; roll too, in the middle while the car moves, unless its motor has failed."""
    OFF = 2
    """The motors are switched off."""


_POSTURES = {
    StopCause.LEFT_MODE: (Posture.LAW, Posture.HELD),
    StopCause.LOG: (Posture.LAW, Posture.HELD),
    StopCause.RADIO: (Posture.LAW, Posture.HELD),
    StopCause.SPEED: (Posture.LAW, Posture.HELD),
    StopCause.IMU: (Posture.HELD, Posture.HELD),
    StopCause.REQUEST: (Posture.HELD, Posture.HELD),
    StopCause.ROLL_MOTOR: (Posture.HELD, Posture.OFF),
    StopCause.CONTROLLER: (Posture.HELD, Posture.OFF),
    StopCause.LATE_LOOP: (Posture.HELD, Posture.OFF),
    StopCause.CURRENT: (Posture.HELD, Posture.OFF),
}
"""Postures of a car that moves and of one at rest; the other causes switch the motors off."""


def posture_after(cause: StopCause, moves: bool) -> Posture:
    """Returns the posture that a cause of a stop asks for; `moves`: the car may move."""
    moving, resting = _POSTURES.get(cause, (Posture.OFF, Posture.OFF))
    return moving if moves else resting


def fault_causes(status: Any, has_tail: bool) -> list[StopCause]:
    """Returns the causes to stop that the named status of a reading has; empty for a healthy
    car.
    """
    stopped = status.operator_fault == SourceFault.STOPPED
    faults = {
        StopCause.EMERGENCY: stopped,
        StopCause.PITCH_MOTOR: has_tail and status.tail_pitch_fault != MotorFault.NONE,
        StopCause.TEENSY: status.sail_fault not in _UNFITTED,
        StopCause.ROLL_MOTOR: has_tail and status.tail_roll_fault != MotorFault.NONE,
        StopCause.RADIO: status.operator_fault != SourceFault.NONE and not stopped,
        StopCause.IMU: status.imu_fault != SourceFault.NONE,
        StopCause.SPEED: status.speed_fault in _GONE,
    }
    return [cause for cause, present in faults.items() if present]


def ending_text(posture: str, held: float, moves: bool) -> str:
    """Returns how a stop ended, in words: `posture`, empty for none, kept for so long (s), until
    the car came to rest or although it `moves`.
    """
    if not posture:
        return "motors off at once"
    state = "while the car moves" if moves else "at rest"
    return f"{posture} for {held:.2f} s, motors off {state}"
