"""The sail that turns freely about the tail's own axis (design section 5, "Passive sail").

In the sail frame S the z axis is the tail axis (root to tip) and the chord lies along x at zero angle; the wind that
comes from +x blows along -x. The centre of pressure sits `centre_of_pressure` behind the axis, at
x = -centre_of_pressure. Behind (positive) the sail turns into the wind like a vane; ahead (negative), as on the first
sail of the thesis, it turns away.

The moment about the sail axis is not a law of its own: the force acts at the centre of pressure, and its rigid-body
velocity includes the sail's own rate, which gives the damping c = 1/2 rho A C_N |v| e^2. For small angles in a wind U

    omega_n^2 = 1/2 rho A C_N U^2 e / I,    zeta = c / (2 I omega_n) (bearing damping comes on top).

The centre of pressure is fixed: a real plate's moves from a quarter of the chord behind its leading edge (edge-on) to
the middle (broadside), which this model leaves out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, RigidBody, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder, OutputPort, System

from workbench.aero.laws import NormalForceLaw, SectionLaw, TwoSidedLaw
from workbench.aero.sections import Air, SectionLayout
from workbench.aero.tail_force import add_to_builder
from workbench.errors import ModelError


@dataclass(frozen=True)
class FreeSail:
    """A sail on a bearing about the tail axis.

    Attributes:
        length, width: of the sail along the tail and along the chord, m.
        centre_of_pressure: behind the axis, m; negative is ahead.
        mass: kg.
        inertia: about the sail axis, kg m2.
        start: distance of the sail's near end from the origin of its mount along the axis, m.
        bearing_damping: N m s/rad.
        law: `NormalForceLaw`, or `TwoSidedLaw` for a half cylinder whose normal (+y) leaves its round side.
        number: of sections.
    """

    length: float
    width: float
    centre_of_pressure: float
    mass: float
    inertia: float
    start: float = 0.0
    bearing_damping: float = 0.0
    law: NormalForceLaw | TwoSidedLaw = NormalForceLaw(2.0)  # noqa: RUF009 (frozen)
    number: int = 5

    def __post_init__(self) -> None:
        for name in ("length", "width", "mass", "inertia"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(f"free sail: {name} is {value}, but it must be a finite number above 0")
        if not (math.isfinite(self.bearing_damping) and self.bearing_damping >= 0.0):
            raise ModelError(
                f"free sail: bearing_damping is {self.bearing_damping}, but it must be a finite number from 0"
            )
        if not abs(self.centre_of_pressure) <= self.width:
            raise ModelError(
                f"free sail: centre_of_pressure is {self.centre_of_pressure} m, but it must lie within one width "
                f"({self.width} m) of the axis"
            )

    @property
    def layout(self) -> SectionLayout:
        """Sections in the sail frame, on the line through the centre of pressure."""
        return SectionLayout.strip(
            start=self.start,
            length=self.length,
            width=self.width,
            number=self.number,
            p_BoRo_B=(-self.centre_of_pressure, 0.0, 0.0),
            axis_B=(0.0, 0.0, 1.0),
            normal_B=(0.0, 1.0, 0.0),
        )

    def vane_frequency(self, wind_speed: float, coefficient: float, air: Air | None = None) -> float:
        """Undamped small-angle frequency omega_n as a weather vane, rad/s; 0 when the centre of pressure is not behind.

        Args:
            wind_speed: m/s.
            coefficient: C_N.
        """
        density = (air or Air()).density
        area = self.length * self.width
        stiffness = 0.5 * density * area * coefficient * wind_speed**2 * self.centre_of_pressure
        return math.sqrt(max(stiffness, 0.0) / self.inertia)

    def add_to_plant(
        self, plant: MultibodyPlant, tail: RigidBody, X_TS: RigidTransform | None = None, name: str = "sail"
    ) -> tuple[RigidBody, RevoluteJoint]:
        """Adds the sail body and its joint about the tail axis, before Finalize.

        Args:
            X_TS: pose of the sail's mount in the tail frame, z along the axis from root to tip.

        Returns:
            The sail body and the joint `<name>_joint` (angle about +z of the mount, rad).
        """
        middle = np.array([0.0, 0.0, self.start + self.length / 2])
        radius, along = self.inertia / self.mass, self.length**2 / 12
        # A plate with its mass on the axis: G_zz is given, the others follow from the length and half of G_zz each.
        shape = UnitInertia(along + radius / 2, along + radius / 2, radius)
        body = plant.AddRigidBody(name, SpatialInertia(self.mass, middle, shape.ShiftFromCenterOfMass(middle)))
        mount = plant.AddFrame(FixedOffsetFrame(f"{name}_mount", tail.body_frame(), X_TS or RigidTransform()))
        joint = RevoluteJoint(f"{name}_joint", mount, body.body_frame(), np.eye(3)[2], self.bearing_damping)
        added: RevoluteJoint = plant.AddJoint(joint)  # type: ignore[assignment]  # the stubs say Joint
        return body, added

    def add_to_builder(
        self,
        builder: DiagramBuilder,
        plant: MultibodyPlant,
        body: RigidBody | str = "sail",
        *,
        air: Air | None = None,
        wind: OutputPort | None = None,
    ) -> System:
        """Adds the air's force on the sail, see `tail_force.add_to_builder`."""
        law: SectionLaw = self.law
        return add_to_builder(builder, plant, body, self.layout, law, air=air, wind=wind)
