"""The polar law against an independent sum, the continuous rod, the published currents, and
energy.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from aerodima.workbench.aero.laws import NormalForceLaw
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from tests.workbench.aero.plants import (
    add_free_body,
    add_plant,
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


def five_point_sum(state: np.ndarray, wind: np.ndarray, layout: SectionLayout) -> np.ndarray:
    """Force and moment about the body origin, written from the text of design section 5 with
    trigonometry and NumPy.
    """
    w, x, y, z = state[:4]
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
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


def free_tail(law, layout=LAYOUT):
    builder = DiagramBuilder()
    plant = add_plant(builder)
    add_free_body(plant)
    plant.Finalize()
    wind = builder.AddSystem(ConstantVectorSource([0.0, 0.0, 0.0]))
    force = add_tail_force(builder, plant, "tail", layout, law, wind=wind.get_output_port())
    return builder.Build(), plant, force, wind


def test_constant_coefficients_equal_an_independent_five_point_sum() -> None:
    diagram, plant, force, wind = free_tail(PolarLaw(DRAG, LIFT))
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


def test_more_sections_approach_the_continuous_rod_as_one_over_n_squared() -> None:
    """A rod that turns about its root: the root moment is 1/8 rho c C_D w^2 L^4, the midpoint rule
    errs as 1/n^2.
    """
    length = 0.4
    width = 0.06
    omega = 9.0
    exact = 0.5 * 1.225 * width * DRAG * omega**2 * length**4 / 4
    errors = []
    for number in (5, 10, 20, 40):
        layout = SectionLayout.strip(start=0.0, length=length, width=width, number=number)
        diagram, plant, force, _ = free_tail(PolarLaw(DRAG), layout)
        state = np.array([1.0, 0, 0, 0, 0, 0, 0, omega, 0, 0, 0, 0, 0])
        errors.append(
            abs(port_value(force, plant_context(diagram, plant, state), "wrench")[3] + exact)
        )
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    # The leading term gives exactly 4; the next one is O(1/n^2) smaller.
    np.testing.assert_allclose(ratios, 4.0, rtol=0.02)


def test_lift_points_to_the_root_side_of_a_tail_that_hangs_downstream() -> None:
    """Tail hanging, swung 30 degrees towards -y, wind towards -y: gamma = +30 degrees and positive
    lift is up.
    """
    angle = math.radians(30.0)
    a = (0.0, -math.sin(angle), -math.cos(angle))
    force = PolarLaw(0.0, 1.0).section_force((0.0, -10.0, 0.0), a, (1.0, 0, 0), 0.02, 1.225)
    np.testing.assert_allclose(force, [0.0, 0.0, 0.5 * 1.225 * 0.02 * 100.0], atol=1e-12)
    upstream = PolarLaw(0.0, 1.0).section_force((0.0, 10.0, 0.0), a, (1.0, 0, 0), 0.02, 1.225)
    assert upstream[2] == pytest.approx(-force[2])


@pytest.mark.parametrize(
    "law", [PolarLaw(DRAG, LIFT), NormalForceLaw(1.7)], ids=["polar", "normal"]
)
def test_the_air_never_feeds_energy_to_a_body_in_still_air(law) -> None:
    """Power of the wrench on the moving body, over 200 random states: at most zero."""
    diagram, plant, force, _ = free_tail(law)
    rng = np.random.default_rng(5)
    for _ in range(200):
        state = random_state(plant, rng)
        wrench = port_value(force, plant_context(diagram, plant, state), "wrench")
        power = wrench[:3] @ state[10:13] + wrench[3:6] @ state[7:10]
        assert power <= 1e-12 * np.linalg.norm(wrench[:3])


def test_lift_does_no_work_on_the_relative_motion() -> None:
    rng = np.random.default_rng(6)
    for _ in range(200):
        v = rng.normal(size=3) * 10.0
        a = rng.normal(size=3)
        a /= np.linalg.norm(a)
        f = np.array(PolarLaw(0.0, 0.8).section_force(tuple(v), tuple(a), (1.0, 0, 0), 0.02, 1.225))
        assert abs(f @ v) <= 1e-12 * np.linalg.norm(v) * max(np.linalg.norm(f), 1e-3)


def test_drag_is_even_and_lift_odd_in_the_angle_of_attack() -> None:
    a = (0.0, 0.0, 1.0)
    up = PolarLaw(1.0, 0.5).section_force((6.0, 0.0, 3.0), a, (1.0, 0, 0), 0.02, 1.2)
    down = PolarLaw(1.0, 0.5).section_force((6.0, 0.0, -3.0), a, (1.0, 0, 0), 0.02, 1.2)
    assert up[0] == pytest.approx(down[0])
    assert up[2] == pytest.approx(-down[2])
