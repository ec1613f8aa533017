"""Straight pieces of plates: their outline, and whether two of them lie on one another."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerodima.workbench.core.array_types import FloatArray, Pair, Vector3

_SHORT_EDGE = 1e-9
"""An edge of an outline shorter than this is a corner, m."""
_TOUCH = 1e-6
"""Outlines that overlap by less than this touch, m."""


@dataclass(frozen=True)
class Piece:
    """A straight piece of a plate.

    Attributes:
        start: middle of its near edge in T, m.
        axis, normal, across: unit vectors; the outline lies in the plane of axis and across.
        length: length along the axis, m.
        chords: widths at the near and at the far end, m.
    """

    start: FloatArray
    axis: FloatArray
    normal: FloatArray
    across: FloatArray
    length: float
    chords: Pair

    @property
    def area(self) -> float:
        """Planform area, m2."""
        return self.length * (self.chords[0] + self.chords[1]) / 2

    @property
    def end(self) -> FloatArray:
        """Middle of its far edge in T (3), m."""
        return self.start + self.length * self.axis

    @property
    def centre(self) -> FloatArray:
        """Centroid of the planform in T (3), m."""
        return self.start + trapezoid_centre(self.length, *self.chords) * self.axis

    @property
    def corners(self) -> FloatArray:
        """Outline in T (4, 3), m, in order."""
        near, far = (chord / 2 * self.across for chord in self.chords)
        return np.array([self.start - near, self.start + near, self.end + far, self.end - far])

    @property
    def crown(self) -> FloatArray:
        """Ends in T (2, 3), m, of the line along which a half shell is deepest."""
        return np.array([self.start, self.end]) + np.outer(self.chords, self.normal) / 2


def trapezoid_centre(length: float, near: float, far: float) -> float:
    """Returns the distance of a trapezoid's centroid from its near edge; all lengths in m."""
    return length * (near + 2 * far) / (3 * (near + far))


def gap(one: Piece, other: Piece) -> float:
    """Returns the distance of the other piece's middle ahead of the first one's plane, m; infinite
    where their normals differ.
    """
    if abs(float(one.normal @ other.normal)) < 0.99:
        return math.inf
    return float(one.normal @ (other.centre - one.start))


def overlap(one: Piece, other: Piece) -> bool:
    """Tells whether two outlines share area, seen along the first one's normal (separating axes of
    convex outlines).
    """
    plane = np.column_stack([one.across, one.axis])
    shapes = [piece.corners @ plane for piece in (one, other)]
    for shape in shapes:
        for x, y in np.roll(shape, -1, axis=0) - shape:
            edge = math.hypot(x, y)
            if edge < _SHORT_EDGE:
                continue
            first, second = (points @ np.array([-y, x]) / edge for points in shapes)
            if min(first.max() - second.min(), second.max() - first.min()) < _TOUCH:
                return False
    return True


def unit_vector(vector: Sequence[float] | FloatArray) -> FloatArray:
    """Returns the vector (3) divided by its length."""
    values = np.asarray(vector, float)
    return np.asarray(values / np.linalg.norm(values))


def as_tuple(values: FloatArray) -> Vector3:
    """Returns three values as a tuple of floats."""
    x, y, z = values.tolist()
    return x, y, z
