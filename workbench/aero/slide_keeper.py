"""The air's own forces on added mass: it holds the sliding bodies beside their tail, and pushes when it accelerates."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.multibody.math import SpatialForce_
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import InputPortIndex

from aerodima.workbench.aero.laws import dot
from aerodima.workbench.systems.autodiff_system import LeafSystem_, declare_spatial_forces, system_template


@system_template("SlideKeeper_", __name__)
def SlideKeeper_(T: Any) -> Any:  # noqa: N802 (Drake's name for a template)
    """Template over the scalar type; see `SlideKeeper`."""

    class Impl(LeafSystem_[T]):  # type: ignore[misc]  # the base is not in the stubs
        """Forces of the air on the added mass of one tail, see `added_mass.py`.

        Per slide with coordinate x, mass m and direction e: F = m (e . A_bias - 2 rate xdot - rate^2 x) e on the
        sliding body, with A_bias the velocity-dependent acceleration of the tail's point under it. The slides are
        frictionless, so nothing of it acts on the tail. Air that accelerates by A_air pushes the tail itself with
        M (1 - a a^T) A_air at the middle of the parts: only the acceleration relative to the air counts.

        Input ports:
            plant_state: multibody state [q; v].
            wind_acceleration (optional, 3): of the air in W, m/s2; steady wind when not connected.
        Output ports:
            spatial_forces: list[ExternallyAppliedSpatialForce], on the sliding body and on the tail.

        Args:
            plant: finalised plant.
            middle: frame at the middle of the parts, z along the tail axis.
            mass: M = n m_added, kg.
            slides: pairs of prismatic joint and mass, kg; may be empty.
            rate: natural frequency of the critically damped hold, rad/s.
        """

        def _construct(
            self,
            plant: Any,
            middle: Any,
            mass: float,
            slides: list[tuple[Any, float]],
            rate: float,
            converter: Any = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter=converter)
            self._plant, self._middle, self._mass = plant, middle.index(), mass
            self._slides, self._rate = [(joint.index(), part) for joint, part in slides], rate
            self._kinematics = plant.CreateDefaultContext()
            self._origin = np.zeros(3)
            nq = plant.num_positions()
            self._rows = [
                (
                    joint.translation_axis().tolist().index(1.0),
                    joint.position_start(),
                    nq + joint.velocity_start(),
                    part,
                )
                for joint, part in slides
            ]
            self._hold = self._force_on(slides[-1][0].child_body()) if slides else None
            self._push = self._force_on(middle.body(), middle.GetFixedPoseInBodyFrame().translation())
            self._SpatialForce = SpatialForce_[T]
            self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
            self._air = self.DeclareVectorInputPort("wind_acceleration", 3)
            inputs = {self.input_port_ticket(InputPortIndex(i)) for i in (0, 1)}
            declare_spatial_forces(self, self._calc, inputs, T)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            plant = other._plant.ToScalarType[T]()
            slides = [(plant.get_joint(joint), part) for joint, part in other._slides]
            middle = plant.get_frame(other._middle)
            Impl._construct(self, plant, middle, other._mass, slides, other._rate, converter)

        @staticmethod
        def _force_on(body: Any, p_BoBq_B: Any = (0.0, 0.0, 0.0)) -> Any:
            force = ExternallyAppliedSpatialForce_[T]()
            force.body_index, force.p_BoBq_B = body.index(), list(p_BoBq_B)
            return force

        def _calc(self, context: Any, output: Any) -> None:
            state, kinematics = self._state.Eval(context), self._kinematics
            self._plant.SetPositionsAndVelocities(kinematics, state)
            R_WM = self._plant.get_frame(self._middle).CalcRotationMatrixInWorld(kinematics).matrix().tolist()
            forces = []
            if self._hold is not None:
                self._hold.F_Bq_W = self._pure_force(self._holding(state, R_WM))
                forces.append(self._hold)
            if self._air.HasValue(context):
                a, air = [row[2] for row in R_WM], self._air.Eval(context).tolist()
                along = dot(a, air)
                self._push.F_Bq_W = self._pure_force(
                    [self._mass * (w - along * x) for w, x in zip(air, a, strict=True)]
                )
                forces.append(self._push)
            output.set_value(forces)

        def _holding(self, state: Any, R_WM: Any) -> list[Any]:
            plant, world = self._plant, self._plant.world_frame()
            bias = plant.CalcBiasTranslationalAcceleration(
                self._kinematics, JacobianWrtVariable.kV, plant.get_frame(self._middle), self._origin, world, world
            )[:, 0].tolist()
            rate, total = self._rate, [0.0, 0.0, 0.0]
            for axis, position, velocity, mass in self._rows:
                e = [row[axis] for row in R_WM]
                size = mass * (dot(e, bias) - 2.0 * rate * state[velocity] - rate * rate * state[position])
                total = [t + size * x for t, x in zip(total, e, strict=True)]
            return total

        def _pure_force(self, force: list[Any]) -> Any:
            return self._SpatialForce(np.array((0.0, 0.0, 0.0, *force)))

    return Impl


SlideKeeper = SlideKeeper_[float]
