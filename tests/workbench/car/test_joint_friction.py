"""Joint friction opposes the motion."""

import numpy as np
import pytest

from aerodima.workbench.car.ak70 import JointFriction
from aerodima.workbench.car.laws import joint_friction
from aerodima.workbench.scenario.tail_parameters import FrictionParameters

LAW = FrictionParameters(coulomb=0.161, viscous=0.057, tanh_gain=10.0)


def torque(rate):
    return joint_friction(rate, LAW.coulomb, LAW.viscous, LAW.tanh_gain)


@pytest.mark.parametrize("rate", [-40.0, -0.1, 0.0, 1e-3, 0.1, 8.0])
def test_equation_4_12_with_the_sign_of_the_errata(rate):
    assert torque(rate) == pytest.approx(-(0.161 * np.tanh(10.0 * rate) + 0.057 * rate))


def test_friction_adds_to_the_torque_of_a_motor_of_which_nan_counts_as_none():
    system = JointFriction(LAW, 2)
    context = system.CreateDefaultContext()
    system.GetInputPort("rates").FixValue(context, np.array([0.5, -1.0]))
    system.GetInputPort("motor_torques").FixValue(context, np.array([1.5, np.nan]))
    assert system.get_output_port().Eval(context) == pytest.approx(
        [1.5 + torque(0.5), torque(-1.0)], abs=0.0
    )
