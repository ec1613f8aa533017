"""Delays of the computer that drives the car, as the cause of what its devices seem to do.

A loop or an emulator that is held up hears nothing meanwhile: motors and sensors look silent, and
are not.
"""

import math

from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.hardware.protocol.teensy import SWITCHED_OFF, TeensyStatus

_UNHEARD = {
    MotorFault.NO_REPLY,
    MotorFault.BUS,
    MotorFault.LOOP_STALLED,
    MotorFault.NOT_FOLLOWING,
}
"""Faults of a motor that a computer which falls behind makes as well."""
_MIN_DELAY = 0.02
"""Delay that a motor may seem silent for, s: its replies may be that old."""
_WATCHDOG_DELAY = 0.075
"""Delay that the watchdog of the Teensy may have acted for, s: half its time-out."""


def with_delay(reason: str, delay: float, least: float = _MIN_DELAY) -> str:
    """Returns the reason of a stop with the delay of the computer (s) that is its cause, if there
    was one; `least`: of `least_delay`, s.
    """
    if delay < least:
        return reason
    return f"the computer fell behind by {delay * 1000:.0f} ms: {reason}"


def least_delay(reading: CarReading, has_tail: bool) -> float:
    """Returns the least delay of the computer (s) that makes the faults of a reading: half the
    age of what is silent. Infinite for faults that no delay makes.
    """
    status = reading.named_status
    motors = {status.tail_pitch_fault, status.tail_roll_fault}
    motors -= {MotorFault.NONE, MotorFault.OTHER_MOTOR}
    fallen = reading.fault_texts.get("sail") == SWITCHED_OFF[TeensyStatus.ATTITUDE]
    if status.operator_fault == SourceFault.STOPPED or fallen:
        return math.inf
    if has_tail and motors:
        return _MIN_DELAY if motors <= _UNHEARD else math.inf
    if status.sail_fault == SourceFault.REPORTED:
        return _WATCHDOG_DELAY
    silent = reading.status[:-1:2][reading.status[1::2] == SourceFault.SILENT]
    return min(silent, default=math.inf) / 2.0
