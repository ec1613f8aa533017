"""Sections along the straight axis of a body, where the air acts, and the part of them inside the
jet of a tunnel.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.workbench.aero.section_laws import (
    LineMotion,
    add_cross,
    check_above_zero,
    cross,
    rotated,
)
from aerodima.workbench.core.array_types import FloatArray, Vector3
from aerodima.workbench.core.errors import ModelError

_STILL_AIR = (0.0, 0.0, 0.0)
"""Velocity of air that does not move, m/s."""
_UNIT_ERROR = 1e-9
"""How far a unit vector may be from a length of 1, and normal vectors from a right angle."""
_SAMPLES = 1000
"""Number of positions at which a layout is looked for in the jet."""


@dataclass(frozen=True)
class Air:
    """Properties of the air; defaults from thesis section 4.9 (`models/published/constants.csv`;
    ERRATA E13).

    Attributes:
        density: density, kg/m3.
        viscosity: dynamic viscosity, kg/(m s).
    """

    density: float = 1.225
    viscosity: float = 1.849e-5

    def __post_init__(self) -> None:
        check_above_zero("air: density", self.density, unit="kg/m3")
        check_above_zero("air: viscosity", self.viscosity, unit="kg/(m s)")


@dataclass(frozen=True)
class SectionLayout:
    """Sections on a straight line through a body B: R is the root of the line, S_i the centre of
    section i.

    Attributes:
        p_BoRo_B: root of the section axis in the body frame (3), m.
        axis_B: unit vector a_B from root to tip (3).
        normal_B: unit vector n_B normal to the flat sail (3), perpendicular to a_B. The polar law
            does not use it.
        distances: distances of the section centres from the root (n), m.
        areas: planform area of each section (n), m2; no cosine (design section 5, ERRATA E40).
        chord: width on which the Reynolds number is based, m.
        start, end: ends of the sectioned length, as distances from the root, m.

    Raises:
        ModelError: no sections, a length, width or area that is not above zero, or axes that are
            not perpendicular.
    """

    p_BoRo_B: Vector3
    axis_B: Vector3
    normal_B: Vector3
    distances: tuple[float, ...]
    areas: tuple[float, ...]
    chord: float
    start: float
    end: float

    def __post_init__(self) -> None:
        if not 1 <= len(self.distances) == len(self.areas):
            raise ModelError(
                f"section layout: {len(self.areas)} areas for {len(self.distances)} section "
                "centres; allowed: as many, from 1 on"
            )
        check_above_zero("section layout: chord", self.chord, unit="m")
        for area in self.areas:
            check_above_zero("section layout: area", area, unit="m2")
        if not np.all(np.isfinite([*self.p_BoRo_B, *self.distances, self.start, self.end])):
            raise ModelError("section layout: positions and distances must be finite numbers")
        for name in ("p_BoRo_B", "axis_B", "normal_B"):
            value = getattr(self, name)
            if len(value) != 3:
                raise ModelError(f"section layout: {name} is {value}; must be three numbers")
        axes = np.array([self.axis_B, self.normal_B], float)
        products = axes @ axes.T
        if np.any(np.abs(np.sqrt(products.diagonal()) - 1.0) > _UNIT_ERROR):
            raise ModelError("section layout: axis_B and normal_B must be unit vectors")
        if abs(products[0, 1]) > _UNIT_ERROR:
            raise ModelError("section layout: normal_B must be perpendicular to axis_B")

    @property
    def number(self) -> int:
        """Number of sections."""
        return len(self.distances)

    @property
    def p_BoSi_B(self) -> FloatArray:
        """Section centres in the body frame (n, 3), m."""
        return np.asarray(self.p_BoRo_B) + np.outer(self.distances, self.axis_B)

    @property
    def p_BoTip_B(self) -> FloatArray:
        """Tip of the sectioned length in the body frame (3), m."""
        return np.asarray(self.p_BoRo_B) + self.end * np.asarray(self.axis_B)

    def motion(self, X_WB: Any, w_WB: Any, v_WBo: Any, v_WA: Any) -> LineMotion:
        """Computes the motion of the line of sections on a body, as a `SectionLaw` needs it, for
        floats and for AutoDiffXd alike.

        Args:
            X_WB: pose of the body, three rows whose first three numbers are those of R_WB.
            w_WB, v_WBo: angular velocity (3), rad/s, and velocity of the body origin (3), m/s, in
                W.
            v_WA: velocity of the air in W (3), m/s; None in still air.
        """
        a = rotated(X_WB, self.axis_B)
        n = rotated(X_WB, self.normal_B)
        v_WRo = v_WBo
        if any(self.p_BoRo_B):
            v_WRo = add_cross(v_WBo, w_WB, rotated(X_WB, self.p_BoRo_B))
        v_x, v_y, v_z = v_WRo
        air_x, air_y, air_z = _STILL_AIR if v_WA is None else v_WA
        u = (air_x - v_x, air_y - v_y, air_z - v_z)
        return LineMotion(u, cross(a, w_WB), a, n)

    @classmethod
    def strip(
        cls,
        *,
        start: float,
        length: float,
        width: float,
        number: int = 5,
        p_BoRo_B: Vector3 = (0.0, 0.0, 0.0),
        axis_B: Vector3 = (0.0, 0.0, 1.0),
        normal_B: Vector3 = (1.0, 0.0, 0.0),
    ) -> SectionLayout:
        """Makes a flat strip of equal sections: a cheetah tail, a bar, the robot's sail.

        By default it points up, facing x.

        Args:
            start: distance of the strip's near end from the root along the axis, m.
            length: length of the strip, m.
            width: width of the strip, m; the major width for a cheetah tail, the sail width for the
                robot tail.
            number: number of equal sections.
        """
        if int(number) != number or number < 1:
            raise ModelError(
                f"section layout: the number of sections is {number}, but it must be a whole "
                "number from 1"
            )
        check_above_zero("section layout: length", length, unit="m")
        check_above_zero("section layout: width", width, unit="m")
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


def sampled_poses(plant: Any, count: int) -> Iterator[Any]:
    """Yields contexts of a plant at its default position, then at random ones between the limits of
    its joints.

    A joint without limits makes a full turn; floating bases stay where they are.
    """
    context = plant.CreateDefaultContext()
    rng = np.random.default_rng(0)
    limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    default = np.clip(plant.GetPositions(context), *limits)
    ends = np.clip(limits, -math.pi, math.pi)
    free = [
        joint.position_start() + index
        for joint in joints_of(plant)
        for index in range(joint.num_positions())
    ]
    for sample in range(count):
        positions = default.copy()
        if sample:
            positions[free] = rng.uniform(*ends)[free]
        plant.SetPositions(context, positions)
        yield context


def joints_of(plant: Any) -> list[Any]:
    """Returns the joints that move and are no floating base."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if 0 < joint.num_velocities() < 6]


@dataclass(frozen=True)
class Jet:
    """A half space below a tilted edge: the point p is in the jet when its height is below the
    edge's.

    The edge passes through p_WE and rises `slope` metres per metre downstream.

    Attributes:
        p_WE: point of the upper edge (3), m; on the rig `edge_depth` below the pivot.
        downstream_W: horizontal unit vector along the wind (3).
        slope: rise of the edge per metre downstream.
    """

    p_WE: Vector3
    downstream_W: Vector3 = (0.0, -1.0, 0.0)
    slope: float = 100.0 / 1800.0

    @classmethod
    def below_pivot(
        cls, p_WP: Any, edge_depth: float, psi: float = 0.0, slope: float = 100.0 / 1800.0
    ) -> Jet:
        """Makes the rig's jet: edge `edge_depth` (m) below the pivot P, wind towards -y turned by
        psi (rad) about z.

        Exposure along a hanging tail then starts at edge_depth / (cos(angle) + slope sin(angle))
        for psi = 0.
        """
        x, y, z = map(float, p_WP)
        return cls((x, y, z - edge_depth), (math.sin(psi), -math.cos(psi), 0.0), slope)

    def height_below_edge(self, p_WQ: Any) -> Any:
        """Measures how far a point is below the edge (m); negative above it."""
        x, y, _ = self.downstream_W
        downstream = (p_WQ[0] - self.p_WE[0]) * x + (p_WQ[1] - self.p_WE[1]) * y
        return self.p_WE[2] + self.slope * downstream - p_WQ[2]

    def exposed_interval(self, layout: SectionLayout, p_WRo: Any, a: Any) -> tuple[Any, Any] | None:
        """Returns start and end of the exposed part, distances from the root (m); None if there is
        none.

        Args:
            p_WRo: root of the section axis in W (3), m.
            a: axis from root to tip in W (3).
        """
        start = layout.start
        end = layout.end
        at_root = self.height_below_edge(p_WRo)
        x, y, _ = self.downstream_W
        rate = self.slope * (x * a[0] + y * a[1]) - a[2]
        at_start = at_root + rate * start
        at_end = at_root + rate * end
        if at_start <= 0.0 and at_end <= 0.0:
            return None
        if at_start < 0.0:
            return -at_root / rate, end
        if at_end < 0.0:
            return start, -at_root / rate
        return start, end

    def exposed_sections(
        self, layout: SectionLayout, p_WRo: Any, a: Any
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Returns centres (m from the root) and areas (m2) of equal parts of the exposed length;
        areas 0 without exposure.
        """
        number = layout.number
        interval = self.exposed_interval(layout, p_WRo, a)
        if interval is None:
            return layout.distances, (0.0,) * number
        start, end = interval
        part = (end - start) / number
        distances = tuple(start + (i + 0.5) * part for i in range(number))
        return distances, (part * layout.chord,) * number

    def require_reachable(self, plant: Any, body: Any, layout: SectionLayout) -> None:
        """Refuses a layout that the jet meets at no reachable angle.

        Raises:
            ModelError: of the default and many random positions none brings a section into the jet.
        """
        carrier = plant.get_body(body.index())
        for context in sampled_poses(plant, _SAMPLES):
            X_WB = plant.EvalBodyPoseInWorld(context, carrier)
            p_WRo = X_WB.multiply(np.asarray(layout.p_BoRo_B))
            a = X_WB.rotation().multiply(np.asarray(layout.axis_B))
            if self.exposed_interval(layout, p_WRo.tolist(), a.tolist()) is not None:
                return
        raise ModelError(
            f"jet: body '{body.name()}' meets the jet at no reachable angle: its sections end "
            f"{layout.end:.3f} m from their root and the edge is at height {self.p_WE[2]:.3f} m; "
            "lower the edge depth or lengthen the body"
        )
