"""Laws of motors, servo, joints and wheels: floats and arrays agree."""

import numpy as np
import pytest

from aerodima.workbench.car import laws

ROWS = np.linspace(-2.0, 2.0, 9)


@pytest.mark.parametrize(
    ("law", "others"),
    [
        (laws.pd_torque, (0.1, 1.0, 0.3, 20.0, 0.5, 0.2)),
        (laws.joint_friction, (0.1, 0.02, 10.0)),
        (laws.governor_torque, (0.5, 3.0, 0.1, 0.4)),
        (laws.rolling_resistance, (0.05,)),
        (lambda *x: laws.torque_bounds(*x)[0], (5.0, 10.0, 1.5)),
        (lambda *x: laws.torque_bounds(*x)[1], (5.0, 10.0, 1.5)),
    ],
)
def test_a_float_gives_what_an_array_gives(law, others):
    alone = [law(float(row), *others) for row in ROWS]
    assert law(ROWS, *others) == pytest.approx(alone, rel=1e-15, abs=0.0)
