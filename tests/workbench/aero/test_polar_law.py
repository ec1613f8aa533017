"""The polar law against an independent sum; the side of its lift, and the energy of still air."""

import math

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.section_laws import NormalForceLaw, facing_law
from aerodima.workbench.aero.sections import SectionLayout
from tests.workbench.aero.plants import (
    free_tail,
    plant_context,
    port_value,
    random_state,
)

LAYOUT = SectionLayout.strip(
    start=0.27,
    length=0.39,
    width=0.0639,
    p_BoRo_B=(0.1, -0.2, 0.3),
    axis_B=(0.0, 0.6, 0.8),
    normal_B=(0.0, 0.8, -0.6),
)
DRAG, LIFT = 1.3, 0.4


def five_point_sum(state, wind, layout):
    """Force and moment about the body origin, written from the text of design section 5 with
    trigonometry and NumPy.
    """
    R = RotationMatrix(Quaternion(state[:4])).matrix()
    omega = state[7:10]
    v_o = state[10:13]
    axis = R @ layout.axis_B
    total = np.zeros(6)
    for p_B, area in zip(layout.p_BoSi_B, layout.areas, strict=True):
        arm = R @ p_B
        v = wind - (v_o + np.cross(omega, arm))
        speed = np.linalg.norm(v)
        gamma = math.asin(v @ axis / speed)
        d = v / speed
        towards_root = -(axis - (axis @ d) * d)
        towards_root /= np.linalg.norm(towards_root)
        side = math.copysign(1.0, gamma)
        if abs(gamma) < math.radians(1.0):
            t = math.sin(gamma) / math.sin(math.radians(1.0))
            side = (3 * t - t**3) / 2
        end = min(1.0, math.cos(gamma) / math.sin(math.radians(10.0)))
        lift = LIFT * side * (3 * end**2 - 2 * end**3)
        f = 0.5 * 1.225 * area * speed**2 * (DRAG * d + lift * towards_root)
        total += np.concatenate([f, np.cross(arm, f)])
    return total


def test_constant_coefficients_equal_an_independent_five_point_sum():
    diagram, plant, force, wind = free_tail(LAYOUT, PolarLaw(DRAG, LIFT))
    rng = np.random.default_rng(4)
    for _ in range(200):
        state = random_state(plant, rng)
        air = rng.normal(size=3) * 5.0
        context = plant_context(diagram, plant, state)
        wind.get_mutable_source_value(wind.GetMyMutableContextFromRoot(context)).SetFromVector(air)
        expected = five_point_sum(state, air, LAYOUT)
        wrench = port_value(force, context, "wrench")[:6]
        np.testing.assert_allclose(
            wrench, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max()
        )


@pytest.mark.parametrize(
    "law",
    [PolarLaw(DRAG, LIFT), NormalForceLaw(1.7), facing_law(NormalForceLaw(1.7))],
    ids=["polar", "normal", "facing"],
)
def test_the_air_never_feeds_energy_to_a_body_in_still_air(law):
    """Power of the wrench on the moving body, over 200 random states: at most zero."""
    diagram, plant, force, _ = free_tail(LAYOUT, law)
    rng = np.random.default_rng(5)
    for _ in range(200):
        state = random_state(plant, rng)
        wrench = port_value(force, plant_context(diagram, plant, state), "wrench")
        power = wrench[:3] @ state[10:13] + wrench[3:6] @ state[7:10]
        assert power <= 1e-12 * np.linalg.norm(wrench[:3])
