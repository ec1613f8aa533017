"""The push of air that accelerates on the added mass of a tail, as a Drake system."""

from typing import Any

import numpy as np
from pydrake.multibody.math import SpatialForce_
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_

from aerodima.workbench.core.port_wiring import declare_spatial_forces
from aerodima.workbench.core.system_lifetime import SystemParts, scalar_template


class GustForceParts(SystemParts):
    """Force of the air's acceleration on the added mass of one tail, see `added_mass.py`.

    Air that accelerates by A_air pushes the tail with M (1 - a a^T) A_air at the middle of the
    parts, so that only the acceleration relative to the air counts.

    Input ports:
        plant_state: multibody state [q; v].
        wind_acceleration (3): acceleration A_air of the air in W, m/s2.
    Output ports:
        spatial_forces: list[ExternallyAppliedSpatialForce], on the tail.

    Args:
        plant: finalised plant.
        middle: frame at the middle of the parts, z along the tail axis.
        mass: added mass of the whole tail, M = n m_added, kg.
    """

    def declare(self, T: Any, plant: Any, middle: Any, mass: float) -> None:
        """Declares ports for a scalar type; arguments as above."""
        self._plant = plant
        self._middle = middle.index()
        self._mass = mass
        self._kinematics = plant.CreateDefaultContext()
        self._push = ExternallyAppliedSpatialForce_[T]()
        self._push.body_index = middle.body().index()
        self._push.p_BoBq_B = list(middle.GetFixedPoseInBodyFrame().translation())
        self._SpatialForce = SpatialForce_[T]
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._air = self.DeclareVectorInputPort("wind_acceleration", 3)
        declare_spatial_forces(self, self._calc, T)

    def arguments(self, T: Any) -> tuple[Any, ...]:
        """Returns the arguments of the same system of scalar type T."""
        plant = self._plant.ToScalarType[T]()
        return plant, plant.get_frame(self._middle), self._mass

    def _calc(self, context: Any, output: Any) -> None:
        plant = self._plant
        kinematics = self._kinematics
        plant.SetPositionsAndVelocities(kinematics, self._state.Eval(context))
        R_WM = plant.get_frame(self._middle).CalcRotationMatrixInWorld(kinematics)
        x, y, _ = R_WM.inverse().multiply(self._air.Eval(context))
        force_M = self._SpatialForce(np.array((0.0, 0.0, 0.0, self._mass * x, self._mass * y, 0.0)))
        self._push.F_Bq_W = force_M.Rotate(R_WM)
        output.set_value([self._push])


GustForce_ = scalar_template("GustForce_", __name__, GustForceParts)
"""Template over the scalar type; see `GustForceParts`."""
GustForce = GustForce_[float]
"""The push of accelerating air on added mass as a Drake system, see `AddedMass.add_to_builder`."""
