"""Mass and inertia of the parts of a tail: rods, plates and half shells of even material.

A part lies along z from its near end on, and its width goes linearly from end to end. Plates and
half shells are summed from slices across z at the two points of Gauss and Legendre, which is exact:
no integrand is of more than third order.
"""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.tree import SpatialInertia, UnitInertia

from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.sdf_model import Inertial

Chords = Pair
"""Widths of a piece at its near and far end, m."""
_GAUSS = (0.5 - math.sqrt(1.0 / 12.0), 0.5 + math.sqrt(1.0 / 12.0))
"""Points of Gauss and Legendre between 0 and 1, of half the weight each."""
_ROUNDING = 1e-14
"""Products of inertia below this share of the trace are rounding of a symmetric body."""


class Slice(NamedTuple):
    """A thin slice across z, symmetric about x = 0.

    Attributes:
        place: z of the slice, m.
        mass: mass, kg.
        depth: first moment, sum of mass times y, kg m.
        across, through: second moments, sums of mass times x^2 and times y^2, kg m2.
    """

    place: float
    mass: float
    depth: float
    across: float
    through: float


def rod_inertia(density: float, length: float, radius: float) -> SpatialInertia:
    """Returns the inertia of a thin rod of `density` kg/m about its near end, with the moment
    m r^2 / 2 of a solid cylinder about its own axis.
    """
    mass = density * length
    # m r^2 / 2 about z is x^2 + y^2; the transverse moments, those of a thin rod, leave that out.
    square = 0.25 * mass * radius**2
    second = np.diag([square, square, mass * length**2 / 3 - square])
    return _inertia_of_moments(mass, np.array([0.0, 0.0, mass * length / 2]), second)


def plate_inertia(density: float, length: float, chords: Chords, depth: float) -> SpatialInertia:
    """Returns the inertia of a flat trapezoid of `density` kg/m2 about the middle of its near end,
    its mass spread evenly over `depth` along y.
    """
    slices = []
    for place, chord in _gauss_points(length, chords):
        mass = density * chord * length / 2
        slices.append(Slice(place, mass, 0.0, mass * chord**2 / 12, mass * depth**2 / 12))
    return _inertia_of_slices(slices)


def shell_inertia(
    density: float,
    length: float,
    chords: Chords,
    cap_density: float,
    closed: tuple[bool, bool],
) -> SpatialInertia:
    """Returns the inertia of half a cone of `density` kg/m2 about the middle of its near end, round
    towards +y, with half discs of `cap_density` at the closed ends.
    """
    slant = math.hypot(1.0, (chords[1] - chords[0]) / 2 / length)
    slices = []
    for place, chord in _gauss_points(length, chords):
        radius = chord / 2
        mass = density * slant * math.pi * radius * length / 2
        square = mass * radius**2 / 2
        slices.append(Slice(place, mass, mass * 2 * radius / math.pi, square, square))
    for place, chord, is_closed in zip((0.0, length), chords, closed, strict=True):
        if is_closed:
            radius = chord / 2
            mass = cap_density * math.pi * radius**2 / 2
            square = mass * radius**2 / 4
            slices.append(Slice(place, mass, mass * 4 * radius / (3 * math.pi), square, square))
    return _inertia_of_slices(slices)


def placed(inertia: SpatialInertia, frame: RotationMatrix, origin: FloatArray) -> SpatialInertia:
    """Returns the inertia of a part about the origin of T, in the axes of T; `frame` and `origin`
    (3, m) place the part there.
    """
    return inertia.ReExpress(frame).Shift(-origin)


def total_inertia(parts: Iterable[SpatialInertia]) -> SpatialInertia:
    """Returns the inertia of parts together, about the same point and in the same axes."""
    total = SpatialInertia.Zero()
    for part in parts:
        total += part
    return total


def inertial_of_inertia(inertia: SpatialInertia) -> Inertial:
    """Returns mass, centre of mass, and inertia about that centre."""
    com = inertia.get_com()
    central = inertia.Shift(com).CalcRotationalInertia().CopyToFullMatrix3()
    central[np.abs(central) < _ROUNDING * np.trace(central)] = 0.0
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = central.tolist()
    x, y, z = com.tolist()
    return Inertial(inertia.get_mass(), (x, y, z), (xx, yy, zz), (xy, xz, yz))


def _gauss_points(length: float, chords: Chords) -> Iterator[Pair]:
    """Yields place (m) and width (m) of the two slices, each of half the length."""
    near, far = chords
    for share in _GAUSS:
        yield share * length, near + share * (far - near)


def _inertia_of_slices(slices: Iterable[Slice]) -> SpatialInertia:
    mass = 0.0
    first = np.zeros(3)
    second = np.zeros((3, 3))
    for part in slices:
        mixed = part.place * part.depth
        along = part.place**2 * part.mass
        mass += part.mass
        first += [0.0, part.depth, part.place * part.mass]
        second += [[part.across, 0.0, 0.0], [0.0, part.through, mixed], [0.0, mixed, along]]
    return _inertia_of_moments(mass, first, second)


def _inertia_of_moments(mass: float, first: FloatArray, second: FloatArray) -> SpatialInertia:
    """Makes the inertia about the origin from mass (kg), first moments (3, kg m) and second moments
    (3 x 3).
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (second / mass).tolist()
    unit = UnitInertia(yy + zz, xx + zz, xx + yy, -xy, -xz, -yz)
    return SpatialInertia(mass, first / mass, unit)
