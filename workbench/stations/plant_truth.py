"""Ground truth of any plant: its base, its centre of mass, the poses of its bodies, the air on its tails; for logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.aero.added_mass import ADDED_MASS_PREFIX
from aerodima.workbench.aero.tail_force import SECTION_COLUMNS
from aerodima.workbench.config.signal_table import CAR_TRUTH, names_of
from aerodima.workbench.stations.ground_truth import cross
from aerodima.workbench.systems.system_ports import vector_of

_XYZ = ("x", "y", "z")
BASE_COLUMNS = [name for name in names_of(CAR_TRUTH["body_truth"]) if not name.startswith(("acceleration", "com"))]
"""Position, roll, pitch, yaw, tilt, velocity and angular velocity of the base: those of a car's body."""
COM_COLUMNS = [f"com_{axis}_truth_m" for axis in _XYZ] + [f"com_velocity_{axis}_truth_m_per_s" for axis in _XYZ]
"""Position and velocity of the centre of mass of the whole plant in W."""


def pose_columns(body: str) -> list[str]:
    """Columns of the pose of a body in W: quaternion, then position of its origin, m."""
    return [f"pose_{body}_{part}" for part in ("qw", "qx", "qy", "qz")] + [f"pose_{body}_{axis}_m" for axis in _XYZ]


def air_columns(stem: str) -> list[str]:
    """Columns of the air on a tail, W axes: force, moment about Wo, root and tip of its sections."""
    parts = (("", "n"), ("_moment", "n_m"), ("_root", "m"), ("_tip", "m"))
    return [f"{stem}{what}_{axis}_truth_{unit}" for what, unit in parts for axis in _XYZ]


def section_columns(stem: str, number: int) -> list[str]:
    """Columns of the port `sections` of a `TailForce`."""
    return [f"{stem}_section_{index}_{name}" for index in range(number) for name in SECTION_COLUMNS]


def own_instances(plant: MultibodyPlant) -> list[ModelInstanceIndex]:
    """Model instances that have bodies, without the world's and those of added mass, which weigh nothing."""
    instances = [ModelInstanceIndex(index) for index in range(1, plant.num_model_instances())]
    return [
        instance
        for instance in instances
        if plant.GetBodyIndices(instance) and not plant.GetModelInstanceName(instance).startswith(ADDED_MASS_PREFIX)
    ]


class PlantTruth(LeafSystem):
    """What a plant knows of its motion. Evaluated only when somebody reads it, such as the run log.

    Everything comes from the plant's state through a context of its own. Bodies are kept by index: see design section
    13.

    Input ports:
        plant_state: [q; v] of the plant.
        <name of a tail force> (9): its `wrench`.
    Output ports:
        base (13): `BASE_COLUMNS`; only with a base.
        com (6): `COM_COLUMNS`.
        poses (7 n): `pose_columns` of each body; only with bodies.
        <name of a tail force>_air (12): `air_columns`.

    Args:
        plant: finalised.
        base: the body whose roll, tilt and speed count; None for a plant that has none.
        bodies: whose poses are asked for.
        tails: `TailForce` systems on bodies of this plant.
    """

    def __init__(
        self, plant: MultibodyPlant, base: BodyIndex | None, bodies: Sequence[BodyIndex], tails: Sequence[Any]
    ) -> None:
        super().__init__()
        self._plant, self._base, self._bodies = plant, base, list(bodies)
        self._instances = own_instances(plant)
        self._kinematics = plant.CreateDefaultContext()
        self._state_port = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.DeclareVectorOutputPort("com", len(COM_COLUMNS), self._calc_com)
        if base is not None:
            self.DeclareVectorOutputPort("base", len(BASE_COLUMNS), self._calc_base)
        if self._bodies:
            self.DeclareVectorOutputPort("poses", 7 * len(self._bodies), self._calc_poses)
        for tail in tails:
            self._declare_tail(tail)

    def _declare_tail(self, tail: Any) -> None:
        wrench_port = self.DeclareVectorInputPort(tail.get_name(), 9)
        body, root, tip = tail.body.index(), np.asarray(tail.layout.p_BoRo_B), tail.layout.p_BoTip_B

        def calc(context: Context, output: BasicVector) -> None:
            wrench = vector_of(wrench_port, context)
            force, moment, p_WBo = wrench[:3], wrench[3:6], wrench[6:]
            X_WB = self._plant.EvalBodyPoseInWorld(self._kinematics_at(context), self._plant.get_body(body))
            R_WB = X_WB.rotation().matrix()
            ends = [X_WB.translation() + R_WB @ place for place in (root, tip)]
            output.SetFromVector(np.concatenate([force, moment + cross(p_WBo, force), *ends]))

        self.DeclareVectorOutputPort(f"{tail.get_name()}_air", 12, calc)

    def _kinematics_at(self, context: Context) -> Context:
        self._plant.SetPositionsAndVelocities(self._kinematics, vector_of(self._state_port, context))
        return self._kinematics

    def _calc_com(self, context: Context, output: BasicVector) -> None:
        kinematics, plant = self._kinematics_at(context), self._plant
        output.SetFromVector(
            np.concatenate(
                [
                    plant.CalcCenterOfMassPositionInWorld(kinematics, self._instances),
                    plant.CalcCenterOfMassTranslationalVelocityInWorld(kinematics, self._instances),
                ]
            )
        )

    def _calc_base(self, context: Context, output: BasicVector) -> None:
        assert self._base is not None
        kinematics, body = self._kinematics_at(context), self._plant.get_body(self._base)
        X_WB = self._plant.EvalBodyPoseInWorld(kinematics, body)
        V_WB = self._plant.EvalBodySpatialVelocityInWorld(kinematics, body)
        R_WB = X_WB.rotation().matrix()
        tilt = math.acos(min(max(R_WB[2, 2], -1.0), 1.0))
        velocity, gyro = R_WB.T @ V_WB.translational(), R_WB.T @ V_WB.rotational()
        angles = RollPitchYaw(X_WB.rotation()).vector()
        output.SetFromVector(np.concatenate([X_WB.translation(), angles, [tilt], velocity, gyro]))

    def _calc_poses(self, context: Context, output: BasicVector) -> None:
        kinematics = self._kinematics_at(context)
        rows = []
        for index in self._bodies:
            X_WB = self._plant.EvalBodyPoseInWorld(kinematics, self._plant.get_body(index))
            rows += [X_WB.rotation().ToQuaternion().wxyz(), X_WB.translation()]
        output.SetFromVector(np.concatenate(rows))
