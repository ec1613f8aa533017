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

All integrals are closed forms. Areas are planform areas. The centre of pressure is that of even
pressure, which is where sections put the force of a steady broadside wind; how it moves with the
angle of attack is not modelled. Sections do not shade one another. Behind a plate with C_D the air
is slower by 0.976 sqrt(C_D c / x) of its speed, x behind a chord c (Schlichting, Boundary-Layer
Theory): a second row of plates is worth less than its sections say.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.key_errors import lines_of
from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.core.sdf_model import Inertial

SCHEMA: Literal["aerodima/tail/1"] = "aerodima/tail/1"

SAME_PLANE = 1e-3
"""m; plates nearer than this, measured along their normal, count as lying in one plane."""
Vector = tuple[float, float, float]
UP: Vector = (0.0, 0.0, 1.0)
"""z of the frame T: along a straight tail, from root to tip."""
_Vector = Annotated[Vector, Field(strict=False)]
_Sizes = Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(strict=False, min_length=1)]


@dataclass(frozen=True)
class MassMoments:
    """Mass (kg), first (3, kg m) and second moments (3 x 3, kg m2) about an origin."""

    mass: float
    first: np.ndarray
    second: np.ndarray

    @classmethod
    def zero(cls) -> MassMoments:
        """The moments of no mass."""
        return cls(0.0, np.zeros(3), np.zeros((3, 3)))

    @classmethod
    def of(cls, inertial: Inertial) -> MassMoments:
        """The moments of a body whose centre of mass and inertia about it are known."""
        inertia = inertial.matrix
        com = np.asarray(inertial.com)
        about_com = np.trace(inertia) / 2 * np.eye(3) - inertia
        return cls(
            inertial.mass, inertial.mass * com, about_com + inertial.mass * np.outer(com, com)
        )

    def __add__(self, other: MassMoments) -> MassMoments:
        return MassMoments(
            self.mass + other.mass, self.first + other.first, self.second + other.second
        )

    def moved(self, frame: np.ndarray, origin: np.ndarray) -> MassMoments:
        """The same body in another frame: `frame` has its own axes as columns (3 x 3), `origin` its
        origin (3), m.
        """
        first = frame @ self.first
        mixed = np.outer(origin, first)
        second = (
            frame @ self.second @ frame.T + mixed + mixed.T + self.mass * np.outer(origin, origin)
        )
        return MassMoments(self.mass, first + self.mass * origin, second)

    def inertial(self) -> Inertial:
        """Mass, centre of mass, and inertia about it."""
        com = self.first / self.mass
        second = self.second - np.outer(self.first, com)
        inertia = np.trace(second) * np.eye(3) - second
        x, y, z = com.tolist()
        xx, yy, zz = np.diag(inertia).tolist()
        xy, xz, yz = (_whole(inertia[i, j], inertia) for i, j in ((0, 1), (0, 2), (1, 2)))
        return Inertial(self.mass, (x, y, z), (xx, yy, zz), (xy, xz, yz))


def _whole(product: float, inertia: np.ndarray) -> float:
    """A product of inertia; that of a symmetric body, which is rounding, as 0."""
    if abs(product) < 1e-14 * float(np.trace(inertia)):
        return 0.0
    return float(product)


def rod_moments(density: float, length: float, radius: float) -> MassMoments:
    """A thin rod along z of `density` kg/m, with the moment m r^2 / 2 of a solid cylinder about its
    own axis.
    """
    mass = density * length
    # m r^2 / 2 about z is x^2 + y^2; as a thin rod's, its transverse moments leave that out.
    about_z = 0.5 * mass * radius**2
    second = np.diag([about_z / 2, about_z / 2, mass * length**2 / 3 - about_z / 2])
    return MassMoments(mass, np.array([0.0, 0.0, mass * length / 2]), second)


def plate_moments(
    density: float, length: float, chords: tuple[float, float], depth: float
) -> MassMoments:
    """A flat trapezoid of `density` kg/m2, its mass spread evenly over `depth`."""
    near, far = chords
    mass = density * length * (near + far) / 2
    along = density * length**3 * (near + 3 * far) / 12
    across = density / 12 * length * (near + far) * (near**2 + far**2) / 4
    first = np.array([0.0, 0.0, density * length**2 * (near + 2 * far) / 6])
    return MassMoments(mass, first, np.diag([across, mass * depth**2 / 12, along]))


def shell_moments(
    density: float,
    length: float,
    chords: tuple[float, float],
    cap_density: float,
    closed: tuple[bool, bool],
) -> MassMoments:
    """Half a cone of `density` kg/m2, round towards +y, with half discs of `cap_density` at the
    closed ends.
    """
    near = chords[0] / 2
    far = chords[1] / 2
    slant = density * math.hypot(1.0, (far - near) / length)
    around = slant * math.pi
    mass = around * length * (near + far) / 2
    deep = slant * 2 * length * (near**2 + near * far + far**2) / 3
    along = around * length**2 * (near + 2 * far) / 6
    across = around / 2 * length * (near + far) * (near**2 + far**2) / 4
    second = np.diag([across, across, around * length**3 * (near + 3 * far) / 12])
    mixed = slant * 2 * length**2 * (near**2 + 2 * near * far + 3 * far**2) / 12
    second[1, 2] = mixed
    second[2, 1] = mixed
    total = MassMoments(mass, np.array([0.0, deep, along]), second)
    for radius, place, is_closed in zip((near, far), (0.0, length), closed, strict=True):
        if is_closed and cap_density > 0.0:
            mass = cap_density * math.pi * radius**2 / 2
            first = np.array([0.0, mass * 4 * radius / (3 * math.pi), 0.0])
            square = mass * radius**2 / 4
            disc = MassMoments(mass, first, np.diag([square, square, 0.0]))
            total = total + disc.moved(np.eye(3), np.array([0.0, 0.0, place]))
    return total


@dataclass(frozen=True)
class Piece:
    """One straight piece of a plate.

    Attributes:
        start: middle of its near edge in T, m.
        axis, normal, across: unit vectors; the outline lies in the plane of axis and across.
        length: m.
        chords: widths at the near and at the far end, m.
    """

    start: np.ndarray
    axis: np.ndarray
    normal: np.ndarray
    across: np.ndarray
    length: float
    chords: tuple[float, float]

    @property
    def area(self) -> float:
        """Planform, m2."""
        return self.length * (self.chords[0] + self.chords[1]) / 2

    @property
    def centre(self) -> np.ndarray:
        """Centroid of the planform in T (3), m."""
        near, far = self.chords
        return self.start + self.length * (near + 2 * far) / (3 * (near + far)) * self.axis

    @property
    def corners(self) -> np.ndarray:
        """Outline in T (4, 3), m, in order."""
        near, far = (chord / 2 * self.across for chord in self.chords)
        end = self.start + self.length * self.axis
        return np.array([self.start - near, self.start + near, end + far, end - far])


def _with_length(vector: Vector) -> Vector:
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
    """The rod that carries the plates: straight pieces from the origin of T, thin, of even mass."""

    lengths: _Sizes = quantity("m", "of its straight pieces from the joints on")
    density: float = quantity("kg/m", "mass over length", gt=0)
    radius: float = quantity(
        "m", "drawn, and for its moment about its own axis", default=0.006, gt=0
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
    def points(self) -> np.ndarray:
        """Ends of its pieces in T (n + 1, 3), m, from the origin on."""
        steps = [
            length * unit_vector(self.axes[n % len(self.axes)])
            for n, length in enumerate(self.lengths)
        ]
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


class Plate(TailPart):
    """A plate or half shell, from root to tip."""

    name: str = quantity("1", "in messages and drawings", min_length=1, max_length=40)
    root: _Vector = quantity("m", "middle of its near edge in T")
    lengths: _Sizes = quantity("m", "of its straight pieces")
    chords: _Sizes = quantity("m", "widths at the ends of the pieces, one more than these")
    normal: _Direction = quantity(
        "1", "of the face, of a half shell out of its round side; the part across a piece counts"
    )
    density: float = quantity("kg/m2", "mass over area of the material", gt=0)
    axes: _Directions = Field(
        default=(UP,), description="directions of the pieces; one is enough where all are alike"
    )
    kind: Literal["plate", "half_shell"] = Field(
        default="plate", description="flat, or a half cylinder"
    )
    depth: float = quantity(
        "m", "over which a plate's mass is spread along its normal", default=0.0, ge=0
    )
    cap_density: float = quantity(
        "kg/m2", "of half discs at both ends of a half shell", default=0.0, ge=0
    )
    sections: int = Field(default=5, description="of each piece, where the air acts", ge=1, le=100)

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
            if np.linalg.norm(np.cross(unit_vector(axis), unit_vector(self.normal))) < 1e-3:
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
            start = start + length * axis
        return pieces

    @property
    def area(self) -> float:
        """Planform, m2: of a half shell that of its opening."""
        return sum(piece.area for piece in self.pieces)

    @property
    def centre_of_pressure(self) -> np.ndarray:
        """Centroid of the planform in T (3), m."""
        return np.asarray(sum(piece.area * piece.centre for piece in self.pieces) / self.area)

    @property
    def moments(self) -> MassMoments:
        """Mass and its moments from the densities."""
        total = MassMoments.zero()
        pieces = self.pieces
        for number, piece in enumerate(pieces):
            frame = np.column_stack([piece.across, piece.normal, piece.axis])
            if self.kind == "plate":
                own = plate_moments(self.density, piece.length, piece.chords, self.depth)
            else:
                closed = (number == 0, number == len(pieces) - 1)
                own = shell_moments(
                    self.density, piece.length, piece.chords, self.cap_density, closed
                )
            total = total + own.moved(frame, piece.start)
        return total

    def section_layouts(self) -> list[SectionLayout]:
        """Sections for `TailForce` in T: one layout per straight run, since those of a layout lie
        on one line.
        """
        runs: list[list[Piece]] = []
        for piece in self.pieces:
            if runs and np.linalg.norm(piece.axis - runs[-1][-1].axis) < 1e-12:
                runs[-1].append(piece)
            else:
                runs.append([piece])
        return [_layout(run, self.sections) for run in runs]


def _layout(run: list[Piece], sections: int) -> SectionLayout:
    """Sections on a straight run; distances count from T's origin if the run's line meets it."""
    first = run[0]
    start = float(first.start @ first.axis)
    through_origin = start >= 0.0 and np.linalg.norm(first.start - start * first.axis) < 1e-12
    root = np.zeros(3)
    if not through_origin:
        root = first.start
        start = 0.0
    axis = as_tuple(first.axis)
    normal = as_tuple(first.normal)
    p_BoRo_B = as_tuple(root)
    length = sum(piece.length for piece in run)
    if len(run) == 1 and first.chords[0] == first.chords[1]:
        return SectionLayout.strip(
            start=start, length=length, width=first.chords[0], number=sections,
            p_BoRo_B=p_BoRo_B, axis_B=axis, normal_B=normal,
        )  # fmt: skip
    distances = []
    areas = []
    near = start
    for piece in run:
        part = piece.length / sections
        for inner, outer in pairwise(np.linspace(*piece.chords, sections + 1).tolist()):
            distances.append(near + part * (inner + 2 * outer) / (3 * (inner + outer)))
            areas.append(part * (inner + outer) / 2)
            near += part
    return SectionLayout(
        p_BoRo_B,
        axis,
        normal,
        tuple(distances),
        tuple(areas),
        sum(areas) / length,
        start,
        start + length,
    )


def gap(one: Piece, other: Piece) -> float:
    """Distance of the other piece's middle ahead of the first one's plane, m; infinite where their
    normals differ.
    """
    if abs(float(one.normal @ other.normal)) < 0.99:
        return math.inf
    return float(one.normal @ (other.centre - one.start))


def overlap(one: Piece, other: Piece) -> bool:
    """Whether two outlines share area, seen along the first one's normal (separating axes of convex
    outlines).
    """
    plane = np.column_stack([one.across, one.axis])
    shapes = [piece.corners @ plane for piece in (one, other)]
    for shape in shapes:
        for edge in np.roll(shape, -1, axis=0) - shape:
            if np.linalg.norm(edge) < 1e-9:
                continue
            side = np.array([-edge[1], edge[0]]) / np.linalg.norm(edge)
            first, second = (points @ side for points in shapes)
            if first.max() < second.min() + 1e-6 or second.max() < first.min() + 1e-6:
                return False
    return True


class _KnownInertial(QuantityModel):
    """Mass and inertia that are known better than by densities, as a file has them."""

    mass: float = quantity("kg", "of the part", gt=0)
    com: _Vector = quantity("m", "centre of mass")
    moments: _Vector = quantity("kg m2", "xx, yy, zz about that centre")
    products: _Vector = Field(
        default=(0.0, 0.0, 0.0), description="xy, xz, yz about that centre, kg m2"
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

    schema_: Literal["aerodima/tail/1"] = Field(default=SCHEMA, alias="schema", repr=False)
    name: str = quantity("1", "of the tail", min_length=1, max_length=40)
    arm: TailArm
    plates: Annotated[tuple[Plate, ...], Field(strict=False, min_length=1)]
    arm_inertial: _Known = Field(
        default=None, description="of the arm in T, in place of its density's"
    )
    sail_inertial: _Known = Field(
        default=None, description="of all plates in T, in place of their densities'"
    )

    @model_validator(mode="after")
    def _fits_together(self) -> TailGeometry:
        names = [plate.name for plate in self.plates]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"tail {self.name!r}: plate name {twice[0]!r} is used twice; allowed: a name each"
            )
        for one, other in combinations(self.plates, 2):
            if any(
                overlap(a, b) and abs(gap(a, b)) < SAME_PLANE
                for a in one.pieces
                for b in other.pieces
            ):
                raise ValueError(
                    f"tail {self.name!r}: plates {one.name!r} and {other.name!r} overlap: the air "
                    "would push twice on what they share; allowed: plates side by side, one behind "
                    "the other, or across each other"
                )
        return self

    def from_densities(self) -> TailGeometry:
        """The same tail with mass and inertia from its densities alone."""
        return self.model_copy(update={"arm_inertial": None, "sail_inertial": None})

    @property
    def arm_mass(self) -> Inertial:
        """Mass and inertia of the arm in T."""
        return self.arm_inertial or self.arm.moments.inertial()

    @property
    def sail_mass(self) -> Inertial:
        """Mass and inertia of all plates in T."""
        if self.sail_inertial:
            return self.sail_inertial
        return sum((plate.moments for plate in self.plates), MassMoments.zero()).inertial()

    @property
    def inertial(self) -> Inertial:
        """Mass and inertia of the whole tail in T."""
        return (MassMoments.of(self.arm_mass) + MassMoments.of(self.sail_mass)).inertial()

    @property
    def inertia_about_joints(self) -> np.ndarray:
        """Inertia of the whole tail about the origin of T (3 x 3), kg m2."""
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
        """Centroid in T (3), m, of the planform seen along a direction, by default the first
        plate's normal.

        Raises:
            ModelError: no plate faces that direction.
        """
        if direction is None:
            direction = self.plates[0].normal
        seen = self.facing_area(direction)
        if seen < 1e-12:
            raise ModelError(f"tail {self.name!r}: no plate faces the direction {tuple(direction)}")
        moment = sum(
            facing * piece.area * piece.centre for facing, piece in self._facing(direction)
        )
        return np.asarray(moment / seen)

    def _facing(self, direction: Sequence[float]) -> list[tuple[float, Piece]]:
        along = unit_vector(direction)
        return [
            (abs(float(piece.normal @ along)), piece)
            for plate in self.plates
            for piece in plate.pieces
        ]

    @property
    def points(self) -> np.ndarray:
        """Ends of the arm and corners of all pieces in T (n, 3), m; a half shell with the crown of
        its round side.
        """
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
        """Equal parts of the whole arm, for `add_added_mass`, in T; their normal and width mean
        nothing.

        Raises:
            ModelError: a bent arm: added mass is modelled on a straight line.
        """
        axes = {as_tuple(unit_vector(axis)) for axis in self.arm.axes}
        if len(axes) > 1:
            raise ModelError(
                f"tail {self.name!r}: added mass needs a straight arm; this one is bent"
            )
        (axis,) = axes
        if abs(axis[1]) < 0.9:
            sideways = np.eye(3)[1]
        else:
            sideways = np.eye(3)[0]
        normal = unit_vector(sideways - (sideways @ axis) * np.asarray(axis))
        return SectionLayout.strip(
            start=0.0, length=sum(self.arm.lengths), width=self.plates[0].chords[0], number=parts,
            axis_B=axis, normal_B=as_tuple(normal),
        )  # fmt: skip


def unit_vector(vector: Sequence[float] | np.ndarray) -> np.ndarray:
    """The vector (3) over its length."""
    values = np.asarray(vector, float)
    return np.asarray(values / np.linalg.norm(values))


def as_tuple(values: np.ndarray) -> Vector:
    """Three floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
