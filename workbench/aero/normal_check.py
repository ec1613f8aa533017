"""Is the normal of a tail's sections the right one? A plate that only moves edge-on feels no air, without a word."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, RigidBody

from aerodima.workbench.aero.sections import SectionLayout

_POSES = 9
"""Positions of the plant that are looked at: its default and random ones between its limits."""
_ALONG = 1e-6
"""Share of its motion that a section must make along its normal."""


def idle_normal(plant: MultibodyPlant, body: RigidBody, layout: SectionLayout) -> str:
    """One line when no joint ever moves the sections along their normal; empty when one does, or none moves them.

    The six degrees of freedom of floating bases are left out: they move any plate in any direction.

    Args:
        plant: finalised.
        body: that carries the sections.
        layout: sections in the body frame.
    """
    motion = _section_motion(plant, body, layout)
    moved = float(np.max(np.linalg.norm(motion, axis=0), initial=0.0))
    normal = np.asarray(layout.normal_B)
    if moved == 0.0 or float(np.max(np.abs(normal @ motion))) > _ALONG * moved:
        return ""
    axis = np.asarray(layout.axis_B)
    across = motion - np.outer(axis, axis @ motion)
    left, size, _ = np.linalg.svd(across, full_matrices=False)
    line = (
        f"tail force on body '{body.name()}': no joint moves its sections along normal_B {_words(normal)}, so that a "
        "swing feels no air"
    )
    return f"{line}; it moves them along {_words(left[:, 0])}" if size[0] > _ALONG * moved else line


def _section_motion(plant: MultibodyPlant, body: RigidBody, layout: SectionLayout) -> np.ndarray:
    """Velocities of the section centres in B per unit rate of each joint, over several poses (3, n)."""
    context = plant.CreateDefaultContext()
    rng = np.random.default_rng(0)
    default = plant.GetPositions(context)
    lower = np.clip(plant.GetPositionLowerLimits(), -math.pi, math.pi)
    upper = np.clip(plant.GetPositionUpperLimits(), -math.pi, math.pi)
    base_q, base_v = set(), set()
    for index in plant.GetFloatingBaseBodies():
        base = plant.get_body(index)
        start, size = base.floating_positions_start(), 7 if base.has_quaternion_dofs() else 6
        base_q |= set(range(start, start + size))
        base_v |= set(range(base.floating_velocities_start_in_v(), base.floating_velocities_start_in_v() + 6))
    joints = [index for index in range(plant.num_velocities()) if index not in base_v]
    frame, centres, found = body.body_frame(), layout.p_BoSi_B.T, [np.zeros((3, 0))]
    for pose in range(_POSES if joints else 0):
        if pose:
            positions = np.where([index in base_q for index in range(default.size)], default, rng.uniform(lower, upper))
            plant.SetPositions(context, positions)
        J: Any = plant.CalcJacobianTranslationalVelocity(
            context, JacobianWrtVariable.kV, frame, centres, plant.world_frame(), frame
        )
        found.append(np.asarray(J)[:, joints].reshape(-1, 3, len(joints)).transpose(1, 0, 2).reshape(3, -1))
    return np.hstack(found)


def _words(vector: np.ndarray) -> str:
    sign = -1.0 if vector[np.argmax(np.abs(vector))] < 0.0 else 1.0
    parts = ", ".join(f"{round(float(sign * part), 2) + 0.0:g}" for part in vector)
    return f"({parts})"
