"""Where the air acts: sections along the straight axis of a body, and the air itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.workbench.errors import ModelError


@dataclass(frozen=True)
class Air:
    """Properties of the air; defaults from thesis section 4.9 (`models/published/constants.csv`; ERRATA E13).

    Attributes:
        density: kg/m3.
        viscosity: dynamic viscosity, kg/(m s).
    """

    density: float = 1.225
    viscosity: float = 1.849e-5

    def __post_init__(self) -> None:
        for name in ("density", "viscosity"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(f"air: {name} is {value}, but it must be a finite number above 0")


@dataclass(frozen=True)
class SectionLayout:
    """Sections on a straight line through a body B: R is the root of the line, S_i the centre of section i.

    Attributes:
        p_BoRo_B: root of the section axis in the body frame (3), m.
        axis_B: a_B, unit vector from root to tip (3).
        normal_B: n_B, unit vector normal to the flat sail (3), perpendicular to a_B. The polar law does not use it.
        distances: of the section centres from the root (n), m.
        areas: planform area of each section (n), m2; no cosine (design section 5, ERRATA E40).
        chord: width that the Reynolds number is made with, m.
        start, end: of the sectioned length, distances from the root, m.

    Raises:
        ModelError: no sections, a length, width or area that is not above zero, or axes that are not perpendicular.
    """

    p_BoRo_B: tuple[float, float, float]
    axis_B: tuple[float, float, float]
    normal_B: tuple[float, float, float]
    distances: tuple[float, ...]
    areas: tuple[float, ...]
    chord: float
    start: float
    end: float

    def __post_init__(self) -> None:
        if len(self.distances) < 1:
            raise ModelError("section layout: the number of sections is 0, but it must be at least 1")
        if len(self.areas) != len(self.distances):
            raise ModelError(f"section layout: {len(self.areas)} areas for {len(self.distances)} section centres")
        for name, value in [("chord", self.chord), *(("area", area) for area in self.areas)]:
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(f"section layout: {name} is {value}, but it must be a finite number above 0")
        if not np.all(np.isfinite([*self.p_BoRo_B, *self.distances, self.start, self.end])):
            raise ModelError("section layout: positions and distances must be finite numbers")
        axis, normal = np.asarray(self.axis_B, float), np.asarray(self.normal_B, float)
        if abs(np.linalg.norm(axis) - 1.0) > 1e-9 or abs(np.linalg.norm(normal) - 1.0) > 1e-9:
            raise ModelError("section layout: axis_B and normal_B must be unit vectors")
        if abs(axis @ normal) > 1e-9:
            raise ModelError("section layout: normal_B must be perpendicular to axis_B")

    @property
    def number(self) -> int:
        """Number of sections."""
        return len(self.distances)

    @property
    def p_BoSi_B(self) -> np.ndarray:
        """Section centres in the body frame (n, 3), m."""
        return np.asarray(self.p_BoRo_B) + np.outer(self.distances, self.axis_B)

    @property
    def p_BoTip_B(self) -> np.ndarray:
        """Tip of the sectioned length in the body frame (3), m."""
        return np.asarray(self.p_BoRo_B) + self.end * np.asarray(self.axis_B)

    def motion(
        self, X_WB: Any, w_WB: Any, v_WBo: Any, v_WA: Any
    ) -> tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]:
        """What a `SectionLaw` asks of the motion of a line of sections on a body, for floats and for AutoDiffXd alike.

        Args:
            X_WB: pose of the body, three rows whose first three numbers are those of R_WB.
            w_WB, v_WBo: angular velocity (3), rad/s, and velocity of the body origin (3), m/s, in W.
            v_WA: velocity of the air in W (3), m/s; None in still air.

        Returns:
            Axis a and normal n in W; u, m/s, and k, 1/s, of the relative velocity u + s k at s from the root.
        """
        x_row, y_row, z_row = X_WB
        r00, r01, r02 = x_row[0], x_row[1], x_row[2]
        r10, r11, r12 = y_row[0], y_row[1], y_row[2]
        r20, r21, r22 = z_row[0], z_row[1], z_row[2]
        w_x, w_y, w_z = w_WB
        v_x, v_y, v_z = v_WBo
        x, y, z = self.axis_B
        a_x, a_y, a_z = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z, r20 * x + r21 * y + r22 * z
        x, y, z = self.normal_B
        n = (r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z, r20 * x + r21 * y + r22 * z)
        x, y, z = self.p_BoRo_B
        if x != 0.0 or y != 0.0 or z != 0.0:
            p_x, p_y, p_z = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z, r20 * x + r21 * y + r22 * z
            v_x += w_y * p_z - w_z * p_y
            v_y += w_z * p_x - w_x * p_z
            v_z += w_x * p_y - w_y * p_x
        k = (a_y * w_z - a_z * w_y, a_z * w_x - a_x * w_z, a_x * w_y - a_y * w_x)  # -(w x a)
        air_x, air_y, air_z = (0.0, 0.0, 0.0) if v_WA is None else v_WA
        return (a_x, a_y, a_z), n, (air_x - v_x, air_y - v_y, air_z - v_z), k

    def root_in(self, R_WB: Any) -> tuple[Any, Any, Any]:
        """Root of the line from the body's origin in W (3), m, for rows as in `motion`."""
        x, y, z = self.p_BoRo_B
        r_x, r_y, r_z = (row[0] * x + row[1] * y + row[2] * z for row in R_WB)
        return r_x, r_y, r_z

    @classmethod
    def strip(
        cls,
        *,
        start: float,
        length: float,
        width: float,
        number: int = 5,
        p_BoRo_B: tuple[float, float, float] = (0.0, 0.0, 0.0),
        axis_B: tuple[float, float, float] = (0.0, 0.0, 1.0),
        normal_B: tuple[float, float, float] = (1.0, 0.0, 0.0),
    ) -> SectionLayout:
        """A flat strip of equal sections: a cheetah tail, a bar, the robot's sail. By default it points up, facing x.

        Args:
            start: distance of the strip's near end from the root along the axis, m.
            length: of the strip, m.
            width: of the strip, m; the major width for a cheetah tail, the sail width for the robot tail.
            number: of equal sections.
        """
        if int(number) != number or number < 1:
            raise ModelError(
                f"section layout: the number of sections is {number}, but it must be a whole number from 1"
            )
        for name, value in (("length", length), ("width", width)):
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(f"section layout: {name} is {value} m, but it must be a finite number above 0")
        part = length / number
        return cls(
            p_BoRo_B=p_BoRo_B,
            axis_B=axis_B,
            normal_B=normal_B,
            distances=tuple(start + (i + 0.5) * part for i in range(number)),
            areas=(part * width,) * number,
            chord=width,
            start=start,
            end=start + length,
        )

    @classmethod
    def robot_tail(
        cls,
        *,
        start: float,
        length: float,
        width: float,
        number: int = 5,
        p_BoRo_B: tuple[float, float, float] = (0.0, 0.0, 0.0),
        axis_B: tuple[float, float, float] = (0.0, 0.0, 1.0),
        normal_B: tuple[float, float, float] = (0.0, 1.0, 0.0),
    ) -> SectionLayout:
        """The car's tail: axis along +z of the tail body (up at zero angles), sail facing sideways (+-y).

        A roll of the tail about +x therefore moves the sail broadside; a pitch moves it edge-on.
        """
        return cls.strip(
            start=start, length=length, width=width, number=number, p_BoRo_B=p_BoRo_B, axis_B=axis_B, normal_B=normal_B
        )
