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
HELD = "imu, radio, speed, mode, log"


@pytest.mark.parametrize(
    ("moves", "posture", "names"),
    [
        (True, Posture.OFF, AT_ONCE),
        (True, Posture.HELD, f"{BROKEN}, {HELD}"),
        (False, Posture.OFF, f"{AT_ONCE}, {BROKEN}"),
        (False, Posture.HELD, HELD),
    ],
)
def test_every_cause_has_its_posture(moves, posture, names):
    causes = {cause for cause in get_args(StopCause) if posture_after(cause, moves) is posture}
    assert causes == set(names.split(", "))


@pytest.mark.parametrize("code", range(len(MotorFault)))
def test_every_fault_of_a_source_has_its_cause(code):
    faults = code * np.eye(len(STATUS_SOURCES))
    named = SourceFault(code).name if code < len(SourceFault) else ""
    teensy = code > SourceFault.NOT_FITTED
    speed = named in ("SILENT", "LOST", "REPORTED")
    emergency = ["emergency stop"] if named == "STOPPED" else []
    one = bool(code)
    expected = {
        "tail_pitch": ["pitch motor"] * one,
        "tail_roll": ["roll motor"] * one,
        "sail": ["teensy"] * teensy,
        "imu": ["imu"] * one,
        "speed": ["speed"] * speed,
        "operator": emergency + ["radio"] * one,
    }
    for source, row in zip(STATUS_SOURCES, faults, strict=True):
        assert fault_causes(row, True) == expected[source]
        without_tail = [] if source.startswith("tail") else expected[source]
        assert fault_causes(row, False) == without_tail
