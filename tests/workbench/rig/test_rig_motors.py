"""The two motors of the rigs: sign, limit, and what a NaN does."""

import math

import numpy as np
import pytest

from aerodima.workbench.car.ak70 import MitMotor
from aerodima.workbench.rig.maxon_motor import MaxonMotor
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario

SCENARIO = load_rig_scenario("robot")


def outputs(system, **inputs):
    """Torque (N m) and current (A)."""
    context = system.CreateDefaultContext()
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, np.atleast_1d(np.asarray(value, dtype=float)))
    return tuple(
        float(system.GetOutputPort(name).Eval(context)[0]) for name in ("torque", "current")
    )


@pytest.mark.parametrize(
    ("command", "current"),
    [(2.0, 2.0), (-2.0, -2.0), (40.0, 30.0), (-40.0, -30.0), (math.nan, 0.0)],
)
def test_positive_current_pushes_upstream_within_the_limit(command, current):
    torque, flowing = outputs(MaxonMotor(SCENARIO.maxon), current_command=command)
    assert flowing == current
    assert torque == pytest.approx(-0.346 * current)


@pytest.mark.parametrize(
    ("command", "torque"),
    [
        ((0.0, 0.0, 4.0, 0.0, 0.0), -4.0 * 0.5),
        ((0.0, 0.0, 10.0, 0.3, 0.0), -10.0 * 0.5 - 0.3 * 2.0),
        ((0.0, 0.0, 0.0, 0.0, 1.5), 1.5),
        ((0.0, 0.0, 500.0, 0.0, 0.0), -24.8),
        ((math.nan, 0.0, 4.0, 0.0, 0.0), 0.0),
    ],
)
def test_mit_law_on_the_rig(command, torque):
    """tau = kp (0 - 0.5) + kd (0 - 2) + tau_ff within 24.8 N m; the current has the other sign,
    1.23 N m/A.
    """
    motor = MitMotor(SCENARIO.robot_motor, SCENARIO.robot.torque_constant)
    given, current = outputs(motor, joint_state=(0.5, 2.0), tail_command=command)
    assert given == pytest.approx(torque)
    assert current == pytest.approx(-torque / 1.23)
