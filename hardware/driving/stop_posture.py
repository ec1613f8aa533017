"""Causes of a stop, and the posture of the tail between a stop and the exit of its motors.

A tail that goes limp in mid-swerve turns the car over. So while the car moves no single fault but
one of the pitch motor itself switches that motor off: the drive holds pitch, and roll where its
motor still obeys, until the car is at rest or `max_tail_hold` has passed.
"""

from enum import Enum, auto
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
    REQUEST = auto()
    """The run is over, the operator has left the mode, the log takes no rows."""


_AT_ONCE = frozenset(
    {
        StopCause.EMERGENCY,
        StopCause.SIGNAL,
        StopCause.FALLEN,
        StopCause.PITCH_MOTOR,
        StopCause.TEENSY,
        StopCause.MOTORS_OFF,
        StopCause.ARMING,
    }
)
_AT_ONCE_AT_REST = frozenset(
    {StopCause.ROLL_MOTOR, StopCause.CONTROLLER, StopCause.LATE_LOOP, StopCause.CURRENT}
)


def ends_at_once(cause: StopCause, moves: bool) -> bool:
    """Returns whether the motors go off at once, or are held first; `moves`: the car may move."""
    return cause in _AT_ONCE or (cause in _AT_ONCE_AT_REST and not moves)


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


def posture_text(roll_fault: float) -> str:
    """Returns the posture of a tail that is held, in words; `roll_fault`: of the status."""
    return "pitch held, roll limp" if roll_fault else "pitch and roll held"


def ending_text(posture: str, held: float, moves: bool) -> str:
    """Returns how a stop ended, in words: `posture`, empty for none, held for so long (s), until
    the car came to rest or although it `moves`.
    """
    if not posture:
        return "motors off at once"
    state = "while the car moves" if moves else "at rest"
    return f"{posture} for {held:.2f} s, motors off {state}"
