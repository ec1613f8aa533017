"""Vertical forces of the level ground on a car, from its motion after the run.

Trials use it, since Drake's contact results cost more (figures in README.md beside this file).

A contact of Drake's lagged approximation has the penetration x at the beginning of a step of length
h and, with the velocity at its end, the rate of that penetration x':

    f = k (x + h x')_+ (1 + d x')_+        where x > 0, else 0

with stiffness k and dissipation d of the pair, and x' that of the point where Drake puts the
contact. Shapes that touch the ground are spheres and ellipsoids.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Ellipsoid, Sphere
from pydrake.multibody.tree import BodyIndex, Joint, PrismaticJoint, RevoluteJoint, WeldJoint

from aerodima.workbench.car.car_plant import GROUND_STIFFNESS, CarPlant
from aerodima.workbench.car.ground_truth import contact_slots
from aerodima.workbench.core.array_types import ArrayPair, FloatArray
from aerodima.workbench.core.elementwise import rotation_rows
from aerodima.workbench.scenario.signal_table import GROUND_CONTACTS, WHEELS

_NUDGE = 1e-3
"""Share of a step by which the motion is varied for the rates of penetration."""


_Height = ArrayPair
"""The world's z axis in a body (3, n), and the height of its origin (n), m."""


@dataclass(frozen=True)
class _Shape:
    """A sphere or ellipsoid G on a body B.

    Attributes:
        slot: wheel, or part of the car, that it belongs to.
        body: index of B.
        radii: half axes of G (3), m.
        R_BG: rotation of G in B (3 x 3).
        p_BoGo_B: middle of G in B (3), m.
        stiffness: k of the pair with the ground, N/m.
        dissipation: d of the pair, s/m.
    """

    slot: str
    body: BodyIndex
    radii: FloatArray
    R_BG: FloatArray
    p_BoGo_B: FloatArray
    stiffness: float
    dissipation: float

    def contact(self, up: FloatArray, height: FloatArray) -> ArrayPair:
        """Returns depth in the ground (n), m, and where Drake puts the contact on B (3, n), m."""
        up_G = self.R_BG.T @ up
        square = self.radii[:, None] ** 2
        half = np.sqrt(np.sum(square * up_G**2, axis=0))
        depth = half - height - self.p_BoGo_B @ up
        # Half way from the deepest point to the ground, on the line to the middle of the shape.
        p_GoC_G = -square * up_G / half * (1.0 - 0.5 * depth / half)
        return depth, self.p_BoGo_B[:, None] + self.R_BG @ p_GoC_G


class GroundLoads:
    """Vertical forces of the level ground on a car, and how high its tyres are above it.

    Args:
        car: plant of the car with its ground.
    """

    def __init__(self, car: CarPlant) -> None:
        self._plant = car.plant
        self._shapes = list(_shapes(car))
        plant = car.plant
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        self._inboard = {joint.child_body().index(): joint for joint in joints}

    def forces(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """Returns the forces (7, n) in the steps between two positions, N: on the wheels, then
        cage, board and tail.

        Args:
            before, after: positions (nq, n) of the plant at the beginning and the end of each step.
        """
        step = self._plant.time_step()
        change = after - before
        now, ahead, behind = (before + side * _NUDGE * change for side in (0.0, 1.0, -1.0))
        known: list[dict[BodyIndex, _Height]] = [{}, {}, {}]
        slots = (*WHEELS, *GROUND_CONTACTS)
        total = np.zeros((len(slots), before.shape[1]))
        for shape in self._shapes:
            up, height = self._height(shape.body, now, known[0])
            x, p_BoC_B = shape.contact(up, height)
            up_ahead, height_ahead = self._height(shape.body, ahead, known[1])
            up_behind, height_behind = self._height(shape.body, behind, known[2])
            later = height_ahead + np.sum(p_BoC_B * up_ahead, axis=0)
            earlier = height_behind + np.sum(p_BoC_B * up_behind, axis=0)
            rate = (earlier - later) / (2.0 * _NUDGE * step)
            force = (
                shape.stiffness
                * np.maximum(x + step * rate, 0.0)
                * np.maximum(1.0 + shape.dissipation * rate, 0.0)
            )
            total[slots.index(shape.slot)] += np.where(x > 0.0, force, 0.0)
        return total

    def lifts(self, positions: FloatArray) -> FloatArray:
        """Returns the height (4, n) of the lowest point of each tyre above the ground, m; 0 or less
        where the tyre presses into the ground.

        Args:
            positions: positions of the plant (nq, n).
        """
        known: dict[BodyIndex, _Height] = {}
        lowest = np.full((len(WHEELS), positions.shape[1]), math.inf)
        for shape in self._shapes:
            if shape.slot in WHEELS:
                depth, _ = shape.contact(*self._height(shape.body, positions, known))
                wheel = WHEELS.index(shape.slot)
                lowest[wheel] = np.minimum(lowest[wheel], -depth)
        return lowest

    def _height(
        self, body: BodyIndex, positions: FloatArray, known: dict[BodyIndex, _Height]
    ) -> _Height:
        if body not in known:
            joint = self._inboard.get(body)
            if joint is None:  # the world
                return np.array([[0.0], [0.0], [1.0]]), np.zeros(1)
            parent = self._height(joint.parent_body().index(), positions, known)
            known[body] = _through(joint, *parent, positions)
        return known[body]


def _through(joint: Joint, up: FloatArray, height: FloatArray, positions: FloatArray) -> _Height:
    """Carries the vertical and the height of a body over a joint to its child."""
    X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
    if isinstance(joint, WeldJoint):
        X_PF = X_PF.multiply(joint.X_FM())
    X_MC = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
    height = height + X_PF.translation() @ up
    up = X_PF.rotation().matrix().T @ up
    start = joint.position_start()
    if isinstance(joint, RevoluteJoint):
        axis = joint.revolute_axis()[:, None]
        c = np.cos(positions[start])
        s = np.sin(positions[start])
        up = c * up - s * np.cross(axis, up, axis=0) + (1.0 - c) * axis * np.sum(axis * up, axis=0)
    elif isinstance(joint, PrismaticJoint):
        height = height + positions[start] * (joint.translation_axis() @ up)
    elif joint.num_positions() == 7:
        up = np.array(rotation_rows(positions[start : start + 4])[2])
        height = positions[start + 6]
    return X_MC.rotation().matrix().T @ up, height + X_MC.translation() @ up


def _shapes(car: CarPlant) -> Iterator[_Shape]:
    inspector = car.scene_graph.model_inspector()
    slots = contact_slots(car)
    for geometry in inspector.GetAllGeometryIds():
        slot = slots.get(geometry.get_value())
        if slot is None:
            continue
        shape: Any = inspector.GetShape(geometry)
        if isinstance(shape, Sphere):
            radii = np.full(3, shape.radius())
        elif isinstance(shape, Ellipsoid):
            radii = np.array([shape.a(), shape.b(), shape.c()])
        else:
            raise TypeError(
                f"{inspector.GetName(geometry)}: a {type(shape).__name__} meets the ground"
            )
        properties: Any = inspector.GetProximityProperties(geometry)
        k = properties.GetProperty("material", "point_contact_stiffness")
        d = properties.GetProperty("material", "hunt_crossley_dissipation")
        share = GROUND_STIFFNESS / (GROUND_STIFFNESS + k)
        X_BG = inspector.GetPoseInFrame(geometry)
        body = car.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).index()
        yield _Shape(
            slot, body, radii, X_BG.rotation().matrix(), X_BG.translation(), share * k, share * d
        )
