"""The fast pendulum moves and reacts as the Drake plant."""

from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench.config.rig_scenario import load_rig_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.plants.rig import Rig
from aerodima.workbench.plants.rig_model import mount_properties
from aerodima.workbench.plants.rig_motion import RigMotion
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


def wrench_on(motion, mount, angle, rate, acceleration):
    """Of the support on the rig at W (6), N and N m, from the momenta of what swings and the weight
    of what stands.
    """
    px, py, pz = motion.pivot
    x, y, z, mx, my, mz = -np.array(motion.air(angle, rate))
    mx = mx + py * z - pz * y
    my = my + pz * x - px * z
    mz = mz + px * y - py * x
    parts = [(body.mass, body.radius, body.phase, 1.0) for body in motion.bodies]
    parts += [(motion.added_mass, s, 0.0, 0.0) for s in motion.added_distances]
    for mass, radius, phase, whole in parts:  # added mass has neither weight nor spanwise inertia
        s = radius * np.sin(angle + phase)
        c = radius * np.cos(angle + phase)
        force_y = mass * (whole * s * rate**2 - c * acceleration)
        force_z = mass * (whole * (c * rate**2 + motion.gravity) + s * acceleration)
        y = y + force_y
        z = z + force_z
        mx = mx + (py - s) * force_z - (pz - c) * force_y
        my = my - px * force_z
        mz = mz + px * force_y
    mx = mx - acceleration * sum(body.inertia for body in motion.bodies)
    weight = mount.mass * motion.gravity
    (mount_x, mount_y, _) = mount.com
    return np.array((x, y, z + weight, mx + mount_y * weight, my - mount_x * weight, mz))


@pytest.mark.parametrize(("name", "changes"), VARIANTS)
def test_it_moves_and_reacts_as_the_plant(name, changes):
    """The same physics written twice: to 1e-9, with room for the rounding of two different orders
    of summation.
    """
    rig = Rig(scenario(name, changes))
    motion = RigMotion.of(scenario(name, changes))
    mount = mount_properties(scenario(name, changes).mount)
    rng = np.random.default_rng(11)
    for _ in range(40):
        angle = rng.uniform(-1.7, 1.7)
        rate = rng.uniform(-12, 12)
        torque = rng.uniform(-5, 5)
        reaction = rig.reaction(angle, rate, torque)
        acceleration = motion.acceleration(angle, rate, torque)
        assert acceleration == pytest.approx(reaction.acceleration, rel=1e-9, abs=1e-9)
        wrench = wrench_on(motion, mount, angle, rate, acceleration)
        np.testing.assert_allclose(wrench, reaction.wrench, rtol=1e-9, atol=1e-9)


def test_added_mass_that_leaves_no_inertia_is_refused():
    motion = replace(RigMotion.of(scenario("flick", {})), added_mass=-0.033)
    assert_refused(
        lambda: motion.acceleration(1.0, 0.0, 0.0), UserError, "added_mass", "-0.033", "-0.02"
    )
