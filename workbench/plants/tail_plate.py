"""Plates and half shells of a tail: straight pieces, their outlines, and the sections where the air acts.

A plate is a row of straight pieces, each with a length, a direction and a width that goes linearly from end to end:
straight, tapered, bent or swept, piece by piece.

- Plate: flat, its mass spread evenly over the area, and over `depth` along the normal (0: thin).
- Half shell: a half cylinder, or half a cone where it tapers. Its opening lies on the row of pieces, the normal leaves
  the round side (as the sail in models/tail/tail.sdf), the material is pi/2 of the opening.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.errors import ModelError
from aerodima.workbench.plants.sdf_model import Inertial


@dataclass(frozen=True)
class MassMoments:
    """Mass (kg), first (3, kg m) and second moments (3 x 3, kg m2) about an origin."""

    mass: float
    first: np.ndarray
    second: np.ndarray

    @classmethod
    def zero(cls) -> MassMoments:
        """Of nothing."""
        return cls(0.0, np.zeros(3), np.zeros((3, 3)))

    @classmethod
    def of(cls, inertial: Inertial) -> MassMoments:
        """Of a body whose centre of mass and inertia about it are known."""
        inertia, com = inertial.matrix, np.asarray(inertial.com)
        about_com = np.trace(inertia) / 2 * np.eye(3) - inertia
        return cls(inertial.mass, inertial.mass * com, about_com + inertial.mass * np.outer(com, com))

    def __add__(self, other: MassMoments) -> MassMoments:
        return MassMoments(self.mass + other.mass, self.first + other.first, self.second + other.second)

    def moved(self, frame: np.ndarray, origin: np.ndarray) -> MassMoments:
        """The same body in another frame: `frame` has its own axes as columns (3 x 3), `origin` its origin (3), m."""
        first = frame @ self.first
        mixed = np.outer(origin, first)
        second = frame @ self.second @ frame.T + mixed + mixed.T + self.mass * np.outer(origin, origin)
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
    return 0.0 if abs(product) < 1e-14 * float(np.trace(inertia)) else float(product)


def rod_moments(density: float, length: float, radius: float) -> MassMoments:
    """A thin rod along z of `density` kg/m, with the moment m r^2 / 2 of a solid cylinder about its own axis."""
    mass = density * length
    # m r^2 / 2 about z is x^2 + y^2; as a thin rod's, its transverse moments leave that out.
    about_z = 0.5 * mass * radius**2
    second = np.diag([about_z / 2, about_z / 2, mass * length**2 / 3 - about_z / 2])
    return MassMoments(mass, np.array([0.0, 0.0, mass * length / 2]), second)


def plate_moments(density: float, length: float, chords: tuple[float, float], depth: float) -> MassMoments:
    """A flat trapezoid of `density` kg/m2, its mass spread evenly over `depth`."""
    near, far = chords
    mass = density * length * (near + far) / 2
    along = density * length**3 * (near + 3 * far) / 12
    across = density / 12 * length * (near + far) * (near**2 + far**2) / 4
    first = np.array([0.0, 0.0, density * length**2 * (near + 2 * far) / 6])
    return MassMoments(mass, first, np.diag([across, mass * depth**2 / 12, along]))


def shell_moments(
    density: float, length: float, chords: tuple[float, float], cap_density: float, closed: tuple[bool, bool]
) -> MassMoments:
    """Half a cone of `density` kg/m2, round towards +y, with half discs of `cap_density` at the closed ends."""
    near, far = chords[0] / 2, chords[1] / 2
    slant = density * math.hypot(1.0, (far - near) / length)
    mass = slant * math.pi * length * (near + far) / 2
    deep = slant * 2 * length * (near**2 + near * far + far**2) / 3
    along = slant * math.pi * length**2 * (near + 2 * far) / 6
    round_off = slant * math.pi / 2 * length * (near + far) * (near**2 + far**2) / 4
    second = np.diag([round_off, round_off, slant * math.pi * length**3 * (near + 3 * far) / 12])
    second[1, 2] = second[2, 1] = slant * 2 * length**2 * (near**2 + 2 * near * far + 3 * far**2) / 12
    total = MassMoments(mass, np.array([0.0, deep, along]), second)
    for radius, place, is_closed in zip((near, far), (0.0, length), closed, strict=True):
        if is_closed and cap_density > 0.0:
            disc = cap_density * math.pi * radius**2 / 2
            own = MassMoments(
                disc,
                np.array([0.0, disc * 4 * radius / (3 * math.pi), 0.0]),
                np.diag([disc * radius**2 / 4, disc * radius**2 / 4, 0.0]),
            )
            total = total + own.moved(np.eye(3), np.array([0.0, 0.0, place]))
    return total


Vector = tuple[float, float, float]

UP: Vector = (0.0, 0.0, 1.0)
"""z of the frame T: along a straight tail, from root to tip."""


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


@dataclass(frozen=True)
class Plate:
    """A plate or half shell, from root to tip.

    Attributes:
        name: in messages and drawings.
        root: middle of its near edge in T, m.
        lengths: of its straight pieces (n), m.
        chords: widths at the ends of the pieces (n + 1), m.
        normal: direction of its face; per piece its part across the piece counts.
        density: of the material, kg/m2.
        axes: directions of the pieces (n); one for all of them is enough.
        kind: `plate` or `half_shell`.
        depth: over which a plate's mass is spread along its normal, m; 0 for a thin one.
        cap_density: of half discs that close a half shell at both ends, kg/m2; 0 without.
        sections: parts of each piece where the air acts.

    Raises:
        ModelError: names plate, value and what is allowed.
    """

    name: str
    root: Vector
    lengths: tuple[float, ...]
    chords: tuple[float, ...]
    normal: Vector
    density: float
    axes: tuple[Vector, ...] = (UP,)
    kind: Literal["plate", "half_shell"] = "plate"
    depth: float = 0.0
    cap_density: float = 0.0
    sections: int = 5

    def __post_init__(self) -> None:
        count = len(self.lengths)
        if not count or len(self.chords) != count + 1 or len(self.axes) not in (1, count):
            raise ModelError(
                f"plate {self.name!r}: {count} lengths, {len(self.chords)} chords and {len(self.axes)} axes; allowed: "
                "n lengths from 1 on, n + 1 chords, and 1 or n axes"
            )
        above = [("length", self.lengths, "m"), ("chord", self.chords, "m"), ("density", (self.density,), "kg/m2")]
        for name, values, unit in above:
            require_above_zero(f"plate {self.name!r}: {name}", values, unit)
        for name, value in (("depth", self.depth), ("cap_density", self.cap_density)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ModelError(f"plate {self.name!r}: {name} is {value:g}; allowed: a finite number from 0 on")
        if self.kind not in ("plate", "half_shell"):
            raise ModelError(f"plate {self.name!r}: kind {self.kind!r}; allowed: plate, half_shell")
        wrong = ("depth", self.depth) if self.kind == "half_shell" else ("cap_density", self.cap_density)
        if wrong[1] > 0.0:
            raise ModelError(f"plate {self.name!r}: {wrong[0]} is {wrong[1]:g}; allowed: 0 for a {self.kind}")
        if self.sections != int(self.sections) or not 1 <= self.sections <= 100:
            raise ModelError(f"plate {self.name!r}: {self.sections} sections per piece; allowed: 1 to 100")
        require_vectors(f"plate {self.name!r}", (self.root,), (self.normal, *self.axes))
        for axis in self.axes:
            if np.linalg.norm(np.cross(unit_vector(axis), unit_vector(self.normal))) < 1e-3:
                raise ModelError(f"plate {self.name!r}: normal {self.normal} runs along its axis; allowed: across it")

    @property
    def pieces(self) -> list[Piece]:
        """Its straight pieces, from the root on."""
        pieces, start = [], np.asarray(self.root, float)
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
                own = shell_moments(self.density, piece.length, piece.chords, self.cap_density, closed)
            total = total + own.moved(frame, piece.start)
        return total

    def section_layouts(self) -> list[SectionLayout]:
        """Sections for `TailForce` in T: one layout per straight run, since those of a layout lie on one line."""
        runs: list[list[Piece]] = []
        for piece in self.pieces:
            if runs and np.linalg.norm(piece.axis - runs[-1][-1].axis) < 1e-12:
                runs[-1].append(piece)
            else:
                runs.append([piece])
        return [_layout(run, self.sections) for run in runs]


def _layout(run: list[Piece], sections: int) -> SectionLayout:
    """Sections on a straight run; distances count from T's origin where the run's line goes through it."""
    first = run[0]
    start = float(first.start @ first.axis)
    through_origin = start >= 0.0 and np.linalg.norm(first.start - start * first.axis) < 1e-12
    root, start = (np.zeros(3), start) if through_origin else (first.start, 0.0)
    axis, normal, p_BoRo_B = (as_tuple(value) for value in (first.axis, first.normal, root))
    length = sum(piece.length for piece in run)
    if len(run) == 1 and first.chords[0] == first.chords[1]:
        return SectionLayout.strip(
            start=start, length=length, width=first.chords[0], number=sections,
            p_BoRo_B=p_BoRo_B, axis_B=axis, normal_B=normal,
        )  # fmt: skip
    distances, areas, near = [], [], start
    for piece in run:
        part = piece.length / sections
        for inner, outer in pairwise(np.linspace(*piece.chords, sections + 1).tolist()):
            distances.append(near + part * (inner + 2 * outer) / (3 * (inner + outer)))
            areas.append(part * (inner + outer) / 2)
            near += part
    return SectionLayout(
        p_BoRo_B, axis, normal, tuple(distances), tuple(areas), sum(areas) / length, start, start + length
    )


def gap(one: Piece, other: Piece) -> float:
    """Distance of the other piece's middle ahead of the first one's plane, m; infinite where their normals differ."""
    if abs(float(one.normal @ other.normal)) < 0.99:
        return math.inf
    return float(one.normal @ (other.centre - one.start))


def overlap(one: Piece, other: Piece) -> bool:
    """Whether two outlines share area, seen along the first one's normal (separating axes of convex outlines)."""
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


def require_above_zero(where: str, values: Sequence[float], unit: str) -> None:
    """Raises ModelError naming the first value that is not a finite number above 0."""
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise ModelError(f"{where} is {value:g} {unit}; allowed: a finite number above 0")


def require_vectors(where: str, points: Sequence[Vector], directions: Sequence[Vector]) -> None:
    """Raises ModelError naming what is not three finite numbers, or a direction of no length."""
    for vector in (*points, *directions):
        if len(vector) != 3 or not np.all(np.isfinite(vector)):
            raise ModelError(f"{where}: {vector} is no vector; allowed: three finite numbers")
    for vector in directions:
        if np.linalg.norm(vector) < 1e-9:
            raise ModelError(f"{where}: direction {vector} has no length; allowed: any but zero")


def unit_vector(vector: Sequence[float] | np.ndarray) -> np.ndarray:
    """The vector (3) over its length."""
    values = np.asarray(vector, float)
    return np.asarray(values / np.linalg.norm(values))


def as_tuple(values: np.ndarray) -> Vector:
    """Three floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
