"""Delays of the computer that drives the car, as the cause of what its devices seem to do.

A loop or an emulator that is held up hears nothing meanwhile: motors and sensors look silent, and
are not.
"""

from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.signal_table import STATUS

_UNHEARD = {
    MotorFault.NO_REPLY,
    MotorFault.BUS,
    MotorFault.LOOP_STALLED,
    MotorFault.NOT_FOLLOWING,
}
"""Faults of a motor that a computer which falls behind makes as well."""
_MIN_DELAY = 0.02
"""Delay that a device may seem silent for, s: the motors' replies may be that old."""


def with_delay(reason: str, delay: float) -> str:
    """Returns the reason of a stop with the delay of the computer (s) that is its cause, if there
    was one.
    """
    if delay < _MIN_DELAY:
        return reason
    return f"the computer fell behind by {delay * 1000:.0f} ms: {reason}"


def is_silence(values: FloatArray, has_tail: bool) -> bool:
    """Returns whether the faults of a status are such as a computer that falls behind makes."""
    status = STATUS.read(values)
    motors = {status.tail_pitch_fault, status.tail_roll_fault}
    motors -= {MotorFault.NONE, MotorFault.OTHER_MOTOR}
    if status.operator_fault == SourceFault.STOPPED:
        return False
    if has_tail and motors:
        return motors <= _UNHEARD
    silent = (status.imu_fault, status.speed_fault, status.operator_fault, status.sail_fault)
    return SourceFault.SILENT in silent or status.sail_fault == SourceFault.REPORTED
