"""A tail as an object: an arm and its plates or half shells, with area, centre of pressure, mass
and inertia.

Frame T: origin where the joint axes of the tail cross, z along a straight tail from root to tip; on
the car, x forward and y to the left while all joints are zero (design section 4).

The arm is a thin rod, with the moment of a solid cylinder about its own axis. A plate is a row of
straight pieces, each with a length, a direction and a width that goes linearly from end to end:
straight, tapered, bent or swept.

- Plate: flat, its mass spread evenly over the area, and over `depth` along the normal (0: thin).
- Half shell: a half cylinder, or half a cone where it tapers. Its opening lies on the row of
  pieces, the normal leaves the round side (as the sail in models/tail/tail.sdf), the material is
  pi/2 of the opening.

Inertias are exact (`tail_mass`). Areas are planform areas. The centre of pressure is that of even
pressure, which is where sections put the force of a steady broadside wind; how it moves with the
angle of attack is not modelled. Sections do not shade one another. Behind a plate with C_D the air
is slower by 0.976 sqrt(C_D c / x) of its speed, x behind a chord c (Schlichting, Boundary-Layer
Theory): a second row of plates is worth less than its sections say.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise, product
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator
from pydrake.math import RotationMatrix
from pydrake.multibody.tree import SpatialInertia

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_mass import (
    inertial_of_inertia,
    placed,
    plate_inertia,
    rod_inertia,
    shell_inertia,
    total_inertia,
)
from aerodima.workbench.aero.tail_pieces import (
    Piece,
    as_tuple,
    gap,
    overlap,
    trapezoid_centre,
    unit_vector,
)
from aerodima.workbench.core.array_types import FloatArray, Vector3
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.key_errors import lines_of, require_unique
from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.core.sdf_model import Inertial

SCHEMA = "aerodima/tail/1"

SAME_PLANE = 1e-3
"""Distance along their normal below which plates count as lying in one plane, m."""
_ALONG = 1e-3
"""Sine of an angle below which a normal counts as running along its axis."""
UP: Vector3 = (0.0, 0.0, 1.0)
"""z of the frame T: along a straight tail, from root to tip."""
_Vector = Annotated[Vector3, Field(strict=False)]
_Sizes = Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(strict=False, min_length=1)]


def _with_length(vector: Vector3) -> Vector3:
    if np.linalg.norm(vector) < 1e-9:
        raise ValueError(f"direction {vector} has no length; allowed: any but zero")
    return vector


_Direction = Annotated[_Vector, AfterValidator(_with_length)]
_Directions = Annotated[tuple[_Direction, ...], Field(strict=False, min_length=1)]


class TailPart(QuantityModel):
    """A part of a tail, made in Python or read from a file; ModelError says what is wrong."""

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as report:
            raise ModelError("; ".join(lines_of(report, type(self)))) from None


class TailArm(TailPart):
    """The rod that carries the plates: thin straight pieces of even mass from the origin of T."""

    lengths: _Sizes = quantity("m", "lengths of the straight pieces, from the joints on")
    density: float = quantity("kg/m", "mass over length", gt=0)
    radius: float = quantity(
        "m", "radius as drawn, and for the moment about the arm's own axis", default=0.006, gt=0
    )
    axes: _Directions = Field(
        default=(UP,), description="directions of the pieces; one is enough where all are alike"
    )

    @model_validator(mode="after")
    def _fits_together(self) -> TailArm:
        if len(self.axes) not in (1, len(self.lengths)):
            raise ValueError(
                f"{len(self.lengths)} lengths and {len(self.axes)} axes; allowed: n and 1 or n"
            )
        return self

    @property
    def points(self) -> FloatArray:
        """Ends of its pieces in T (n + 1, 3), m, from the origin on."""
        return np.cumsum([np.zeros(3), *self._steps], axis=0)

    @property
    def inertia(self) -> SpatialInertia:
        """Inertia about the origin of T from the density."""
        pieces = zip(self.points, self._steps, self.lengths, strict=False)
        return total_inertia(
            placed(
                rod_inertia(self.density, length, self.radius),
                RotationMatrix.MakeFromOneVector(step, 2),
                start,
            )
            for start, step, length in pieces
        )

    @property
    def _steps(self) -> FloatArray:
        """Vectors from end to end of its straight pieces (n, 3), m."""
        axes = np.array([unit_vector(axis) for axis in self.axes])
        return np.reshape(self.lengths, (-1, 1)) * axes


class Plate(TailPart):
    """A plate or half shell, from root to tip."""

    name: str = quantity("1", "name in messages and drawings", min_length=1, max_length=40)
    root: _Vector = quantity("m", "middle of the near edge in T")
    lengths: _Sizes = quantity("m", "lengths of the straight pieces, from the root on")
    chords: _Sizes = quantity("m", "widths at the ends of the pieces, one more than lengths")
    normal: _Direction = quantity(
        "1",
        "normal of the face, out of the round side of a half shell; its part across a piece counts",
    )
    density: float = quantity("kg/m2", "mass over area of the material", gt=0)
    axes: _Directions = Field(
        default=(UP,), description="directions of the pieces; one is enough where all are alike"
    )
    kind: Literal["plate", "half_shell"] = Field(
        default="plate", description="kind of part: flat, or a half cylinder"
    )
    depth: float = quantity(
        "m", "depth over which a plate's mass is spread along its normal", default=0.0, ge=0
    )
    cap_density: float = quantity(
        "kg/m2", "mass over area of half discs at both ends of a half shell", default=0.0, ge=0
    )
    sections: int = Field(
        default=5, description="number of sections of each piece, where the air acts", ge=1, le=100
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Plate:
        where = f"plate {self.name!r}"
        count = len(self.lengths)
        if len(self.chords) != count + 1 or len(self.axes) not in (1, count):
            raise ValueError(
                f"{where}: {count} lengths, {len(self.chords)} chords and {len(self.axes)} axes; "
                "allowed: n lengths, n + 1 chords, and 1 or n axes"
            )
        unused = "cap_density"
        value = self.cap_density
        if self.kind == "half_shell":
            unused = "depth"
            value = self.depth
        if value > 0.0:
            raise ValueError(f"{where}: {unused} is {value:g}; allowed: 0 for a {self.kind}")
        for axis in self.axes:
            sine = np.linalg.norm(np.cross(unit_vector(axis), unit_vector(self.normal)))
            if sine < _ALONG:
                raise ValueError(
                    f"{where}: normal {self.normal} runs along its axis; allowed: across it"
                )
        return self

    @property
    def pieces(self) -> list[Piece]:
        """Its straight pieces, from the root on."""
        pieces = []
        start = np.asarray(self.root, float)
        for number, length in enumerate(self.lengths):
            axis = unit_vector(self.axes[number % len(self.axes)])
            normal = np.asarray(self.normal, float)
            normal = unit_vector(normal - (normal @ axis) * axis)
            ends = (self.chords[number], self.chords[number + 1])
            pieces.append(Piece(start, axis, normal, np.cross(normal, axis), length, ends))
            start = pieces[-1].end
        return pieces

    @property
    def area(self) -> float:
        """Planform area, m2; that of the opening for a half shell."""
        return sum(piece.area for piece in self.pieces)

    @property
    def centre_of_pressure(self) -> FloatArray:
        """Centroid of the planform in T (3), m."""
        moment = sum(piece.area * piece.centre for piece in self.pieces)
        return np.asarray(moment / self.area)

    @property
    def inertia(self) -> SpatialInertia:
        """Inertia about the origin of T from the densities."""
        parts = []
        pieces = self.pieces
        for piece in pieces:
            size = (self.density, piece.length, piece.chords)
            if self.kind == "plate":
                part = plate_inertia(*size, self.depth)
            else:
                closed = (piece is pieces[0], piece is pieces[-1])
                part = shell_inertia(*size, self.cap_density, closed)
            frame = RotationMatrix(np.column_stack([piece.across, piece.normal, piece.axis]))
            parts.append(placed(part, frame, piece.start))
        return total_inertia(parts)

    def section_layouts(self) -> list[SectionLayout]:
        """Returns sections for `TailForce` in T: one layout for each straight run, since those of a
        layout lie on one line.
        """
        runs: list[list[Piece]] = []
        for piece in self.pieces:
            if runs and np.linalg.norm(piece.axis - runs[-1][-1].axis) < 1e-12:
                runs[-1].append(piece)
            else:
                runs.append([piece])
        return [_layout(run, self.sections) for run in runs]


def _layout(run: list[Piece], sections: int) -> SectionLayout:
    """Makes sections on a straight run; distances are from T's origin if its line meets that."""
    first = run[0]
    start = float(first.start @ first.axis)
    through_origin = start >= 0.0 and np.linalg.norm(first.start - start * first.axis) < 1e-12
    root = np.zeros(3)
    if not through_origin:
        root = first.start
        start = 0.0
    length = sum(piece.length for piece in run)
    distances = []
    areas = []
    near = start
    for piece in run:
        part = piece.length / sections
        for chords in pairwise(np.linspace(*piece.chords, sections + 1).tolist()):
            distances.append(near + trapezoid_centre(part, *chords))
            areas.append(part * sum(chords) / 2)
            near += part
    return SectionLayout(
        as_tuple(root),
        as_tuple(first.axis),
        as_tuple(first.normal),
        tuple(distances),
        tuple(areas),
        sum(areas) / length,
        start,
        start + length,
    )


class _KnownInertial(QuantityModel):
    """Mass and inertia that are known better than by densities, as a file has them."""

    mass: float = quantity("kg", "mass of the part", gt=0)
    com: _Vector = quantity("m", "centre of mass")
    moments: _Vector = quantity("kg m2", "moments of inertia xx, yy, zz about the centre of mass")
    products: _Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="products of inertia xy, xz, yz about the centre of mass, kg m2",
    )


def _read_inertial(value: Any) -> Any:
    if isinstance(value, dict):
        return Inertial(**_KnownInertial.model_validate(value).model_dump())
    return value


_Known = Annotated[Inertial | None, BeforeValidator(_read_inertial)]


class TailGeometry(TailPart):
    """An arm with its plates; mass and inertia follow from the densities unless they are known
    better.

    Plates may cross or touch, but not lie on one another.
    """

    schema_: str = Field(default=SCHEMA, alias="schema", repr=False)
    name: str = quantity("1", "name of the tail", min_length=1, max_length=40)
    arm: TailArm
    plates: Annotated[tuple[Plate, ...], Field(strict=False, min_length=1)]
    arm_inertial: _Known = Field(
        default=None, description="mass and inertia of the arm in T, in place of its density's"
    )
    sail_inertial: _Known = Field(
        default=None,
        description="mass and inertia of all plates in T, in place of their densities'",
    )

    @model_validator(mode="after")
    def _fits_together(self) -> TailGeometry:
        require_unique([plate.name for plate in self.plates], f"tail {self.name!r}: plate name")
        for one, other in combinations(self.plates, 2):
            if any(
                overlap(a, b) and abs(gap(a, b)) < SAME_PLANE
                for a, b in product(one.pieces, other.pieces)
            ):
                raise ValueError(
                    f"tail {self.name!r}: plates {one.name!r} and {other.name!r} overlap: the air "
                    "would push twice on what they share; allowed: plates side by side, one behind "
                    "the other, or across each other"
                )
        return self

    def from_densities(self) -> TailGeometry:
        """Returns the same tail with mass and inertia from its densities alone."""
        return self.model_copy(update={"arm_inertial": None, "sail_inertial": None})

    @property
    def arm_mass(self) -> Inertial:
        """Mass and inertia of the arm in T."""
        return self.arm_inertial or inertial_of_inertia(self.arm.inertia)

    @property
    def sail_mass(self) -> Inertial:
        """Mass and inertia of all plates in T."""
        if self.sail_inertial:
            return self.sail_inertial
        return inertial_of_inertia(total_inertia(plate.inertia for plate in self.plates))

    @property
    def inertia(self) -> SpatialInertia:
        """Inertia of the whole tail about the origin of T."""
        return total_inertia((self.arm_mass.about_origin(), self.sail_mass.about_origin()))

    @property
    def inertial(self) -> Inertial:
        """Mass and inertia of the whole tail in T."""
        return inertial_of_inertia(self.inertia)

    @property
    def inertia_about_joints(self) -> FloatArray:
        """Inertia of the whole tail about the origin of T (3 x 3), kg m2."""
        return self.inertia.CalcRotationalInertia().CopyToFullMatrix3()

    @property
    def area(self) -> float:
        """Planform area of all plates, m2."""
        return sum(plate.area for plate in self.plates)

    def centre_of_pressure(self, direction: Sequence[float] | None = None) -> FloatArray:
        """Returns the centroid in T (3), m, of the planform seen along a direction, by default the
        first plate's normal; each piece counts with the cosine of its own normal's angle to it.

        Raises:
            ModelError: no plate faces that direction.
        """
        if direction is None:
            direction = self.plates[0].normal
        along = unit_vector(direction)
        pieces = [piece for plate in self.plates for piece in plate.pieces]
        areas = [abs(float(piece.normal @ along)) * piece.area for piece in pieces]
        if sum(areas) < 1e-12:
            raise ModelError(f"tail {self.name!r}: no plate faces the direction {tuple(direction)}")
        moment = sum(area * piece.centre for area, piece in zip(areas, pieces, strict=True))
        return np.asarray(moment / sum(areas))

    @property
    def points(self) -> FloatArray:
        """Ends of the arm and corners of all pieces in T (n, 3), m; a half shell with the crown of
        its round side.
        """
        points = [self.arm.points]
        for plate in self.plates:
            for piece in plate.pieces:
                points.append(piece.corners)
                if plate.kind == "half_shell":
                    points.append(piece.crown)
        return np.vstack(points)

    def section_layouts(self) -> list[SectionLayout]:
        """Returns the sections of all plates in T, for one `TailForce` each."""
        return [layout for plate in self.plates for layout in plate.section_layouts()]

    def added_mass_layout(self, parts: int = 5) -> SectionLayout:
        """Returns equal parts of the whole arm, for `add_added_mass`, in T; their normal and width
        mean nothing.

        Raises:
            ModelError: the arm is bent; added mass is modelled on a straight line.
        """
        axes = {as_tuple(unit_vector(axis)) for axis in self.arm.axes}
        if len(axes) > 1:
            raise ModelError(
                f"tail {self.name!r}: added mass needs a straight arm; this one is bent"
            )
        (axis,) = axes
        x, y, _ = np.eye(3)
        sideways = y if abs(axis[1]) < 0.9 else x
        normal = unit_vector(sideways - (sideways @ axis) * np.asarray(axis))
        return SectionLayout.strip(
            start=0.0, length=sum(self.arm.lengths), width=self.plates[0].chords[0], number=parts,
            axis_B=axis, normal_B=as_tuple(normal),
        )  # fmt: skip
