"""The wrench on a body: against Drake's Wing, in free fall, and with several aerodynamic bodies on
one plant.
"""

import math
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import Wing
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from aerodima.workbench.aero.section_laws import NormalForceLaw
from aerodima.workbench.aero.sections import Air, SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.core.errors import ModelError
from tests.refusals import assert_refused
from tests.workbench.aero.plants import (
    add_free_body,
    add_free_plant,
    add_plant,
    plant_context,
    port_value,
    random_state,
)

AXIS = (0.0, 0.6, 0.8)
NORMAL = (0.0, 0.8, -0.6)
LAYOUT = SectionLayout.strip(
    start=0.1, length=0.7, width=0.15, p_BoRo_B=(0.1, -0.2, 0.3), axis_B=AXIS, normal_B=NORMAL
)


def wing_pose(layout, i):
    """Wing frame of section i: span along the axis, z along the normal."""
    y = np.asarray(layout.axis_B)
    z = np.asarray(layout.normal_B)
    return RigidTransform(
        RotationMatrix(np.column_stack([np.cross(y, z), y, z])), layout.p_BoSi_B[i]
    )


def test_constant_two_equals_one_drake_wing_per_section():
    """C_N = 2 is Drake's flat plate.

    A wing takes the velocity of its body's origin, so each gets one.
    """
    builder = DiagramBuilder()
    plant = add_plant(builder)
    body = add_free_body(plant)
    stations = []
    for i in range(LAYOUT.number):
        station = plant.AddRigidBody(f"station_{i}", SpatialInertia.SolidSphereWithMass(1e-6, 1e-3))
        plant.WeldFrames(body.body_frame(), station.body_frame(), wing_pose(LAYOUT, i))
        stations.append(station)
    plant.Finalize()
    wind = builder.AddSystem(ConstantVectorSource([0.0, 0.0, 0.0]))
    air = Air(density=1.18)
    force = add_tail_force(builder, plant, body, LAYOUT, 2.0, air=air, wind=wind.get_output_port())
    wings = []
    for station in stations:
        wing = builder.AddSystem(
            Wing(station.index(), LAYOUT.areas[0], RigidTransform(), air.density)
        )
        builder.Connect(plant.get_body_poses_output_port(), wing.get_body_poses_input_port())
        builder.Connect(
            plant.get_body_spatial_velocities_output_port(),
            wing.get_body_spatial_velocities_input_port(),
        )
        builder.Connect(wind.get_output_port(), wing.get_wind_velocity_input_port())
        wings.append(wing)
    diagram = builder.Build()
    rng = np.random.default_rng(1)
    for _ in range(100):
        context = plant_context(diagram, plant, random_state(plant, rng))
        source = wind.get_mutable_source_value(wind.GetMyMutableContextFromRoot(context))
        source.SetFromVector(rng.normal(size=3) * 6.0)
        wrench = port_value(force, context, "wrench")
        plant_ctx = plant.GetMyContextFromRoot(context)
        X_WB = plant.EvalBodyPoseInWorld(plant_ctx, body)
        expected = np.zeros(6)
        for wing, station in zip(wings, stations, strict=True):
            [applied] = wing.get_spatial_force_output_port().Eval(
                wing.GetMyContextFromRoot(context)
            )
            f = applied.F_Bq_W.translational()
            arm = (
                plant.EvalBodyPoseInWorld(plant_ctx, station).multiply(applied.p_BoBq_B)
                - X_WB.translation()
            )
            expected += np.concatenate([f, np.cross(arm, f) + applied.F_Bq_W.rotational()])
        assert np.abs(wrench[:3] - expected[:3]).max() <= 1e-12 * np.linalg.norm(expected[:3])
        assert np.abs(wrench[3:6] - expected[3:]).max() <= 1e-12 * max(
            np.linalg.norm(expected[3:]), 1.0
        )
        assert_allclose(wrench[6:], X_WB.translation(), atol=1e-15)


def test_the_force_the_plant_receives_is_the_logged_wrench():
    """The list port acts at the root of the axis, the wrench port at the body origin: shifted, they
    agree.
    """
    builder = DiagramBuilder()
    plant, body = add_free_plant(builder)
    force = add_tail_force(builder, plant, "tail", LAYOUT, 2.0)
    diagram = builder.Build()
    context = plant_context(diagram, plant, random_state(plant, np.random.default_rng(2)))
    [applied] = force.GetOutputPort("spatial_forces").Eval(force.GetMyContextFromRoot(context))
    assert applied.body_index == body.index()
    wrench = port_value(force, context, "wrench")
    R_WB = plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(context), body).rotation()
    arm = R_WB.multiply(applied.p_BoBq_B)
    assert_allclose(applied.F_Bq_W.translational(), wrench[:3], rtol=1e-13)
    moment = applied.F_Bq_W.rotational() + np.cross(arm, applied.F_Bq_W.translational())
    assert_allclose(moment, wrench[3:6], rtol=1e-12, atol=1e-12)


def test_the_sections_report_speed_angle_reynolds_number_and_force():
    """A tail that points up and drives forward and up at 45 degrees: gamma < 0, the air flows
    towards the root.
    """
    builder = DiagramBuilder()
    plant, _ = add_free_plant(builder)
    layout = SectionLayout.strip(start=0.2, length=0.6, width=0.1, normal_B=(1.0, 0.0, 0.0))
    force = add_tail_force(builder, plant, "tail", layout, NormalForceLaw(2.0))
    diagram = builder.Build()
    context = plant_context(diagram, plant, np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3.0, 0, 3.0]))
    rows = port_value(force, context, "sections").reshape(5, 4)
    assert_allclose(rows[:, 0], 3.0 * math.sqrt(2.0), rtol=1e-12)
    assert_allclose(rows[:, 1], -math.pi / 4, rtol=1e-12)
    assert_allclose(rows[:, 2], 1.225 * 3.0 * math.sqrt(2.0) * 0.1 / 1.849e-5, rtol=1e-12)
    assert_allclose(rows[:, 3], 0.5 * 1.225 * 0.012 * 2.0 * 9.0, rtol=1e-12)
    assert_array_equal(port_value(force, context, "validity"), np.ones(5))


def test_several_aerodynamic_bodies_share_a_plant():
    """Three bodies, three wrenches, hidden multiplexers: each body falls as it would alone."""
    builder = DiagramBuilder()
    plant = add_plant(builder)
    bodies = [add_free_body(plant, name) for name in ("tail", "wing", "bar")]
    plant.Finalize()
    forces = [
        add_tail_force(builder, plant, body, LAYOUT, c)
        for body, c in zip(bodies, (1.0, 2.0, 0.5), strict=True)
    ]
    diagram = builder.Build()
    context = plant_context(diagram, plant, random_state(plant, np.random.default_rng(3)))
    applied = plant.get_applied_spatial_force_input_port().Eval(plant.GetMyContextFromRoot(context))
    assert sorted(int(f.body_index) for f in applied) == sorted(int(b.index()) for b in bodies)
    for force, body in zip(forces, bodies, strict=True):
        [got] = [f for f in applied if f.body_index == body.index()]
        assert_allclose(
            got.F_Bq_W.translational(), port_value(force, context, "wrench")[:3], rtol=1e-13
        )


def test_a_foreign_body_or_plant_is_refused_by_name():
    """A body of another plant, an unknown name, a plant outside the builder, a plant before
    Finalize.
    """
    builder = DiagramBuilder()
    plant = add_plant(builder)
    other = add_plant(DiagramBuilder())
    add_free_body(plant)
    stranger = add_free_body(other, "stranger")

    def add(body, place=builder):
        add_tail_force(place, plant, body, LAYOUT, 2.0)

    assert_refused(lambda: add("tail"), ModelError, "not finalised")
    plant.Finalize()
    other.Finalize()
    assert_refused(lambda: add(stranger), ModelError, "stranger")
    assert_refused(lambda: add("tial"), ModelError, "'tial'", "tail")
    assert_refused(lambda: add("tail", DiagramBuilder()), ModelError, "'plant'", "builder")


@pytest.mark.parametrize(
    ("make", "named"),
    [
        *((partial(Air, density=value), ("density",)) for value in (-1.2, 0.0, math.nan)),
        (
            partial(SectionLayout.strip, start=0.0, length=1.0, width=0.1, number=0),
            ("sections is 0",),
        ),
        (partial(SectionLayout.strip, start=0.0, length=1.0, width=-0.1), ("width", "-0.1")),
    ],
)
def test_air_without_density_and_a_layout_without_area_are_refused(make, named):
    assert_refused(make, ModelError, *named)
