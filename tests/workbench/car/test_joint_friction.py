"""Joint friction opposes the motion."""

import numpy as np
import pytest

from aerodima.workbench.car.laws import joint_friction
from aerodima.workbench.rig.rig_plant import JointFriction
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


def test_friction_reads_the_rate_and_not_the_angle():
    system = JointFriction(LAW)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, np.array([1.0, 0.5]))
    assert system.get_output_port().Eval(context) == [torque(0.5)]
