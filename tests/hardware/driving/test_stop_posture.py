"""Which cause of a stop switches the motors off at once, and which holds the tail first."""

import pytest

from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.hardware.driving.stop_posture import StopCause, ends_at_once, fault_causes
from aerodima.workbench.scenario.signal_table import STATUS

AT_ONCE = {
    "EMERGENCY": (True, True),
    "SIGNAL": (True, True),
    "FALLEN": (True, True),
    "PITCH_MOTOR": (True, True),
    "TEENSY": (True, True),
    "MOTORS_OFF": (True, True),
    "ARMING": (True, True),
    "ROLL_MOTOR": (False, True),
    "CONTROLLER": (False, True),
    "LATE_LOOP": (False, True),
    "CURRENT": (False, True),
    "IMU": (False, False),
    "RADIO": (False, False),
    "SPEED": (False, False),
    "REQUEST": (False, False),
}
"""Whether the motors go off at once: of a car that moves, of one at rest."""


@pytest.mark.parametrize("cause", StopCause)
def test_every_cause_has_its_end(cause):
    assert (ends_at_once(cause, True), ends_at_once(cause, False)) == AT_ONCE[cause.name]


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
