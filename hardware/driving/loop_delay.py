"""Delays of the computer that drives the car, as the cause of apparent faults of its devices.

A loop or an emulator that is held up hears nothing meanwhile: motors and sensors look silent
although they are not.
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
"""Faults of a motor that also appear when the computer falls behind."""
_MIN_DELAY = 0.02
"""Least delay that can make a motor seem silent, s: its replies may be that old."""
_WATCHDOG_DELAY = 0.075
"""Least delay that can make the Teensy's watchdog act, s: half its time-out."""


def with_delay(reason: str, delay: float, least: float = _MIN_DELAY) -> str:
    """Returns the reason of a stop, preceded by the computer's delay (s) if that explains it: if
    it is at least `least` (s), the value of `least_delay`.
    """
    if delay < least:
        return reason
    return f"the computer fell behind by {delay * 1000:.0f} ms: {reason}"


def least_delay(reading: CarReading, has_tail: bool) -> float:
    """Returns the least delay of the computer (s) that explains the faults of a reading: a constant
    for motors and watchdog, otherwise half the age of the youngest silent source.

    It is infinite for faults that no delay explains.
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
