"""Which cause of a stop switches the motors off at once, and what becomes of the tail after the
others.
"""

import pytest

from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.hardware.driving.stop_posture import (
    Posture,
    StopCause,
    fault_causes,
    posture_after,
)
from aerodima.workbench.scenario.signal_table import STATUS

LAW, HELD, OFF = Posture
POSTURES = {
    "EMERGENCY": (OFF, OFF),
    "SIGNAL": (OFF, OFF),
    "FALLEN": (OFF, OFF),
    "PITCH_MOTOR": (OFF, OFF),
    "TEENSY": (OFF, OFF),
    "MOTORS_OFF": (OFF, OFF),
    "ARMING": (OFF, OFF),
    "ROLL_MOTOR": (HELD, OFF),
    "CONTROLLER": (HELD, OFF),
    "LATE_LOOP": (HELD, OFF),
    "CURRENT": (HELD, OFF),
    "IMU": (HELD, HELD),
    "REQUEST": (HELD, HELD),
    "RADIO": (LAW, HELD),
    "SPEED": (LAW, HELD),
    "LEFT_MODE": (LAW, HELD),
    "LOG": (LAW, HELD),
}
"""Of a car that moves, and of one at rest."""


@pytest.mark.parametrize("cause", StopCause)
def test_every_cause_has_its_posture(cause):
    assert (posture_after(cause, True), posture_after(cause, False)) == POSTURES[cause.name]


def causes(has_tail=True, **faults):
    return fault_causes(STATUS.read(STATUS.zeros())._replace(**faults), has_tail)


@pytest.mark.parametrize("fault", [fault for fault in MotorFault if fault])
def test_a_fault_of_a_motor_is_that_of_its_joint_alone(fault):
    assert causes(tail_pitch_fault=float(fault)) == [StopCause.PITCH_MOTOR]
    assert causes(tail_roll_fault=float(fault)) == [StopCause.ROLL_MOTOR]
    assert causes(has_tail=False, tail_roll_fault=float(fault)) == []


@pytest.mark.parametrize("fault", SourceFault)
def test_every_fault_of_a_device_has_its_cause(fault):
    healthy = fault is SourceFault.NONE
    gone = fault in (SourceFault.SILENT, SourceFault.LOST, SourceFault.REPORTED)
    fitted = not healthy and fault is not SourceFault.NOT_FITTED
    radio = StopCause.EMERGENCY if fault is SourceFault.STOPPED else StopCause.RADIO
    assert causes(operator_fault=float(fault)) == [radio] * (not healthy)
    assert causes(imu_fault=float(fault)) == [StopCause.IMU] * (not healthy)
    assert causes(speed_fault=float(fault)) == [StopCause.SPEED] * gone
    assert causes(sail_fault=float(fault)) == [StopCause.TEENSY] * fitted


def test_of_several_faults_the_emergency_stop_comes_first():
    several = causes(
        imu_fault=SourceFault.SILENT,
        operator_fault=SourceFault.STOPPED,
        tail_roll_fault=MotorFault.NO_REPLY,
    )
    assert several == [StopCause.EMERGENCY, StopCause.ROLL_MOTOR, StopCause.IMU]
