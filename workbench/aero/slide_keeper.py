"""The air's hold on the sliding bodies of added mass, as a Drake system."""

from typing import Any

import numpy as np
from pydrake.multibody.math import SpatialForce_
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_
from pydrake.multibody.tree import JacobianWrtVariable

from aerodima.workbench.aero.section_laws import dot
from aerodima.workbench.core.port_wiring import declare_spatial_forces
from aerodima.workbench.core.system_lifetime import SystemParts, scalar_template


class SlideKeeperParts(SystemParts):
    """Forces of the air on the added mass of one tail, see `added_mass.py`.

    Per slide with coordinate x, mass m and direction e: F = m (e . A_bias - 2 rate xdot -
    rate^2 x) e on the sliding body, with A_bias the velocity-dependent acceleration of the
    tail's point under it. The slides are frictionless, so this force does not act on the tail.
    Air that accelerates by A_air pushes the tail itself with M (1 - a a^T) A_air at the middle
    of the parts: only the acceleration relative to the air counts.

    Input ports:
        plant_state: multibody state [q; v].
        wind_acceleration (optional, 3): of the air in W, m/s2; steady wind when not connected.
    Output ports:
        spatial_forces: list[ExternallyAppliedSpatialForce], on the sliding body and on the
            tail.

    Args:
        plant: finalised plant.
        middle: frame at the middle of the parts, z along the tail axis.
        mass: M = n m_added, kg.
        slides: pairs of prismatic joint and mass, kg; may be empty.
        rate: natural frequency of the critically damped hold, rad/s.
    """

    def declare(
        self,
        T: Any,
        plant: Any,
        middle: Any,
        mass: float,
        slides: list[tuple[Any, float]],
        rate: float,
    ) -> None:
        """Declares ports for a scalar type; arguments as above."""
        self._plant = plant
        self._middle = middle.index()
        self._mass = mass
        self._slides = [(joint.index(), part) for joint, part in slides]
        self._rate = rate
        self._kinematics = plant.CreateDefaultContext()
        self._rows = []
        for joint, part in slides:
            axis = joint.translation_axis().tolist().index(1.0)
            position = joint.position_start()
            velocity = plant.num_positions() + joint.velocity_start()
            self._rows.append((axis, position, velocity, part))
        self._hold = None
        if slides:
            self._hold = ExternallyAppliedSpatialForce_[T]()
            self._hold.body_index = slides[-1][0].child_body().index()
            self._hold.p_BoBq_B = [0.0, 0.0, 0.0]
        self._push = ExternallyAppliedSpatialForce_[T]()
        self._push.body_index = middle.body().index()
        self._push.p_BoBq_B = list(middle.GetFixedPoseInBodyFrame().translation())
        self._SpatialForce = SpatialForce_[T]
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._air = self.DeclareVectorInputPort("wind_acceleration", 3)
        declare_spatial_forces(self, self._calc, T)

    def arguments(self, T: Any) -> tuple[Any, ...]:
        """Arguments of the same system of scalar type T."""
        plant = self._plant.ToScalarType[T]()
        slides = [(plant.get_joint(joint), part) for joint, part in self._slides]
        return plant, plant.get_frame(self._middle), self._mass, slides, self._rate

    def _calc(self, context: Any, output: Any) -> None:
        state = self._state.Eval(context)
        kinematics = self._kinematics
        self._plant.SetPositionsAndVelocities(kinematics, state)
        middle = self._plant.get_frame(self._middle)
        R_WM = middle.CalcRotationMatrixInWorld(kinematics).matrix().tolist()
        forces = []
        if self._hold is not None:
            self._hold.F_Bq_W = self._pure_force(self._holding(state, R_WM))
            forces.append(self._hold)
        if self._air.HasValue(context):
            a = [row[2] for row in R_WM]
            air = self._air.Eval(context).tolist()
            along = dot(a, air)
            push = [self._mass * (w - along * x) for w, x in zip(air, a, strict=True)]
            self._push.F_Bq_W = self._pure_force(push)
            forces.append(self._push)
        output.set_value(forces)

    def _holding(self, state: Any, R_WM: Any) -> list[Any]:
        plant = self._plant
        world = plant.world_frame()
        middle = plant.get_frame(self._middle)
        rates = JacobianWrtVariable.kV
        bias = plant.CalcBiasTranslationalAcceleration(
            self._kinematics, rates, middle, np.zeros(3), world, world
        )
        A_bias = bias[:, 0].tolist()
        rate = self._rate
        total = [0.0, 0.0, 0.0]
        for axis, position, velocity, mass in self._rows:
            e = [row[axis] for row in R_WM]
            hold = dot(e, A_bias) - 2.0 * rate * state[velocity] - rate * rate * state[position]
            size = mass * hold
            total = [t + size * x for t, x in zip(total, e, strict=True)]
        return total

    def _pure_force(self, force: list[Any]) -> Any:
        return self._SpatialForce(np.array((0.0, 0.0, 0.0, *force)))


SlideKeeper_ = scalar_template("SlideKeeper_", __name__, SlideKeeperParts)
"""Template over the scalar type; see `SlideKeeperParts`."""
SlideKeeper = SlideKeeper_[float]
"""The air's hold on added mass as a Drake system, see `AddedMass.add_to_builder`."""
