"""Added mass: periods, mass matrices, contact, impulses, negative values."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    JacobianWrtVariable,
    RevoluteJoint,
    SpatialInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.aero.added_mass import add_added_mass, added_mass_matrix
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import Jet, SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.aero.wind import WindModel, WindSource
from aerodima.workbench.core.errors import ModelError
from tests.refusals import assert_refused
from tests.workbench.aero.plants import accelerations, add_plant

LENGTH, MASS, GRAVITY = 0.4, 0.1, 9.81
LAYOUT = SectionLayout.strip(start=0.0, length=LENGTH, width=0.06)
HOLD_RATE = 40.0
"""Of the hold of a slide, rad/s."""


def rod():
    """Thin rod from the body origin along +z."""
    return SpatialInertia.ThinRodWithMassAboutEnd(MASS, LENGTH, [0.0, 0.0, 1.0])


def add_pendulum(plant):
    """A rod that hangs from the origin; angle 0 hangs."""
    body = plant.AddRigidBody("tail", rod())
    down = RigidTransform(RotationMatrix.MakeXRotation(math.pi), np.zeros(3))
    hang = plant.AddFrame(FixedOffsetFrame("hang", plant.world_frame(), down))
    return body, plant.AddJoint(RevoluteJoint("swing", hang, body.body_frame(), [1.0, 0.0, 0.0]))


def analytic_frequency(added):
    """Small-angle frequency of the rod with the extra inertia sum m s_i^2, rad/s."""
    inertia = MASS * LENGTH**2 / 3 + added * sum(s * s for s in LAYOUT.distances)
    return math.sqrt(MASS * GRAVITY * LENGTH / 2 / inertia)


def zero_crossing_period(plant, diagram, amplitude, duration, joint):
    """Mean period from the interpolated upward zero crossings."""
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    joint.set_angle(context, amplitude)
    simulator.get_mutable_integrator().set_target_accuracy(1e-11)
    crossings = []
    before = amplitude
    for time in np.arange(1e-3, duration, 1e-3):
        simulator.AdvanceTo(time)
        angle = joint.get_angle(context)
        if before < 0.0 <= angle:
            # The acceleration is zero at the crossing: extrapolating back with the rate errs by
            # third order only.
            crossings.append(time - angle / joint.get_angular_rate(context))
        before = angle
    return float(np.mean(np.diff(crossings)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "spanwise_free"), [(0.1, True), (10.0, True), (10.0, False), (-0.05, True)]
)
def test_a_pendulum_has_the_analytic_period(ratio, spanwise_free):
    """To 1e-6 in a continuous plant.

    An amplitude of 1e-3 rad lengthens the period by theta^2/16 = 6e-8 only.
    """
    added = ratio * MASS / LAYOUT.number
    builder = DiagramBuilder()
    plant = add_plant(builder)
    body, joint = add_pendulum(plant)
    mass = add_added_mass(plant, body, LAYOUT, added, spanwise_free=spanwise_free)
    plant.Finalize()
    mass.add_to_builder(builder)
    expected = 2 * math.pi / analytic_frequency(added)
    period = zero_crossing_period(plant, builder.Build(), 1e-3, 3.0 * expected, joint)
    assert period == pytest.approx(expected, rel=1e-6)


def two_joint_tail(plant, added, **options):
    """A tail on pitch and roll joints that do not meet, on a body that floats: nothing in it
    favours the added mass.
    """
    base = plant.AddRigidBody("base", SpatialInertia.SolidBoxWithMass(3.0, 0.4, 0.2, 0.1))
    link = plant.AddRigidBody("link", SpatialInertia.SolidSphereWithMass(0.2, 0.03))
    tail = plant.AddRigidBody("tail", rod())
    deck = plant.AddFrame(
        FixedOffsetFrame("deck", base.body_frame(), RigidTransform([-0.2, 0.0, 0.1]))
    )
    top = plant.AddFrame(
        FixedOffsetFrame("top", link.body_frame(), RigidTransform([0.0, 0.03, 0.05]))
    )
    plant.AddJoint(RevoluteJoint("pitch", deck, link.body_frame(), [0.0, 1.0, 0.0]))
    plant.AddJoint(RevoluteJoint("roll", top, tail.body_frame(), [1.0, 0.0, 0.0]))
    return tail, add_added_mass(plant, tail, LAYOUT, added, **options)


def random_tail_state(plant, rng):
    """Random pose, joint angles and velocities, with the slides at their rest place."""
    context = plant.CreateDefaultContext()
    q = plant.GetPositions(context).copy()
    q[:4] = rng.normal(size=4)
    q[:4] /= np.linalg.norm(q[:4])
    v = np.zeros(plant.num_velocities())
    v[:6] = rng.normal(size=6)
    for name in ("pitch", "roll"):
        joint = plant.GetJointByName(name)
        q[joint.position_start()] = rng.uniform(-1.5, 1.5)
        v[joint.velocity_start()] = rng.normal()
    return np.concatenate([q, v])


@pytest.mark.parametrize("added", [0.02, 0.2, -0.003])
def test_a_two_joint_tail_accelerates_by_the_mass_matrix_of_the_jacobians(added):
    """(M + M_added) vdot = tau(q, v) - sum J_i^T m (1 - a a^T) Jdot_i v, on a plant without added
    mass.
    """
    builder = DiagramBuilder()
    plant = add_plant(builder)
    _, mass = two_joint_tail(plant, added)
    plant.Finalize()
    mass.add_to_builder(builder)
    diagram = builder.Build()
    bare = MultibodyPlant(0.0)
    tail, _ = two_joint_tail(bare, 0.0)
    bare.Finalize()
    rng = np.random.default_rng(8)
    slides = [joint.velocity_start() for joint, _ in mass.slides]
    own = np.setdiff1d(np.arange(plant.num_velocities()), slides)
    for _ in range(50):
        state = random_tail_state(plant, rng)
        vdot = accelerations(diagram, plant, state)
        bare_context = bare.CreateDefaultContext()
        bare.SetPositions(bare_context, state[: bare.num_positions()])
        bare.SetVelocities(bare_context, state[plant.num_positions() :][: bare.num_velocities()])
        tau = bare.CalcGravityGeneralizedForces(bare_context) - bare.CalcBiasTerm(bare_context)
        tau -= transport_of_parts(bare, bare_context, tail, added)
        total = bare.CalcMassMatrix(bare_context) + added_mass_matrix(
            bare, bare_context, tail, LAYOUT, added
        )
        expected = np.linalg.solve(total, tau)
        assert_allclose(vdot[own], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def transport_of_parts(plant, context, body, added):
    """sum J_i^T m (1 - a a^T) Jdot_i v."""

    world = plant.world_frame()
    total = np.zeros(plant.num_velocities())
    a = plant.EvalBodyPoseInWorld(context, body).rotation().multiply(np.array(LAYOUT.axis_B))
    for p in LAYOUT.p_BoSi_B:
        arguments = (context, JacobianWrtVariable.kV, body.body_frame(), p, world, world)
        J = plant.CalcJacobianTranslationalVelocity(*arguments)
        bias = plant.CalcBiasTranslationalAcceleration(*arguments)[:, 0]
        total += added * J.T @ (bias - a * (a @ bias))
    return total


def test_the_slides_stay_beside_the_tail_in_a_fast_swing():
    """A tail on a floating base that turns at 8 rad/s: the added mass leaves its place by less than
    1 mm.
    """
    builder = DiagramBuilder()
    plant = add_plant(builder, time_step=2e-3)
    _, mass = two_joint_tail(plant, 0.05)
    plant.Finalize()
    mass.add_to_builder(builder)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.GetJointByName("roll").set_angular_rate(context, 8.0)
    [(slide, _)] = mass.slides
    furthest = 0.0
    for i in range(1, 500):
        simulator.AdvanceTo(i * 2e-3)
        furthest = max(furthest, abs(slide.get_translation(context)))
    assert furthest < 1e-3


def test_bad_calls_are_refused():
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("tail", rod())

    def add(mass_per_part):
        return add_added_mass(plant, body, LAYOUT, mass_per_part)

    assert_refused(lambda: add(math.nan), ModelError, "'tail'", "nan")
    mass = add(0.01)
    assert_refused(lambda: mass.add_to_builder(DiagramBuilder()), ModelError, "not finalised")
    plant.Finalize()
    assert_refused(lambda: add(0.01), ModelError, "already finalised")


@pytest.mark.parametrize(("spanwise_free", "inertia"), [(True, 0.0), (False, 5 * 0.2)])
def test_added_mass_has_no_inertia_along_the_tail_unless_it_is_welded(spanwise_free, inertia):
    plant = MultibodyPlant(0.0)
    tail = plant.AddRigidBody("tail", rod())
    mass = add_added_mass(plant, tail, LAYOUT, 0.2, spanwise_free=spanwise_free)
    plant.Finalize()
    matrix = plant.CalcMassMatrix(plant.CreateDefaultContext())
    spanwise = matrix[5, 5] - MASS
    for joint, freed in mass.slides:
        spanwise -= matrix[5, joint.velocity_start()] ** 2 / freed
    assert spanwise == pytest.approx(inertia, abs=1e-12)


@pytest.mark.parametrize("start", [(1e-3, 0.0), (0.0, 0.05)], ids=["displaced", "moving"])
def test_a_slide_that_leaves_its_place_returns_as_a_critically_damped_spring(start):
    """On a tail at rest: x = (x0 + (v0 + w x0) t) exp(-w t)."""
    builder = DiagramBuilder()
    plant = add_plant(builder, gravity=False)
    tail = plant.AddRigidBody("tail", rod())
    plant.WeldFrames(plant.world_frame(), tail.body_frame())
    mass = add_added_mass(plant, tail, LAYOUT, 0.02)
    plant.Finalize()
    mass.add_to_builder(builder, rate=HOLD_RATE)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    [(slide, _)] = mass.slides
    place, speed = start
    slide.set_translation(context, place)
    slide.set_translation_rate(context, speed)
    time = 1.5 / HOLD_RATE
    simulator.AdvanceTo(time)
    expected = (place + (speed + HOLD_RATE * place) * time) * math.exp(-HOLD_RATE * time)
    assert slide.get_translation(context) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("spanwise_free", [True, False])
def test_only_the_acceleration_relative_to_the_air_counts(spanwise_free):
    """A free rod in air that starts to move: across the rod it is carried along by M / (m + M),
    along it not at all.
    """
    added = 0.03
    gust = np.array([0.4, 0.0, 0.7])
    builder = DiagramBuilder()
    plant = add_plant(builder, gravity=False)
    thick = SpatialInertia.SolidCylinderWithMassAboutEnd(MASS, 0.01, LENGTH, [0.0, 0.0, 1.0])
    tail = plant.AddRigidBody("tail", thick)
    mass = add_added_mass(plant, tail, LAYOUT, added, spanwise_free=spanwise_free)
    plant.Finalize()
    wind = builder.AddSystem(WindSource(WindModel(gust=tuple(gust), gust_frequency=1.0)))
    mass.add_to_builder(builder, wind_acceleration=wind.GetOutputPort("wind_acceleration"))
    state = plant.GetPositionsAndVelocities(plant.CreateDefaultContext())
    vdot = accelerations(builder.Build(), plant, state)
    # The rod's centre of mass is the middle of the parts, so it does not turn.
    assert_allclose(vdot[:3], 0.0, atol=1e-9)
    carried = 5 * added / (5 * added + MASS) * 2 * math.pi * gust[0]
    assert_allclose(vdot[3:6], [carried, 0.0, 0.0], rtol=1e-9, atol=1e-9)


def test_gradients_pass_through_added_mass_jet_and_gusts():
    """The whole diagram converts: accelerations by the state, against central differences."""
    builder = DiagramBuilder()
    plant = add_plant(builder)
    tail, mass = two_joint_tail(plant, 0.02)
    plant.Finalize()
    model = WindModel(mean=(1.0, -4.0, 0.5), gust=(0.0, 1.0, 0.0), turbulence=(0.3, 0.3, 0.0))
    wind = builder.AddNamedSystem("wind", WindSource(model))
    mass.add_to_builder(builder, wind_acceleration=wind.GetOutputPort("wind_acceleration"))
    jet = Jet((0.0, 0.0, 0.2))
    add_tail_force(
        builder,
        plant,
        tail,
        LAYOUT,
        PolarLaw(1.2, 0.3),
        wind=wind.GetOutputPort("wind_velocity"),
        jet=jet,
    )
    diagram = builder.Build()
    state = random_tail_state(plant, np.random.default_rng(10))
    converted = diagram.ToAutoDiffXd()
    twin = converted.GetSubsystemByName("plant")
    values = accelerations(converted, twin, InitializeAutoDiff(state))
    exact = np.array([value.derivatives() for value in values])
    ends = [
        [accelerations(diagram, plant, state + h) for h in sign * np.eye(len(state))]
        for sign in (-1e-6, 1e-6)
    ]
    numeric = np.transpose(np.diff(ends, axis=0)[0]) / 2e-6
    assert_allclose(exact, numeric, atol=1e-6 * np.abs(numeric).max())
