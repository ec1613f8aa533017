"""Mass with its first and second moments, in closed form for rods, plates and half shells.

Second moments P = integral of r r^T dm add and move without the parallel-axis bookkeeping of inertias; the inertia is
tr(P) 1 - P. Own axes of a piece: x across, y along its normal, z along its axis, origin in the middle of its near edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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
