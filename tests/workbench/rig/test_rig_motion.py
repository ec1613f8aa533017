"""The fast pendulum moves as the Drake plant."""

from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.rig.rig_motion import RigMotion
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.refusals import assert_refused

VARIANTS = [
    ("flick", {}),
    ("flick", {"experiment": {"tail": 3, "axis": "minor", "wind_speed": 20.0}}),
    ("flick", {"aero": {"added_mass": 0.02}}),
    ("flick", {"aero": {"added_mass": -0.01}}),
    ("flick", {"tunnel": {"misalignment": 0.05, "psi3": -0.1}}),
    ("flick", {"aero": {"source": "constant", "sections": 3}}),
    ("bar", {}),
    ("robot", {}),
    ("robot", {"aero": {"source": "constant", "sections": 1}}),
]


def scenario(name, changes):
    return load_rig_scenario(name).varied(**changes)


@pytest.mark.parametrize(("name", "changes"), VARIANTS)
def test_it_moves_as_the_plant(name, changes):
    """The same physics written twice: to 1e-9, with room for the rounding of two different orders
    of summation.
    """
    rig = Rig(scenario(name, changes))
    motion = RigMotion.of(scenario(name, changes))
    rng = np.random.default_rng(11)
    for _ in range(40):
        angle = rng.uniform(-1.7, 1.7)
        rate = rng.uniform(-12, 12)
        torque = rng.uniform(-5, 5)
        expected = rig.reaction(angle, rate, torque).acceleration
        acceleration = motion.acceleration(angle, rate, torque)
        assert acceleration == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_added_mass_that_leaves_no_inertia_is_refused():
    motion = replace(RigMotion.of(scenario("flick", {})), added_mass=-0.033)
    assert_refused(
        lambda: motion.acceleration(1.0, 0.0, 0.0), UserError, "added_mass", "-0.033", "-0.02"
    )
