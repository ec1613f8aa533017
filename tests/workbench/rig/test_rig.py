"""The rig's motion and reactions against Lagrange's equations, and its signs."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from aerodima.workbench.core.errors import ModelError, UserError
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.refusals import assert_refused
from tests.workbench.rig.rig_lagrangian import (
    BAR_INERTIA,
    BAR_MASS,
    GRAVITY,
    MOUNT_COM,
    MOUNT_MASS,
    PIVOT,
    ROTOR,
    TAILS,
    derived,
)

STATIC = load_rig_scenario("static")


def without_air(tail=1, friction=False, **sections):
    settings = {"friction": {} if friction else {"coulomb": 0.0, "viscous": 0.0}, **sections}
    return STATIC.varied(
        experiment={"tail": tail, "wind_speed": 0.0},
        aero={"source": "constant", "drag": 0.0, "lift": 0.0},
        bar={"drag_coefficient": 0.0},
        **settings,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("tail", "misalignment"), [(1, 0.0), (2, 0.0), (3, 0.0), (1, 0.07)])
def test_bare_rig_moves_and_reacts_as_lagrange_derives_it(tail, misalignment):
    """Acceleration and all six reactions over 100 random states.

    Both sides carry twelve or more digits, so 1e-9 is far above rounding and far below any
    modelling difference.
    """
    rig = Rig(without_air(tail, tunnel={"misalignment": misalignment}))
    rng = np.random.default_rng(7)
    for _ in range(100):
        angle = rng.uniform(-1.7, 1.7)
        rate = rng.uniform(-15, 15)
        torque = rng.uniform(-6, 6)
        acceleration, wrench = derived(tail, angle, rate, torque, misalignment)
        reaction = rig.reaction(angle, rate, torque)
        assert reaction.acceleration == pytest.approx(acceleration, rel=1e-9, abs=1e-9)
        assert_allclose(reaction.wrench, wrench, rtol=1e-9, atol=1e-9)


def test_hanging_rig_weighs_what_it_weighs():
    mass = MOUNT_MASS + BAR_MASS + TAILS[1][0]
    reaction = Rig(without_air()).reaction(0.0, 0.0, 0.0)
    assert reaction.acceleration == pytest.approx(0.0, abs=1e-12)
    moments = MOUNT_MASS * MOUNT_COM + (BAR_MASS + TAILS[1][0]) * PIVOT
    expected = [0.0, 0.0, mass * GRAVITY, moments[1] * GRAVITY, -moments[0] * GRAVITY, 0.0]
    assert_allclose(reaction.wrench, expected, atol=1e-9)
    assert reaction.wrench[2] == pytest.approx(15.698, abs=1e-3)  # Table 4.4 has 15.695
    assert reaction.wrench[4] == pytest.approx(-0.320, abs=5e-4)  # design section 4


def test_wind_pushes_downstream_and_a_positive_current_holds_against_it():
    rig = Rig(STATIC)
    assert rig.reaction(0.0, 0.0, 0.0).acceleration > 0.0
    assert rig.reaction(0.0, 0.0, rig.torque_of(20.0)).acceleration < 0.0
    current = rig.holding_current(0.0)
    assert current > 0.0
    held = rig.reaction(0.0, 0.0, rig.torque_of(current))
    assert held.acceleration == pytest.approx(0.0, abs=1e-9)
    assert held.wrench[1] > 0.0  # the support holds the rig against a wind that blows towards -y


def test_gravity_pulls_a_tail_that_hangs_downstream_back_upstream():
    rig = Rig(without_air())
    assert rig.reaction(0.5, 0.0, 0.0).acceleration < 0.0
    assert rig.holding_current(0.5) < 0.0
    # The support carries the weight at its place: T_x = y F_z, and y of what swung downstream is
    # negative.
    assert rig.reaction(0.5, 0.0, rig.torque_of(rig.holding_current(0.5))).wrench[3] < 0.0


def test_misalignment_turns_the_wind_about_z():
    """Broadside drag D on the turned wind: the support answers with -D sin psi along x and +D cos
    psi along y.
    """
    psi = 0.12
    scenario = STATIC.varied(
        tunnel={"psi3": psi},
        aero={"source": "constant", "drag": 1.2, "lift": 0.0},
        bar={"drag_coefficient": 1.2},
    )
    rig = Rig(scenario)
    wrench = rig.reaction(0.0, 0.0, rig.torque_of(rig.holding_current(0.0))).wrench
    area = 0.39 * 0.0639 + 0.02 * 0.005
    drag = 0.5 * 1.225 * 1.2 * area * 100.0
    assert_allclose(wrench[:2], [-drag * math.sin(psi), drag * math.cos(psi)], rtol=1e-9)


def test_friction_brakes_by_the_published_law():
    """Table 4.7 and eq. 4.12 with ERRATA E14."""
    smooth = Rig(without_air())
    rubbing = Rig(without_air(friction=True))
    for rate in (-8.0, -0.05, 0.05, 8.0):
        lost = (
            rubbing.reaction(0.3, rate, 0.0).acceleration
            - smooth.reaction(0.3, rate, 0.0).acceleration
        )
        inertia = ROTOR + BAR_INERTIA + BAR_MASS * 0.01 + 0.0982 * 0.39**2 / 12 + 0.0982 * 0.433**2
        assert inertia * lost == pytest.approx(
            -(0.0435 * math.tanh(10 * rate) + 0.0364 * rate), rel=1e-9
        )


def test_angle_and_current_beyond_their_limits_are_refused():
    rig = Rig(STATIC)
    strong = Rig(STATIC.varied(experiment={"wind_speed": 40.0}))
    for work, named in (
        (lambda: rig.reaction(1.8, 0.0, 0.0), ("angle", "1.8", "mount.angle_limit")),
        (lambda: rig.reaction(0.0, 0.0, rig.torque_of(31.0)), ("current", "31", "30")),
        (lambda: strong.holding_current(0.0), ("current", "33")),
        (lambda: rig.reaction(0.0, math.nan, 0.0), ("nan",)),
    ):
        assert_refused(work, UserError, *named)


def test_zero_exposure_is_normal_and_no_exposure_at_all_an_error():
    rig = Rig(STATIC)
    assert rig.is_exposed(math.radians(60.0))
    assert not rig.is_exposed(math.radians(75.0))
    calm = Rig(without_air(friction=True))
    high = math.radians(80.0)
    assert_allclose(
        rig.reaction(high, 1.0, 0.2).wrench, calm.reaction(high, 1.0, 0.2).wrench, atol=1e-12
    )
    deep = STATIC.varied(tunnel={"jet_edge_depth": 0.9})
    assert_refused(lambda: Rig(deep), ModelError, "'bar'")


def test_added_mass_that_takes_all_inertia_away_is_refused_by_name():
    """The published -0.033 kg of tail 1; its rig stays positive definite down to J / sum(s^2)."""
    published = STATIC.varied(aero={"added_mass": -0.033})
    assert_refused(lambda: Rig(published), ModelError, "-0.033", "'tail'")
    assert (
        Rig(STATIC.varied(aero={"added_mass": -0.0167})).reaction(0.2, 1.0, 0.0).acceleration != 0.0
    )
