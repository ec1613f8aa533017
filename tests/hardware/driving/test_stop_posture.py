"""Which cause of a stop switches the motors off at once, and what becomes of the tail after the
others.
"""

from typing import get_args

import numpy as np
import pytest

from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.hardware.driving.stop_posture import Posture, StopCause, fault_causes, posture_after
from aerodima.workbench.scenario.signal_table import STATUS_SOURCES

AT_ONCE = "emergency stop, signal, fallen, pitch motor, teensy, motors off, arming"
BROKEN = "roll motor, controller, late loop, current"
BY_LAW = "radio, speed, mode, log"


@pytest.mark.parametrize(
    ("moves", "posture", "names"),
    [
        (True, Posture.OFF, AT_ONCE),
        (True, Posture.HELD, f"{BROKEN}, imu"),
        (True, Posture.LAW, BY_LAW),
        (False, Posture.OFF, f"{AT_ONCE}, {BROKEN}"),
        (False, Posture.HELD, f"{BY_LAW}, imu"),
    ],
)
def test_every_cause_has_its_posture(moves, posture, names):
    causes = {cause for cause in get_args(StopCause) if posture_after(cause, moves) is posture}
    assert causes == set(names.split(", "))


def causes_of(source, fault, has_tail=True):
    faults = np.zeros(len(STATUS_SOURCES))
    faults[STATUS_SOURCES.index(source)] = fault
    return fault_causes(faults, has_tail)


@pytest.mark.parametrize("fault", list(MotorFault)[1:])
def test_a_fault_of_a_motor_is_that_of_its_joint_alone(fault):
    assert causes_of("tail_pitch", fault) == ["pitch motor"]
    assert causes_of("tail_roll", fault) == ["roll motor"]
    assert causes_of("tail_roll", fault, has_tail=False) == []


SILENT, LOST, REPORTED = SourceFault.SILENT, SourceFault.LOST, SourceFault.REPORTED


@pytest.mark.parametrize("fault", list(SourceFault))
def test_every_fault_of_a_device_has_its_cause(fault):
    emergency = ["emergency stop"] * (fault is SourceFault.STOPPED)
    stops = fault in (SILENT, LOST, REPORTED)
    assert causes_of("operator", fault) == emergency + ["radio"] * bool(fault)
    assert causes_of("imu", fault) == ["imu"] * bool(fault)
    assert causes_of("speed", fault) == ["speed"] * stops
    assert causes_of("sail", fault) == ["teensy"] * (fault > SourceFault.NOT_FITTED)
