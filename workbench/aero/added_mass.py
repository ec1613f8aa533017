"""Added mass of a tail (QSS-AM, design section 5) as inertia inside the plant, so that it takes
part in contact.

Each of n equal parts of the tail feels -m_added times its acceleration normal to the tail axis. A
straight row of such parts is one body without weight: mass M = n m_added at the middle of the row,
moment of inertia m_added sum (s_i - s)^2 about the normals and none about the axis. What remains is
to free it along the axis:

- m_added > 0: the body slides on a frictionless prismatic joint along the axis, so that its inertia
  acts on the tail only across the axis: eliminating the slide leaves exactly M_added = sum J_i^T m
  (1 - a a^T) J_i.
- m_added < 0: a body of negative mass is welded to the tail, and a second one of mass |M|, which
  slides freely across the axis, puts the spanwise inertia back.

The air holds the sliding bodies beside the tail: a critically damped spring pushes them from
outside, along their slides only (`_hold_slides`). No part of that push reaches the tail, so a slide
that lags by the acceleration along it over rate^2 shifts the place of the added mass, never the
force balance.

The other method tried, a force computed from (M + M_added) vdot = tau without the contact forces,
lifts a resting car; a welded body without a slide is exact in contact but has spanwise inertia too.
README.md beside this file has the figures.

Welded bodies (`spanwise_free=False`) still pull along the axis when the tail turns: on a rig whose
pivot lies on the axis the motion is right, the reaction force along the axis is not. The bodies sit
in their own model instance, without gravity: leave that instance out of sums over the vehicle's
mass.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant, Propeller, PropellerInfo
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    JacobianWrtVariable,
    ModelInstanceIndex,
    PrismaticJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain

from aerodima.workbench.aero.gust_force import GustForce
from aerodima.workbench.aero.sections import SectionLayout, sampled_poses
from aerodima.workbench.aero.tail_force import ADDED_MASS_PREFIX, connect_spatial_forces
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.port_wiring import add_and_connect
from aerodima.workbench.core.ranges import check_range

_CONTINUOUS_RATE = 250.0
"""Rate of the hold in a continuous plant, rad/s."""
_RATE_TIMES_STEP = 0.5
"""Rate of the hold times the time step of a discrete plant; it is stable up to 0.82."""
_POSITION_SAMPLES = 64
"""Number of positions at which the inertia is checked."""
Slides = tuple[tuple[Any, float], ...]
"""For each slide its `PrismaticJoint` and the mass that it frees, kg."""


@dataclass(frozen=True)
class AddedMass:
    """Added mass on one body of a plant; made by `add_added_mass` before Finalize.

    Attributes:
        plant: plant that holds the body.
        body: body that carries the added mass.
        layout: parts with added mass, over the whole tail.
        mass_per_part: added mass m_added of each part, kg.
        instance: model instance of the weightless bodies.
        middle: frame at the middle of the parts, z along the tail axis.
        slides: slides of the weightless bodies.
    """

    plant: MultibodyPlant
    body: RigidBody
    layout: SectionLayout
    mass_per_part: float
    instance: ModelInstanceIndex
    middle: Frame
    slides: Slides

    def add_to_builder(
        self,
        builder: DiagramBuilder,
        *,
        wind_acceleration: OutputPort | None = None,
        rate: float | None = None,
        min_inertia_fraction: float = 0.0,
    ) -> None:
        """Checks that M + M_added is positive definite and adds the hold of the slides, and the
        push of air that accelerates.

        Args:
            builder: builder that owns the finalised plant.
            wind_acceleration: port of the acceleration of the air in W (3), m/s2; None for steady
                wind.
            rate: rate of the hold, rad/s; default 0.5 / time step, or 250 in a continuous plant.
            min_inertia_fraction: share of every inertia that a negative mass must leave, see
                `require_positive_definite`.

        Raises:
            ModelError: the mass is too negative, see `require_positive_definite`; or the plant is
                not finalised.
        """
        plant = self.plant
        if not plant.is_finalized():
            raise ModelError("added mass: the plant is not finalised; call plant.Finalize() first")
        self.require_positive_definite(min_inertia_fraction)
        if self.slides:
            step = plant.time_step()
            rate = rate or (_RATE_TIMES_STEP / step if step > 0.0 else _CONTINUOUS_RATE)
            self._hold_slides(builder, rate)
        if wind_acceleration is not None:
            mass = self.layout.number * self.mass_per_part
            push = add_and_connect(
                builder,
                GustForce(plant, self.middle, mass),
                f"added_mass_gust_{self.body.name()}",
                plant_state=plant.get_state_output_port(),
                wind_acceleration=wind_acceleration,
            )
            connect_spatial_forces(builder, plant, push.GetOutputPort("spatial_forces"))

    def _hold_slides(self, builder: DiagramBuilder, rate: float) -> None:
        """Adds the hold: for each slide with coordinate x, mass m and direction e the force
        -m (2 rate xdot + rate^2 x) e on the body at the end of the slides.

        Drake's `Propeller` makes forces along axes of a body from numbers, without Python.
        """
        plant = self.plant
        gain = np.zeros((len(self.slides), plant.num_multibody_states()))
        thrusters = []
        sliding = self.slides[-1][0].child_body().index()
        for row, (joint, mass) in enumerate(self.slides):
            gain[row, joint.position_start()] = -mass * rate**2
            gain[row, plant.num_positions() + joint.velocity_start()] = -2.0 * mass * rate
            along_slide = RotationMatrix.MakeFromOneVector(joint.translation_axis(), 2)
            thrusters.append(PropellerInfo(sliding, RigidTransform(along_slide), moment_ratio=0.0))
        name = f"added_mass_hold_{self.body.name()}"
        forces = builder.AddNamedSystem(f"{name}_forces", MatrixGain(gain))
        builder.Connect(plant.get_state_output_port(), forces.get_input_port())
        hold = add_and_connect(
            builder,
            Propeller(thrusters),
            name,
            body_poses=plant.GetOutputPort("body_poses"),
            command=forces.get_output_port(),
        )
        connect_spatial_forces(builder, plant, hold.get_spatial_forces_output_port())

    def require_positive_definite(self, min_inertia_fraction: float) -> None:
        """Refuses a negative added mass that takes more inertia away than there is, at any of 64
        sampled positions.

        Args:
            min_inertia_fraction: share of every inertia that must be left; 0 asks for no more than
                a positive definite matrix.

        Raises:
            ModelError: names the body, the value and the least value that is allowed there.
        """
        if self.mass_per_part >= 0.0:
            return
        from scipy.linalg import eigh

        plant = self.plant
        slides = [joint.velocity_start() for joint, _ in self.slides]
        others = np.setdiff1d(np.arange(plant.num_velocities()), slides)
        keep = np.ix_(others, others)
        for context in sampled_poses(plant, _POSITION_SAMPLES):
            for index in plant.GetBodyIndices(self.instance):
                plant.get_body(index).SetSpatialInertiaInBodyFrame(context, SpatialInertia.Zero())
            unit = added_mass_matrix(plant, context, self.body, self.layout, 1.0)
            largest = eigh(unit[keep], plant.CalcMassMatrix(context)[keep], eigvals_only=True)[-1]
            if self.mass_per_part * largest <= min_inertia_fraction - 1.0 + 1e-9:
                if self.mass_per_part * largest > -1.0:
                    too_much = f"leaves less than {min_inertia_fraction:.0%} of an inertia"
                else:
                    too_much = (
                        "takes more inertia away than there is (M + M_added is not positive "
                        "definite)"
                    )
                raise ModelError(
                    f"added mass: {self.mass_per_part} kg per part on body '{self.body.name()}' "
                    f"{too_much}; it must be above {(min_inertia_fraction - 1.0) / largest:.4g} kg"
                )


def added_mass_matrix(
    plant: MultibodyPlant,
    context: Any,
    body: RigidBody,
    layout: SectionLayout,
    mass_per_part: float,
) -> FloatArray:
    """Returns M_added = sum_i m J_i^T (1 - a a^T) J_i with the translational Jacobians of the part
    centres (nv x nv).
    """
    world = plant.world_frame()
    a_W = plant.EvalBodyPoseInWorld(context, body).rotation().matrix() @ np.asarray(layout.axis_B)
    across = np.eye(3) - np.outer(a_W, a_W)
    total = np.zeros((plant.num_velocities(), plant.num_velocities()))
    for p_BoSi_B in layout.p_BoSi_B:
        J = plant.CalcJacobianTranslationalVelocity(
            context, JacobianWrtVariable.kV, body.body_frame(), p_BoSi_B, world, world
        )
        total += mass_per_part * J.T @ across @ J
    return total


def add_added_mass(
    plant: MultibodyPlant,
    body: RigidBody,
    layout: SectionLayout,
    mass_per_part: float,
    *,
    spanwise_free: bool = True,
) -> AddedMass:
    """Puts the added mass of a tail into a plant, before Finalize.

    Args:
        layout: parts of the whole tail (not only of its exposed part); a `SectionLayout.strip` has
            five by default.
        mass_per_part: added mass m_added of each part, kg; may be negative.
        spanwise_free: whether the added mass is free along the tail's axis. False welds it to the
            tail and adds no degree of freedom: exact where the tail cannot accelerate along its
            axis except by turning about a point on it, as on the rig.

    Raises:
        ModelError: the mass is not finite, or the plant is already finalised.
    """
    place = f"added mass per part on body '{body.name()}'"
    check_range(place, mass_per_part, -math.inf, math.inf, "kg", error=ModelError)
    if plant.is_finalized():
        raise ModelError(
            "added mass: the plant is already finalised; add the mass before plant.Finalize()"
        )
    name = f"{ADDED_MASS_PREFIX}{body.name()}"
    instance = plant.AddModelInstance(name)
    plant.set_gravity_enabled(instance, False)
    middle = plant.AddFrame(
        FixedOffsetFrame(f"{name}_middle", body.body_frame(), _middle_pose(layout), instance)
    )
    if mass_per_part == 0.0:
        return AddedMass(plant, body, layout, mass_per_part, instance, middle, ())
    s = np.asarray(layout.distances)
    mass = layout.number * mass_per_part
    moment = mass_per_part * float(np.sum((s - s.mean()) ** 2))
    inertia = SpatialInertia(
        mass, np.zeros(3), UnitInertia(moment / mass, moment / mass, 0.0), skip_validity_check=True
    )
    row = plant.AddRigidBody(name, instance, inertia)
    slides: Slides = ()
    if mass_per_part < 0.0 or not spanwise_free:
        plant.WeldFrames(middle, row.body_frame())
        if spanwise_free:
            slides = _free_across(plant, instance, middle, -mass, name)
    else:
        joint = plant.AddJoint(
            PrismaticJoint(f"{name}_slide", middle, row.body_frame(), np.eye(3)[2])
        )
        slides = ((joint, mass),)
    return AddedMass(plant, body, layout, mass_per_part, instance, middle, slides)


def _free_across(
    plant: MultibodyPlant, instance: ModelInstanceIndex, middle: Any, mass: float, name: str
) -> Slides:
    """Adds a point of positive mass that slides across the axis; its inertia acts along it only."""
    x, y, _ = np.eye(3)
    at_point = SpatialInertia(mass, np.zeros(3), UnitInertia(0.0, 0.0, 0.0))
    carrier = plant.AddRigidBody(f"{name}_carrier", instance, SpatialInertia.Zero())
    point = plant.AddRigidBody(f"{name}_spanwise", instance, at_point)
    between = carrier.body_frame()
    first = plant.AddJoint(PrismaticJoint(f"{name}_slide_x", middle, between, x))
    second = plant.AddJoint(PrismaticJoint(f"{name}_slide_y", between, point.body_frame(), y))
    return ((first, mass), (second, mass))


def _middle_pose(layout: SectionLayout) -> RigidTransform:
    """Returns the frame at the middle of the parts, z along the axis, x along the sail normal."""
    z = np.asarray(layout.axis_B)
    x = np.asarray(layout.normal_B)
    middle = np.asarray(layout.p_BoRo_B) + float(np.mean(layout.distances)) * z
    return RigidTransform(RotationMatrix(np.column_stack([x, np.cross(z, x), z])), middle)
