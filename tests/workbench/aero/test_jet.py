"""The exposed part of a tail in the tunnel, and the published holding currents that it predicts."""

import math

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from aerodima.workbench.aero.coefficient_files import load_coefficients
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import Jet, SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.core.errors import ModelError
from tests.refusals import assert_refused
from tests.workbench.aero.plants import add_plant, plant_context, port_value

EDGE_DEPTH = 0.265  # h0, design section 5
TAIL = SectionLayout.strip(
    start=0.270, length=0.390, width=0.0639, axis_B=(0.0, 0.0, -1.0), normal_B=(0.0, 1.0, 0.0)
)
"""Tail 1 of Table 4.2 on the rig."""


def pendulum(builder, limits=None):
    """A tail that hangs from the pivot on a joint about -x: positive angles swing it towards -y,
    downstream.
    """
    plant = add_plant(builder)
    body = plant.AddRigidBody("tail", SpatialInertia.SolidSphereWithMass(0.1, 0.05))
    frames = plant.world_frame(), body.body_frame()
    joint = plant.AddJoint(RevoluteJoint("swing", *frames, [-1.0, 0.0, 0.0]))
    if limits:
        joint.set_position_limits([limits[0]], [limits[1]])
    plant.Finalize()
    return plant


@pytest.mark.parametrize("angle_deg", [0.0, 15.0, 30.0, 45.0, 60.0])
def test_exposure_starts_where_the_edge_crosses_the_axis(angle_deg):
    """s = h0 / (cos + sin/18), design section 5, wherever the pivot stands."""
    angle = math.radians(angle_deg)
    jet = Jet.below_pivot((0.1, 0.2, 0.5), EDGE_DEPTH)
    a = (0.0, -math.sin(angle), -math.cos(angle))
    start = EDGE_DEPTH / (math.cos(angle) + math.sin(angle) / 18.0)
    interval = jet.exposed_interval(TAIL, (0.1, 0.2, 0.5), a)
    assert interval is not None
    assert interval == pytest.approx((max(start, 0.270), 0.660), rel=1e-12)
    distances, areas = jet.exposed_sections(TAIL, (0.1, 0.2, 0.5), a)
    assert sum(areas) == pytest.approx((0.660 - max(start, 0.270)) * 0.0639)
    assert np.diff(distances) == pytest.approx(areas[0] / 0.0639)


def test_without_exposure_the_force_is_zero_and_flagged():
    """Above about 68 degrees nothing hangs in the jet: cos + sin/18 = 0.265/0.660 at 69.4
    degrees.
    """
    builder = DiagramBuilder()
    plant = pendulum(builder)
    wind = builder.AddSystem(ConstantVectorSource([0.0, -10.0, 0.0]))
    jet = Jet.below_pivot((0, 0, 0), EDGE_DEPTH)
    force = add_tail_force(
        builder, plant, "tail", TAIL, PolarLaw(1.0, 0.2), wind=wind.get_output_port(), jet=jet
    )
    diagram = builder.Build()
    for angle_deg, exposed in (
        (60.0, True),
        (69.0, True),
        (70.0, False),
        (90.0, False),
        (-90.0, False),
    ):
        context = plant_context(diagram, plant, np.array([math.radians(angle_deg), 0.0]))
        wrench = port_value(force, context, "wrench")
        assert (np.linalg.norm(wrench[:6]) > 0.0) == exposed, angle_deg
        assert_array_equal(
            port_value(force, context, "validity"), np.full(5, 1.0 if exposed else 0.0)
        )


@pytest.mark.parametrize(("limits", "depth"), [((-1.5, 1.5), 0.70), ((1.3, 1.6), EDGE_DEPTH)])
def test_a_jet_that_no_reachable_angle_meets_is_refused(limits, depth):
    builder = DiagramBuilder()
    plant = pendulum(builder, limits=limits)
    jet = Jet.below_pivot((0, 0, 0), depth)
    assert_refused(
        lambda: add_tail_force(builder, plant, "tail", TAIL, 2.0, jet=jet), ModelError, "'tail'"
    )


def test_a_jet_that_some_reachable_angle_meets_is_taken():
    builder = DiagramBuilder()
    plant = pendulum(builder, limits=(0.5, 1.6))
    add_tail_force(builder, plant, "tail", TAIL, 2.0, jet=Jet.below_pivot((0, 0, 0), EDGE_DEPTH))


def test_above_the_quasi_steady_limit_a_section_is_marked():
    """The cheetah tables go to 30 m/s, the quasi-steady model was shown up to 10 m/s only (design
    section 5).
    """
    coefficients = load_coefficients("cheetah_tail_1_major")
    for speed, mark in ((9.0, 2.0), (10.0, 1.0), (15.0, 3.0), (31.0, 2.0)):
        builder = DiagramBuilder()
        plant = pendulum(builder)
        wind = builder.AddSystem(ConstantVectorSource([0.0, -speed, 0.0]))
        force = add_tail_force(
            builder,
            plant,
            "tail",
            TAIL,
            coefficients.law(),
            wind=wind.get_output_port(),
            quasi_steady_limit=coefficients.quasi_steady_limit,
        )
        context = plant_context(builder.Build(), plant, np.zeros(2))
        assert_array_equal(port_value(force, context, "validity"), np.full(5, mark))
