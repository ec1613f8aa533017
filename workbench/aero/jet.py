"""The open jet of the wind tunnel: only what it covers feels the wind (design section 5, ERRATA E21)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.errors import ModelError

_SAMPLES_PER_JOINT = 181


@dataclass(frozen=True)
class Jet:
    """A half space below a tilted edge: the point p is in the jet when its height is below the edge's.

    The edge passes through p_WE and rises `slope` metres per metre downstream.

    Attributes:
        p_WE: a point of the upper edge (3), m; on the rig `edge_depth` below the pivot.
        downstream_W: horizontal unit vector in which the wind blows (3).
        slope: rise of the edge per metre downstream.
    """

    p_WE: tuple[float, float, float]
    downstream_W: tuple[float, float, float] = (0.0, -1.0, 0.0)
    slope: float = 100.0 / 1800.0

    def __post_init__(self) -> None:
        if abs(math.dist(self.downstream_W, (0.0, 0.0, 0.0)) - 1.0) > 1e-9 or abs(self.downstream_W[2]) > 1e-9:
            raise ModelError(f"jet: downstream_W is {self.downstream_W}, but it must be a horizontal unit vector")
        if not (math.isfinite(self.slope) and np.all(np.isfinite(self.p_WE))):
            raise ModelError("jet: the edge point and the slope must be finite numbers")

    @classmethod
    def below_pivot(cls, p_WP: Any, edge_depth: float, psi: float = 0.0, slope: float = 100.0 / 1800.0) -> Jet:
        """The rig's jet: edge `edge_depth` (m) below the pivot P, wind towards -y turned by psi (rad) about z.

        Exposure along a hanging tail then starts at edge_depth / (cos(angle) + slope sin(angle)) for psi = 0.
        """
        x, y, z = (float(value) for value in p_WP)
        return cls((x, y, z - edge_depth), (math.sin(psi), -math.cos(psi), 0.0), slope)

    def height_below_edge(self, p_WQ: Any) -> Any:
        """How far a point is below the edge (m); negative above it."""
        x, y, _ = self.downstream_W
        downstream = (p_WQ[0] - self.p_WE[0]) * x + (p_WQ[1] - self.p_WE[1]) * y
        return self.p_WE[2] + self.slope * downstream - p_WQ[2]

    def exposed_interval(self, layout: SectionLayout, p_WRo: Any, a: Any) -> tuple[Any, Any] | None:
        """Start and end of the exposed part, distances from the root (m), or None without exposure.

        Args:
            p_WRo: root of the section axis in W (3), m.
            a: axis from root to tip in W (3).
        """
        start, end = layout.start, layout.end
        at_root = self.height_below_edge(p_WRo)
        rate = self.slope * (self.downstream_W[0] * a[0] + self.downstream_W[1] * a[1]) - a[2]
        at_start, at_end = at_root + rate * start, at_root + rate * end
        if at_start <= 0.0 and at_end <= 0.0:
            return None
        if at_start < 0.0:
            return -at_root / rate, end
        if at_end < 0.0:
            return start, -at_root / rate
        return start, end

    def exposed_sections(self, layout: SectionLayout, p_WRo: Any, a: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Centres (m from the root) and areas (m2) of equal parts of the exposed length; areas 0 without exposure."""
        number = layout.number
        if layout.start == layout.end:
            inside = self.exposed_interval(layout, p_WRo, a) is not None
            return layout.distances, layout.areas if inside else (0.0,) * number
        interval = self.exposed_interval(layout, p_WRo, a)
        if interval is None:
            return layout.distances, (0.0,) * number
        start, part = interval[0], (interval[1] - interval[0]) / number
        return tuple(start + (i + 0.5) * part for i in range(number)), (part * layout.chord,) * number

    def require_reachable(self, plant: Any, body: Any, layout: SectionLayout) -> None:
        """Refuses a layout that the jet meets at no reachable angle.

        Every joint with one position is swept over its limits (a full turn where it has none), the others at their
        default positions, moved into their limits.

        Raises:
            ModelError: no position of any joint brings a section into the jet.
        """
        from pydrake.multibody.tree import BodyIndex, JointIndex

        context = plant.CreateDefaultContext()
        defaults = np.clip(plant.GetPositions(context), plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits())
        plant.SetPositions(context, defaults)

        def exposed() -> bool:
            X_WB = plant.EvalBodyPoseInWorld(context, plant.get_body(BodyIndex(body.index())))
            p_WRo = X_WB.multiply(np.asarray(layout.p_BoRo_B))
            a = X_WB.rotation().multiply(np.asarray(layout.axis_B))
            return self.exposed_interval(layout, p_WRo.tolist(), a.tolist()) is not None

        if exposed():
            return
        for index in range(plant.num_joints()):
            joint = plant.get_joint(JointIndex(index))
            if joint.num_positions() != 1:
                continue
            lower, upper = float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])
            lower, upper = max(lower, -math.pi), min(upper, math.pi)
            for position in np.linspace(lower, upper, _SAMPLES_PER_JOINT):
                q = defaults.copy()
                q[joint.position_start()] = position
                plant.SetPositions(context, q)
                if exposed():
                    return
        raise ModelError(
            f"jet: body '{body.name()}' meets the jet at no reachable angle: its sections end {layout.end:.3f} m from "
            f"their root and the edge is at height {self.p_WE[2]:.3f} m; lower the edge depth or lengthen the body"
        )
