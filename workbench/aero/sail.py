r"""The sail on a bearing about the tail's own axis (design section 5, "Sail"; thesis 5.2).

The sail is a half cylinder, hollow towards the wind, with a backing board behind it that turns it there like a
rudder. In the sail frame S the z axis is the bearing, root to tip. The hollow opens to +y; "behind" is -y, where the
board is. Seen along z at angle 0, with the wind towards -y:

      wind | | | |
           v v v v
         |         |  +y
         |    o    |  bearing, then behind it:
          \_     _/   shell, middle of its depth at y = -e
             | |
             | |      board, middle at y = -(e + width/4 + board/2)

Three flat plates stand for it: the shell's opening (normal y), the shell's outline from the side (half as deep as the
opening is wide) and the board (both normal x). The first pushes through the bearing; the moment of the two others
about it is

    -1/2 rho C |v|^2 sin(delta) S,   S = sum of side area x distance behind the bearing,

delta the angle between wind and -y. So the sail is stable facing the wind with S > 0, and turns away from it with
S < 0, as with the bearing of the first sail of the thesis, too far behind. For small angles in a wind U

    omega_n^2 = 1/2 rho C U^2 S / I,    zeta = 1/2 rho C U S2 / (2 I omega_n), S2 with the distance squared,

plus the damping of the bearing. The damping is no law of its own: the plates feel the sail's own rate.
Valid as far as plates are: how drag changes with delta is known from Fig. 5.11 in words only, a real centre of
pressure moves with delta, and the shell does not shade the board here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, RigidBody, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder, OutputPort, System

from aerodima.workbench.aero.laws import CrossedPlatesLaw, NormalForceLaw, SectionLaw
from aerodima.workbench.aero.sections import Air, SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.config.car_parameters import SHELL_DEPTH
from aerodima.workbench.errors import ModelError


@dataclass(frozen=True)
class FreeSail:
    """A half cylinder with a backing board on a bearing about the tail axis.

    Attributes:
        length, width: of the opening along the tail and across it, m.
        centre_of_pressure: e, of the shell's side force behind the bearing, m; a quarter of the width with the bearing
            in the plane of the opening, negative with the bearing behind it.
        board_width: of the backing board along the wind, m.
        mass: kg.
        inertia: about the bearing, kg m2.
        start: distance of the sail's near end from the origin of its mount along the axis, m.
        bearing_damping: N m s/rad.
        law: of the opening; the normal of a `TwoSidedLaw` leaves its round side, -y.
        side_coefficient: C_N of shell and board across the wind.
        number: of sections.
        shell_share: depth of the shell over its width; 0 for a flat sail.
    """

    length: float
    width: float
    centre_of_pressure: float
    board_width: float
    mass: float
    inertia: float
    start: float = 0.0
    bearing_damping: float = 0.0
    law: SectionLaw = NormalForceLaw(2.0)  # noqa: RUF009 (frozen)
    side_coefficient: float = 2.0
    number: int = 5
    shell_share: float = SHELL_DEPTH

    def __post_init__(self) -> None:
        for name in ("length", "width", "board_width", "mass", "inertia"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(f"free sail: {name} is {value}, but it must be a finite number above 0")
        for name in ("bearing_damping", "side_coefficient"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ModelError(f"free sail: {name} is {value}, but it must be a finite number from 0")
        if not abs(self.centre_of_pressure) <= self.width:
            raise ModelError(
                f"free sail: centre_of_pressure is {self.centre_of_pressure} m, but it must lie within one width "
                f"({self.width} m) of the axis"
            )

    @property
    def shell_law(self) -> CrossedPlatesLaw:
        """The opening along its normal, and the outline across it."""
        return CrossedPlatesLaw(self.law, NormalForceLaw(self.shell_share * self.side_coefficient))

    @property
    def shell_layout(self) -> SectionLayout:
        """Sections of the shell in the sail frame."""
        return self._strip(self.width, self.centre_of_pressure, (0.0, -1.0, 0.0))

    @property
    def board_layout(self) -> SectionLayout:
        """Sections of the backing board in the sail frame."""
        return self._strip(self.board_width, self.board_place, (1.0, 0.0, 0.0))

    @property
    def board_place(self) -> float:
        """Distance of the middle of the board behind the bearing, m: it begins where the shell ends."""
        return self.centre_of_pressure + self.shell_share * self.width / 2 + self.board_width / 2

    def _strip(self, width: float, behind: float, normal: tuple[float, float, float]) -> SectionLayout:
        return SectionLayout.strip(
            start=self.start,
            length=self.length,
            width=width,
            number=self.number,
            p_BoRo_B=(0.0, -behind, 0.0),
            normal_B=normal,
        )

    def side_moment(self, power: int = 1) -> float:
        """Sum of side area x (distance behind the bearing)^power, m^(2 + power); S and S2 above for 1 and 2."""
        plates = ((self.shell_share * self.width, self.centre_of_pressure), (self.board_width, self.board_place))
        return self.length * sum(width * behind**power for width, behind in plates)

    def vane_frequency(self, wind_speed: float, air: Air | None = None) -> float:
        """Undamped small-angle frequency omega_n as a weather vane, rad/s; 0 where the sail turns away.

        Args:
            wind_speed: m/s.
            air: density.
        """
        density = (air or Air()).density
        stiffness = 0.5 * density * self.side_coefficient * wind_speed**2 * self.side_moment()
        return math.sqrt(max(stiffness, 0.0) / self.inertia)

    def damping_ratio(self, wind_speed: float, air: Air | None = None) -> float:
        """Share zeta of critical damping by air and bearing in a wind (m/s) that it faces; inf where it turns away."""
        frequency = self.vane_frequency(wind_speed, air)
        rate = 0.5 * (air or Air()).density * self.side_coefficient * wind_speed * self.side_moment(2)
        return (rate + self.bearing_damping) / (2 * self.inertia * frequency) if frequency else math.inf

    def add_to_plant(
        self, plant: MultibodyPlant, tail: RigidBody, X_TS: RigidTransform | None = None, name: str = "sail"
    ) -> tuple[RigidBody, RevoluteJoint]:
        """Adds the sail body and its joint about the tail axis, before Finalize. The sail is balanced on its bearing.

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
        quasi_steady_limit: float | None = None,
        applied: bool = True,
    ) -> tuple[System, System]:
        """Adds the air's force on shell and board, see `add_tail_force`."""
        name = body if isinstance(body, str) else body.name()
        shell = add_tail_force(
            builder,
            plant,
            body,
            self.shell_layout,
            self.shell_law,
            air=air,
            wind=wind,
            quasi_steady_limit=quasi_steady_limit,
            applied=applied,
        )
        board = add_tail_force(
            builder,
            plant,
            body,
            self.board_layout,
            self.side_coefficient,
            air=air,
            wind=wind,
            name=f"board_force_{name}",
            applied=applied,
        )
        return shell, board
