"""Joint friction opposes the motion."""

import numpy as np
import pytest

from aerodima.workbench.car.ak70 import JointFriction
from aerodima.workbench.car.laws import joint_friction
from aerodima.workbench.scenario.tail_parameters import FrictionParameters

LAW = FrictionParameters(coulomb=0.161, viscous=0.057, tanh_gain=10.0)


def torque(rate):
    return joint_friction(rate, LAW.coulomb, LAW.viscous, LAW.tanh_gain)


def test_friction_opposes_the_motion_and_is_odd():
    for rate in (1e-3, 0.1, 1.0, 8.0, 40.0):
        assert torque(rate) < 0.0 < torque(-rate)
        assert torque(-rate) == -torque(rate)
    assert torque(0.0) == 0.0


def test_equation_4_12_with_the_sign_of_the_errata():
    assert torque(0.1) == pytest.approx(-(0.161 * np.tanh(1.0) + 0.0057))


def test_friction_adds_to_the_torque_of_a_motor_of_which_nan_counts_as_none():
    system = JointFriction(LAW, 2)
    context = system.CreateDefaultContext()
    system.GetInputPort("rates").FixValue(context, np.array([0.5, -1.0]))
    system.GetInputPort("motor_torques").FixValue(context, np.array([1.5, np.nan]))
    assert system.get_output_port().Eval(context) == pytest.approx(
        [1.5 + torque(0.5), torque(-1.0)], abs=0.0
    )
