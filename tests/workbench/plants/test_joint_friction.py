"""Joint friction opposes the motion, and its two forms agree where they should."""

import numpy as np
import pytest

from aerodima.workbench.plants.joint_friction import JointFriction, sign_friction, smooth_friction

COULOMB, VISCOUS = 0.161, 0.057
SMOOTH, SIGN = smooth_friction(COULOMB, VISCOUS, 10.0), sign_friction(COULOMB, VISCOUS)


@pytest.mark.parametrize("law", [SMOOTH, SIGN])
def test_friction_opposes_the_motion_and_is_odd(law):
    for rate in (1e-3, 0.1, 1.0, 8.0, 40.0):
        assert law(rate) < 0.0 < law(-rate)
        assert law(-rate) == -law(rate)
    assert law(0.0) == 0.0


def test_equation_6_1():
    assert SIGN(8.0) == pytest.approx(-(0.161 + 0.057 * 8.0))
    assert SIGN(-1e-12) == pytest.approx(0.161)


def test_equation_4_12_with_the_sign_of_the_errata():
    assert SMOOTH(0.1) == pytest.approx(-(0.161 * np.tanh(1.0) + 0.0057))


def test_both_forms_agree_once_the_joint_moves():
    # tanh(10 * 1 rad/s) is 4e-9 below one.
    for rate in (1.0, -1.0, 8.0):
        assert SMOOTH(rate) == pytest.approx(SIGN(rate), rel=1e-8)
    assert abs(SMOOTH(0.01)) < 0.2 * abs(SIGN(0.01))


def test_friction_reads_the_rates_and_not_the_angles():
    system = JointFriction(SIGN, 2)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, np.array([1.0, -2.0, 0.5, -3.0]))
    np.testing.assert_allclose(system.get_output_port().Eval(context), [-(0.161 + 0.0285), 0.161 + 0.171])
