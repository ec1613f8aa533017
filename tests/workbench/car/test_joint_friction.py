"""Joint friction opposes the motion."""

import numpy as np
import pytest

from aerodima.workbench.car.tail_plant import smooth_friction
from aerodima.workbench.rig.rig_plant import JointFriction

COULOMB, VISCOUS = 0.161, 0.057
SMOOTH = smooth_friction(COULOMB, VISCOUS, 10.0)


def test_friction_opposes_the_motion_and_is_odd():
    for rate in (1e-3, 0.1, 1.0, 8.0, 40.0):
        assert SMOOTH(rate) < 0.0 < SMOOTH(-rate)
        assert SMOOTH(-rate) == -SMOOTH(rate)
    assert SMOOTH(0.0) == 0.0


def test_equation_4_12_with_the_sign_of_the_errata():
    assert SMOOTH(0.1) == pytest.approx(-(0.161 * np.tanh(1.0) + 0.0057))


def test_friction_reads_the_rate_and_not_the_angle():
    system = JointFriction(SMOOTH)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, np.array([1.0, 0.5]))
    assert system.get_output_port().Eval(context) == [SMOOTH(0.5)]
