"""Joint friction opposes the motion."""

import numpy as np
import pytest

from aerodima.workbench.car.laws import joint_friction
from aerodima.workbench.rig.rig_plant import JointFriction
from aerodima.workbench.scenario.tail_parameters import FrictionParameters

LAW = FrictionParameters(coulomb=0.161, viscous=0.057, tanh_gain=10.0)


def torque(rate):
    return joint_friction(rate, LAW.coulomb, LAW.viscous, LAW.tanh_gain)


@pytest.mark.parametrize("rate", [-40.0, -0.1, 0.0, 1e-3, 0.1, 8.0])
def test_equation_4_12_with_the_sign_of_the_errata(rate):
    assert torque(rate) == pytest.approx(-(0.161 * np.tanh(10.0 * rate) + 0.057 * rate))


def test_friction_reads_the_rate_and_not_the_angle():
    system = JointFriction(LAW)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, np.array([1.0, 0.5]))
    assert system.get_output_port().Eval(context) == [torque(0.5)]
