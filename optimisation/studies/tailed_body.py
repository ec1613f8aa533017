"""A body with one tail on a hinge, free in space or held, as a small Drake plant, and what a swing of the tail does.

Without air the turn of the body is that of zero angular momentum: inertias and the way of the tail decide it, neither
the motor nor the time. With air `TailForce` pushes on the tail. Gravity is left out: it has no moment about the centre
of mass. The hinge is driven along half a cosine by a PD controller that is stiff against the swing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import PidController
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource, VectorLogSink
from pydrake.trajectories import PiecewisePolynomial
from scipy.integrate import quad, trapezoid

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.systems.connections import constant, select

STIFFNESS = 60.0
"""Natural frequency of the hinge's controller times the time of the swing."""
SETTLING = 0.2
"""Time after the swing in which the tail comes to rest, of the time of the swing."""
ACCURACY = 1e-6
"""Of the error-controlled integrator; a turn then errs by some 1e-5 of itself."""
_SAMPLES = 400


@dataclass(frozen=True)
class TailedBody:
    """A body B with a tail T on a hinge; at angle zero the frames of both are parallel.

    Attributes:
        body: spatial inertia about the body's origin, in B.
        tail: the same of the tail about the hinge, in T.
        hinge: place of the hinge in B (3), m.
        axis: of the hinge (3), a unit vector.
    """

    body: SpatialInertia
    tail: SpatialInertia
    hinge: tuple[float, float, float]
    axis: tuple[float, float, float]

    def locked(self, angle: float = 0.0) -> SpatialInertia:
        """Body and tail as one, about the body's origin; the tail at an angle, rad."""
        turned = RigidTransform(RollPitchYaw(angle * np.asarray(self.axis)), np.array(self.hinge))
        return combined([self.body, placed(self.tail, turned)])


@dataclass(frozen=True)
class Swing:
    """One swing of a tail: half a cosine from one angle to another.

    Attributes:
        start, end: of the tail against the body, rad.
        duration: s.
    """

    start: float
    end: float
    duration: float


@dataclass(frozen=True)
class TailAir:
    """What the air does to a tail: sections in T, coefficient C_N of both sides, velocity of the air in W (3), m/s."""

    layout: SectionLayout
    coefficient: float
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Motion:
    """What a swing did.

    Attributes:
        time: s (n).
        tail: angle of the tail against the body, rad (n).
        turn: of the body about the axis that was asked for, rad (n): the twist of its orientation about that axis.
        rpy: roll, pitch and yaw of the body, rad (n, 3).
        air_moment: of the air about the hinge's axis in W, N m (n); zero without air.
        tail_momentum: largest angular momentum of the tail about the hinge's axis if the body stood still, N m s.
    """

    time: FloatArray
    tail: FloatArray
    turn: FloatArray
    rpy: FloatArray
    air_moment: FloatArray
    tail_momentum: float

    @property
    def turn_per_tail(self) -> float:
        """Turn of the body per turn of the tail against it, over the whole swing."""
        return float((self.turn[-1] - self.turn[0]) / (self.tail[-1] - self.tail[0]))

    @property
    def air_impulse(self) -> float:
        """Impulse of the air's moment over the swing, N m s."""
        return float(trapezoid(self.air_moment, self.time))


def placed(inertia: SpatialInertia, X_BP: RigidTransform) -> SpatialInertia:
    """An inertia about the origin of P and in P as one about the origin of B and in B."""
    return inertia.ReExpress(X_BP.rotation()).Shift(-X_BP.translation())


def at(inertia: SpatialInertia, place: ArrayLike) -> SpatialInertia:
    """An inertia about its own centre of mass, with that centre at a place of the frame, about the frame's origin."""
    return placed(inertia, RigidTransform(np.array(place, float)))


def combined(parts: Sequence[SpatialInertia]) -> SpatialInertia:
    """Several inertias about one point, in one frame, as one."""
    first, *others = parts
    total = SpatialInertia(first.get_mass(), first.get_com(), first.get_unit_inertia())
    for part in others:
        total += part
    return total


def moment_about(inertia: SpatialInertia, axis: Sequence[float], *, central: bool = False) -> float:
    """Moment of inertia about an axis through the frame's origin or, `central`, through the centre of mass, kg m2."""
    shifted = inertia.Shift(inertia.get_com()) if central else inertia
    direction = np.asarray(axis, float)
    return float(direction @ shifted.CalcRotationalInertia().CopyToFullMatrix3() @ direction)


def swing_tail(
    system: TailedBody,
    swing: Swing,
    air: TailAir | None = None,
    *,
    about: Sequence[float] | None = None,
    held: bool = False,
    accuracy: float = ACCURACY,
) -> Motion:
    """Swings the tail of a body that is free in space and at rest.

    Args:
        system: body and tail.
        swing: of the tail.
        air: none, or what pushes on the tail.
        about: axis of the body whose turn is wanted (3); the hinge's axis without it.
        held: the body is fixed to the world.
        accuracy: of the integrator.
    """
    builder = DiagramBuilder()
    plant = MultibodyPlant(0.0)
    builder.AddSystem(plant)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    body, tail = plant.AddRigidBody("body", system.body), plant.AddRigidBody("tail", system.tail)
    hinge = plant.AddFrame(FixedOffsetFrame("hinge", body.body_frame(), RigidTransform(np.array(system.hinge))))
    joint: Any = plant.AddJoint(RevoluteJoint("tail", hinge, tail.body_frame(), np.array(system.axis)))
    plant.AddJointActuator("tail", joint)
    if held:
        plant.WeldFrames(plant.world_frame(), body.body_frame())
    plant.Finalize()
    drive_hinge(builder, plant, joint, swing)
    period = swing.duration / _SAMPLES
    state_log = LogVectorOutput(plant.get_state_output_port(), builder, period)
    air_log = None if air is None else _blow(builder, plant, air, period)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(accuracy)
    root = simulator.get_mutable_context()
    joint.set_angle(plant.GetMyMutableContextFromRoot(root), swing.start)
    simulator.AdvanceTo((1.0 + SETTLING) * swing.duration)
    found = state_log.FindLog(root)
    wrenches = None if air_log is None else air_log.FindLog(root).data()
    return _motion(system, joint, found.sample_times(), found.data(), wrenches, about or system.axis, held)


def drive_hinge(builder: DiagramBuilder, plant: MultibodyPlant, joint: RevoluteJoint, swing: Swing) -> None:
    """PD control of the hinge along half a cosine, with gains from the inertia that the hinge feels."""
    context = plant.CreateDefaultContext()
    joint.set_angle(context, swing.start)
    rate = joint.velocity_start()
    felt = 1.0 / np.linalg.inv(plant.CalcMassMatrix(context))[rate, rate]
    frequency = STIFFNESS / swing.duration
    control = PidController(*np.array([[felt * frequency**2], [0.0], [2.0 * felt * frequency]]))
    builder.AddSystem(control)
    time = np.linspace(0.0, swing.duration, 101)
    angles = swing.start + (swing.end - swing.start) * 0.5 * (1.0 - np.cos(np.pi * time / swing.duration))
    curve = PiecewisePolynomial.CubicShapePreserving(time.tolist(), [angles.tolist()], True)
    wanted = builder.AddSystem(TrajectorySource(curve, 1, True))
    builder.Connect(wanted.get_output_port(), control.get_input_port_desired_state())
    indices = [joint.position_start(), plant.num_positions() + rate]
    measured = select(builder, "tail_state", plant.get_state_output_port(), indices)
    builder.Connect(measured, control.get_input_port_estimated_state())
    builder.Connect(control.get_output_port(), plant.get_actuation_input_port())


def _blow(builder: DiagramBuilder, plant: MultibodyPlant, air: TailAir, period: float) -> VectorLogSink:
    wind = constant(builder, "wind", air.wind)
    force = add_tail_force(builder, plant, "tail", air.layout, air.coefficient, wind=wind)
    return LogVectorOutput(force.GetOutputPort("wrench"), builder, period)


def _motion(
    system: TailedBody,
    joint: RevoluteJoint,
    time: FloatArray,
    states: FloatArray,
    wrenches: FloatArray | None,
    about: Sequence[float],
    held: bool,
) -> Motion:
    tail = states[joint.position_start()]
    quaternions = np.tile([[1.0], [0.0], [0.0], [0.0]], time.size) if held else states[:4]
    w, x, y, z = quaternions / np.linalg.norm(quaternions, axis=0)
    turn = np.unwrap(2.0 * np.arctan2(np.asarray(about, float) @ np.array([x, y, z]), w))
    rpy = np.array(
        [
            np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)),
            np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ]
    )
    moment = np.zeros(time.size) if wrenches is None else np.asarray(system.axis) @ wrenches[3:6]
    rate = np.abs(np.gradient(tail, time)).max()
    momentum = float(moment_about(system.tail, system.axis) * rate)
    return Motion(time, tail, turn, np.unwrap(rpy, axis=1).T, moment, momentum)


def planar_turn(
    body_moment: float,
    tail_moment: float,
    masses: tuple[float, float],
    arms: tuple[float, float],
    swing: tuple[float, float],
) -> float:
    """Turn of a planar body by a swing of its tail at zero angular momentum, rad: the closed form.

    With mu the reduced mass and c the cosine of the angle between the lines from the centre of the body to the hinge
    and from the hinge to the centre of the tail,

        d(body) = -(I_t + mu l^2 + mu b l c) / (I_b + I_t + mu (b^2 + l^2 + 2 b l c)) d(tail).

    With the hinge at the body's centre (b = 0) the ratio is constant, the tail's inertia over that of both: what Libby
    et al. (IEEE Trans. Robotics 32(6), 2016) call the template of inertial reorientation.

    Args:
        body_moment, tail_moment: of inertia, each about its own centre of mass, kg m2.
        masses: of body and tail, kg.
        arms: b from the body's centre to the hinge, l from the hinge to the tail's centre, m.
        swing: first and last angle of the tail's line against the body's, rad; at zero the tail goes on straight.
    """
    (m_b, m_t), (near, far) = masses, arms
    mu = m_b * m_t / (m_b + m_t)

    def rate(angle: float) -> float:
        c = math.cos(angle)
        tail = tail_moment + mu * far * (far + near * c)
        return -tail / (body_moment + tail_moment + mu * (near * near + far * far + 2.0 * near * far * c))

    return float(quad(rate, *swing, epsabs=0.0, epsrel=1e-12)[0])
