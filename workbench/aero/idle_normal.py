"""A warning where no joint moves a flat tail along its normal, so that a swing feels no air."""

from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, RigidBody

from aerodima.workbench.aero.sections import SectionLayout, joints_of, sampled_poses
from aerodima.workbench.core.array_types import FloatArray

_POSES = 9
"""Number of positions at which a plant is examined: its default, and random ones in its limits."""
_ALONG = 1e-6
"""Share of its motion that a section must make along its normal."""


def idle_normal(plant: MultibodyPlant, body: RigidBody, layout: SectionLayout) -> str:
    """Writes one line when no joint ever moves the sections along their normal; empty when one
    does, or none moves them.

    The six degrees of freedom of floating bases are left out: they move any plate in any direction.

    Args:
        plant: finalised plant.
        body: body that carries the sections.
        layout: sections in the body frame.
    """
    motion = _section_motion(plant, body, layout)
    moved = float(np.max(np.linalg.norm(motion, axis=0), initial=0.0))
    normal = np.asarray(layout.normal_B)
    if moved == 0.0:
        return ""
    along_normal = np.abs(normal @ motion)
    if float(np.max(along_normal)) > _ALONG * moved:
        return ""
    axis = np.asarray(layout.axis_B)
    across = motion - np.outer(axis, axis @ motion)
    left, size, _ = np.linalg.svd(across, full_matrices=False)
    line = (
        f"tail force on body '{body.name()}': no joint moves its sections along normal_B "
        f"{_words(normal)}, so that a swing feels no air"
    )
    if size[0] > _ALONG * moved:
        return f"{line}; it moves them along {_words(left[:, 0])}"
    return line


def _section_motion(plant: MultibodyPlant, body: RigidBody, layout: SectionLayout) -> FloatArray:
    """Returns section velocities in B per unit rate of each joint, in several poses (3, n)."""
    moving = [
        joint.velocity_start() + index
        for joint in joints_of(plant)
        for index in range(joint.num_velocities())
    ]
    frame = body.body_frame()
    centres = layout.p_BoSi_B.T
    motions = [np.zeros((3, 0))]
    for context in sampled_poses(plant, _POSES if moving else 0):
        J: Any = plant.CalcJacobianTranslationalVelocity(
            context, JacobianWrtVariable.kV, frame, centres, plant.world_frame(), frame
        )
        motions += np.split(np.asarray(J)[:, moving], layout.number)
    return np.hstack(motions)


def _words(vector: FloatArray) -> str:
    sign = -1.0 if vector[np.argmax(np.abs(vector))] < 0.0 else 1.0
    parts = ", ".join(f"{round(float(sign * part), 2) + 0.0:g}" for part in vector)
    return f"({parts})"
