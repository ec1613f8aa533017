"""Two small systems on the rig: its reaction as a vector, and added mass that acts across the tail only."""

from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.aero.added_mass import AddedMass
from aerodima.workbench.systems.autodiff_system import declare_spatial_forces
from aerodima.workbench.systems.vector_ports import vector_of


class SupportWrench(LeafSystem):
    """The reaction at the force sensor as a vector.

    Input ports:
        reaction_forces: list[SpatialForce], from the plant.
    Output ports:
        wrench (6): of the support on the rig at W, W axes: force N, torque N m.

    Args:
        joint: index of the weld between world and mount, whose child frame is W.
    """

    def __init__(self, joint: int):
        super().__init__()
        self._joint = joint
        self._reactions = self.DeclareAbstractInputPort("reaction_forces", Value[list[SpatialForce]]())
        self.DeclareVectorOutputPort("wrench", 6, self._calc, {self._reactions.ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        reactions: Any = self._reactions.Eval(context)
        coefficients = reactions[self._joint].get_coeffs()
        output.SetFromVector(np.concatenate((coefficients[3:], coefficients[:3])))


class SpanwiseBalance(LeafSystem):
    """Takes the centripetal inertia of the added mass off the tail: added mass acts across the tail's axis only.

    The added mass is a body welded to the tail. On a pendulum its only acceleration along the axis is the centripetal
    one, so a push of that size makes the wrench exact, without a degree of freedom more.

    Input ports:
        plant_state (2): angle and rate.
    Output ports:
        spatial_forces: list[ExternallyAppliedSpatialForce], one on the body of the added mass.
    """

    def __init__(self, plant: MultibodyPlant, added: AddedMass):
        super().__init__()
        self._plant = plant
        self._context = plant.CreateDefaultContext()
        (self._body,) = plant.GetBodyIndices(added.instance)
        self._mass = plant.get_body(self._body).default_mass()
        self._state = self.DeclareVectorInputPort("plant_state", 2)
        declare_spatial_forces(self, self._calc, {self._state.ticket()})

    def _calc(self, context: Context, output: Any) -> None:
        plant, mine = self._plant, self._context
        state = vector_of(self._state, context)
        plant.SetPositionsAndVelocities(mine, state)
        pose = plant.EvalBodyPoseInWorld(mine, plant.get_body(self._body))
        axis = pose.rotation().matrix()[:, 2]
        pivot = plant.EvalBodyPoseInWorld(mine, plant.GetJointByName("swing").child_body()).translation()
        distance = axis @ (pose.translation() - pivot)
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._body
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(np.zeros(3), -self._mass * distance * state[1] ** 2 * axis)
        output.set_value([force])
