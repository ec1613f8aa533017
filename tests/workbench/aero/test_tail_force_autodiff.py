"""Gradients of the wrench: AutoDiff against central differences, and finite values where the laws
are singular.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff

from aerodima.workbench.aero.coefficient_files import load_coefficients
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.section_laws import NormalForceLaw, facing_law
from aerodima.workbench.aero.sections import Jet, SectionLayout
from tests.workbench.aero.plants import (
    free_tail,
    plant_context,
    port_value,
    random_state,
)

LAYOUT = SectionLayout.strip(start=0.1, length=0.5, width=0.1, p_BoRo_B=(0.05, 0.1, -0.1))
LAWS = {
    "normal constant": NormalForceLaw(2.0),
    "normal line": load_coefficients("robot_tail_line").law(),
    "facing": facing_law(NormalForceLaw(2.0)),
    "polar constant": PolarLaw(1.2, 0.4),
    "polar table": load_coefficients("cheetah_tail_1_major").law(),
}


def diagrams(law, jet=None):
    diagram, plant, force, wind = free_tail(LAYOUT, law, (1.0, -2.0, 0.5), jet=jet)
    converted = diagram.ToAutoDiffXd()
    return (
        (diagram, plant, force, wind),
        tuple(converted.GetSubsystemByName(system.get_name()) for system in (plant, force, wind)),
        converted,
    )


def gradient(parts, state, wind=None):
    _, (plant, force, source), converted = parts
    context = plant_context(converted, plant, InitializeAutoDiff(state))
    if wind is not None:
        air = source.get_mutable_source_value(source.GetMyMutableContextFromRoot(context))
        air.SetFromVector([AutoDiffXd(w) for w in wind])
    value = force.GetOutputPort("wrench").Eval(force.GetMyContextFromRoot(context))
    # A constant carries no derivatives at all.
    return np.array(
        [v.derivatives() if len(v.derivatives()) else np.zeros(len(state)) for v in value[:6]]
    )


def differences(parts, state):
    (diagram, plant, force, _), _, _ = parts
    columns = []
    for i in range(len(state)):
        ends = []
        for sign in (1.0, -1.0):
            moved = state.copy()
            moved[i] += sign * 1e-6
            ends.append(port_value(force, plant_context(diagram, plant, moved), "wrench")[:6])
        columns.append((ends[0] - ends[1]) / 2e-6)
    return np.column_stack(columns)


@pytest.mark.parametrize("name", LAWS)
def test_gradients_equal_central_jacobian(name):
    """To 1e-6 of the largest entry; central differences with a step of 1e-6 err by about 1e-9 of
    it.
    """
    parts = diagrams(LAWS[name])
    rng = np.random.default_rng(7)
    for _ in range(20):
        state = random_state(parts[0][1], rng, speed=2.0)
        exact = gradient(parts, state)
        approximate = differences(parts, state)
        assert_allclose(exact, approximate, atol=1e-6 * np.abs(approximate).max())


def test_gradients_inside_a_jet_follow_the_moving_exposure():
    parts = diagrams(PolarLaw(1.2, 0.4), Jet((0.0, 0.0, 0.3)))
    state = np.array([1.0, 0.05, 0.02, 0.01, 0.0, 0.0, 0.1, 0.3, -0.2, 0.4, 1.0, 2.0, 0.5])
    exact = gradient(parts, state)
    assert_allclose(exact, differences(parts, state), atol=1e-6 * np.abs(exact).max())
    assert np.abs(exact[:3, 6]).max() > 0.0  # raising the body takes sections out of the jet


@pytest.mark.parametrize("name", LAWS)
def test_gradients_are_finite_in_still_air_and_at_ninety_degrees(name):
    """Body at rest without wind; and wind exactly along the axis (+z), where lift has no
    direction.
    """
    parts = diagrams(LAWS[name])
    rest = np.array([1.0] + [0.0] * 12)
    for wind, along in ((np.zeros(3), False), (np.array([0.0, 0.0, 6.0]), True)):
        slopes = gradient(parts, rest, wind)
        assert np.all(np.isfinite(slopes))
        if not along:
            assert_array_equal(slopes[:, 7:], 0.0)  # quadratic in the velocity


def test_other_outputs_convert_too():
    _, (plant, force, _), converted = diagrams(PolarLaw(1.2, 0.4))
    context = converted.CreateDefaultContext()
    rows = force.GetOutputPort("sections").Eval(force.GetMyContextFromRoot(context)).reshape(5, 4)
    assert rows[0, 0].value() == pytest.approx(math.sqrt(1 + 4 + 0.25))
    assert (
        len(plant.get_applied_spatial_force_input_port().Eval(plant.GetMyContextFromRoot(context)))
        == 1
    )
