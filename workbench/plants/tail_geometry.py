"""A tail as an object: an arm and its plates or half shells, with area, centre of pressure, mass and inertia.

Frame T: origin where the joint axes of the tail cross, z along a straight tail from root to tip; on the car, x forward
and y to the left while all joints are zero (design section 4).

The arm is a thin rod, with the moment of a solid cylinder about its own axis. All integrals are closed forms.
Areas are planform areas. The centre of pressure is that of even pressure, which is where sections put the force of a
steady broadside wind; how it moves with the angle of attack is not modelled. Sections do not shade one another.
Behind a plate with C_D the air is slower by 0.976 sqrt(C_D c / x) of its speed, x behind a chord c (Schlichting,
Boundary-Layer Theory): a second row of plates is worth less than its sections say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.errors import ModelError
from aerodima.workbench.plants.sdf_model import Inertial
from aerodima.workbench.plants.tail_plate import (
    UP,
    MassMoments,
    Piece,
    Plate,
    Vector,
    as_tuple,
    gap,
    overlap,
    require_above_zero,
    require_vectors,
    rod_moments,
    unit_vector,
)

SAME_PLANE = 1e-3
"""m; plates nearer than this, measured along their normal, count as lying in one plane."""


@dataclass(frozen=True)
class TailArm:
    """The rod that carries the plates: straight pieces from the origin of T, a thin rod of even mass.

    Attributes:
        lengths: of its straight pieces, m.
        density: kg/m.
        radius: m; drawn, and for its moment about its own axis.
        axes: directions of the pieces; one for all of them is enough.

    Raises:
        ModelError: names the value and what is allowed.
    """

    lengths: tuple[float, ...]
    density: float
    radius: float = 0.006
    axes: tuple[Vector, ...] = (UP,)

    def __post_init__(self) -> None:
        if not self.lengths or len(self.axes) not in (1, len(self.lengths)):
            raise ModelError(f"arm: {len(self.lengths)} lengths and {len(self.axes)} axes; allowed: n and 1 or n")
        for name, values, unit in (
            ("length", self.lengths, "m"),
            ("density", (self.density,), "kg/m"),
            ("radius", (self.radius,), "m"),
        ):
            require_above_zero(f"arm: {name}", values, unit)
        require_vectors("arm", (), self.axes)

    @property
    def points(self) -> np.ndarray:
        """Ends of its pieces in T (n + 1, 3), m, from the origin on."""
        steps = [length * unit_vector(self.axes[n % len(self.axes)]) for n, length in enumerate(self.lengths)]
        return np.cumsum([np.zeros(3), *steps], axis=0)

    @property
    def moments(self) -> MassMoments:
        """Mass and its moments from the density."""
        total = MassMoments.zero()
        for number, (near, length) in enumerate(zip(self.points, self.lengths, strict=False)):
            axis = unit_vector(self.axes[number % len(self.axes)])
            across = unit_vector(np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))]))
            frame = np.column_stack([across, np.cross(axis, across), axis])
            total = total + rod_moments(self.density, length, self.radius).moved(frame, near)
        return total


@dataclass(frozen=True)
class TailGeometry:
    """An arm with its plates; mass and inertia follow from the densities unless they are known better.

    Attributes:
        name: in reports and drawings.
        arm: the rod.
        plates: what the air acts on, at least one; plates may cross or touch, but not lie on one another.
        arm_inertial, sail_inertial: known values, in T, that replace those of the arm, and of all plates together.

    Raises:
        ModelError: no plates, a name used twice, or plates that overlap.
    """

    name: str
    arm: TailArm
    plates: tuple[Plate, ...]
    arm_inertial: Inertial | None = None
    sail_inertial: Inertial | None = None

    def __post_init__(self) -> None:
        if not self.plates:
            raise ModelError(f"tail {self.name!r}: it has no plates; allowed: at least one")
        names = [plate.name for plate in self.plates]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ModelError(f"tail {self.name!r}: plate name {twice[0]!r} is used twice; allowed: a name each")
        for one, other in combinations(self.plates, 2):
            if any(overlap(a, b) and abs(gap(a, b)) < SAME_PLANE for a in one.pieces for b in other.pieces):
                raise ModelError(
                    f"tail {self.name!r}: plates {one.name!r} and {other.name!r} overlap: the air would push twice on "
                    "what they share; allowed: plates side by side, one behind the other, or across each other"
                )

    def from_densities(self) -> TailGeometry:
        """The same tail with mass and inertia from its densities alone."""
        return replace(self, arm_inertial=None, sail_inertial=None)

    @property
    def arm_mass(self) -> Inertial:
        """Of the arm in T."""
        return self.arm_inertial or self.arm.moments.inertial()

    @property
    def sail_mass(self) -> Inertial:
        """Of all plates in T."""
        return self.sail_inertial or sum((plate.moments for plate in self.plates), MassMoments.zero()).inertial()

    @property
    def inertial(self) -> Inertial:
        """Of the whole tail in T."""
        return (MassMoments.of(self.arm_mass) + MassMoments.of(self.sail_mass)).inertial()

    @property
    def inertia_about_joints(self) -> np.ndarray:
        """Of the whole tail about the origin of T (3 x 3), kg m2."""
        second = MassMoments.of(self.inertial).second
        return np.trace(second) * np.eye(3) - second

    @property
    def area(self) -> float:
        """Planform of all plates, m2."""
        return sum(plate.area for plate in self.plates)

    def facing_area(self, direction: Sequence[float]) -> float:
        """Planform seen along a direction, m2: each piece with the cosine of its normal."""
        return float(sum(facing * piece.area for facing, piece in self._facing(direction)))

    def centre_of_pressure(self, direction: Sequence[float] | None = None) -> np.ndarray:
        """Centroid in T (3), m, of the planform seen along a direction, by default the first plate's normal.

        Raises:
            ModelError: no plate faces that direction.
        """
        chosen = self.plates[0].normal if direction is None else direction
        seen = self.facing_area(chosen)
        if seen < 1e-12:
            raise ModelError(f"tail {self.name!r}: no plate faces the direction {tuple(chosen)}")
        return np.asarray(sum(facing * piece.area * piece.centre for facing, piece in self._facing(chosen)) / seen)

    def _facing(self, direction: Sequence[float]) -> list[tuple[float, Piece]]:
        along = unit_vector(direction)
        return [(abs(float(piece.normal @ along)), piece) for plate in self.plates for piece in plate.pieces]

    @property
    def points(self) -> np.ndarray:
        """Ends of the arm and corners of all pieces in T (n, 3), m; a half shell with the crown of its round side."""
        points = [self.arm.points]
        for plate in self.plates:
            for piece in plate.pieces:
                points.append(piece.corners)
                if plate.kind == "half_shell":
                    ends = np.array([piece.start, piece.start + piece.length * piece.axis])
                    points.append(ends + np.outer(piece.chords, piece.normal) / 2)
        return np.vstack(points)

    def section_layouts(self) -> list[SectionLayout]:
        """Sections of all plates in T, for one `TailForce` each."""
        return [layout for plate in self.plates for layout in plate.section_layouts()]

    def added_mass_layout(self, parts: int = 5) -> SectionLayout:
        """Equal parts of the whole arm, for `add_added_mass`, in T; their normal and width mean nothing.

        Raises:
            ModelError: a bent arm: added mass is modelled on a straight line.
        """
        axes = {as_tuple(unit_vector(axis)) for axis in self.arm.axes}
        if len(axes) > 1:
            raise ModelError(f"tail {self.name!r}: added mass needs a straight arm; this one is bent")
        (axis,) = axes
        sideways = np.eye(3)[1] if abs(axis[1]) < 0.9 else np.eye(3)[0]
        normal = unit_vector(sideways - (sideways @ axis) * np.asarray(axis))
        return SectionLayout.strip(
            start=0.0, length=sum(self.arm.lengths), width=self.plates[0].chords[0], number=parts,
            axis_B=axis, normal_B=as_tuple(normal),
        )  # fmt: skip
