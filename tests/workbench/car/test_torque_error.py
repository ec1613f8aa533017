"""A torque constant that is wrong scales what a command gives, and not what the motor can."""

import pytest

from aerodima.workbench.car.ak70 import mit_torque
from aerodima.workbench.scenario.scenario import scenario_from_dict

MOTOR = scenario_from_dict({}).tail_motor
UNLIMITED = (1e9, 1e9)
"""A torque-speed line so high that it never acts."""


@pytest.mark.parametrize("error", [0.1, -0.2])
def test_gains_and_feedforward_are_wrong_alike_and_the_peak_stays(error):
    wrong = MOTOR.model_copy(update={"torque_error": error})
    for command in ((0.3, 0.0, 20.0, 0.0, 0.0), (0.0, -0.6, 0.0, 2.0, 0.0), (0.0,) * 4 + (0.5,)):
        torque = mit_torque(0.1, 0.4, command, MOTOR, UNLIMITED)
        found = mit_torque(0.1, 0.4, command, wrong, UNLIMITED)
        assert found == pytest.approx((1.0 + error) * torque)
    strong = (0.0,) * 4 + (100.0,)
    assert mit_torque(0.0, 0.0, strong, wrong, UNLIMITED) == MOTOR.torque_limit
