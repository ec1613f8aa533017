"""The wind-tunnel rigs as a continuous `MultibodyPlant`: motion and the wrench of the support on
the rig.

Frame W: origin at the force sensor's point, z up, x along the motor axis, wind towards -y. The
angle is 0 hanging and positive downstream: a revolute joint about -x (design section 4).

The plant is continuous: its acceleration and its six reactions are those of the equations of motion
at any state and torque. A discrete plant has reactions only after a step.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import SceneGraph
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
    System,
)

from aerodima.workbench.aero.added_mass import AddedMass, add_added_mass
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import Air
from aerodima.workbench.aero.tail_force import add_tail_force, connect_spatial_forces
from aerodima.workbench.aero.wind import WindModel, add_wind
from aerodima.workbench.car.ak70 import JointFriction
from aerodima.workbench.car.car_plant import add_plant, parse_model
from aerodima.workbench.car.tail_plant import ADDED_MASS_PARTS
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_wiring import (
    add_and_connect,
    concatenate,
    declare_output,
    declare_spatial_forces,
    vector_of,
)
from aerodima.workbench.core.ranges import check_range
from aerodima.workbench.rig.rig_layout import bar_layout, rig_jet, rig_law, tail_layout
from aerodima.workbench.rig.rig_model import cheetah_rig_sdf, robot_rig_sdf
from aerodima.workbench.scenario.rig_scenario import RigScenario


@dataclass(frozen=True)
class RigPlant:
    """The plant of a rig inside a builder, with everything that acts on it but the motor.

    Attributes:
        plant: finalised continuous plant.
        scene_graph: scene graph for a viewer.
        tail_force: aerodynamic system of the tail; None for the bare bar.
        motor_torque: input port of the motor's torque (1), N m, along the joint axis.
        wrench: port (6) of the wrench of the support on the rig at W: force N, torque N m, in W
            axes.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    tail_force: System | None
    motor_torque: InputPort
    wrench: OutputPort


@dataclass(frozen=True)
class RigReaction:
    """Acceleration and reactions of the rig at one state and torque.

    Attributes:
        acceleration: acceleration of the angle, rad/s2.
        wrench: wrench of the support on the rig at W, W axes (6): F_x, F_y, F_z N, T_x, T_y,
            T_z N m. F_z = m g when the rig hangs still.
    """

    acceleration: float
    wrench: FloatArray


def add_rig_plant(builder: DiagramBuilder, scenario: RigScenario) -> RigPlant:
    """Adds the rig of a scenario with friction, wind and air to a diagram.

    Raises:
        ModelError: a model does not load with these numbers, the tail hangs outside the jet at
            every angle, the added mass is too negative, or the coefficients are not known.
    """
    plant, scene_graph = add_plant(builder, 0.0)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -scenario.environment.gravity])
    parse_model(plant, robot_rig_sdf(scenario) if scenario.is_robot else cheetah_rig_sdf(scenario))
    sensor = plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("mount"))
    added = _added_mass(plant, scenario)
    plant.Finalize()
    plant.GetJointByName("swing").set_default_angle(scenario.experiment.angle)
    state = plant.get_state_output_port()
    friction = JointFriction(scenario.joint_friction, 1)
    add_and_connect(builder, friction, rates=concatenate(builder, "joint_rate", [(state, [1])]))
    builder.Connect(friction.get_output_port(), plant.get_actuation_input_port())
    tail_force = _add_air(builder, plant, scenario)
    if added is not None:
        added.add_to_builder(builder)
        balance = add_and_connect(
            builder, SpanwiseBalance(plant, added), "spanwise_balance", plant_state=state
        )
        connect_spatial_forces(builder, plant, balance.get_output_port())
    reactions = plant.get_reaction_forces_output_port()
    support = add_and_connect(
        builder, SupportWrench(int(sensor.index())), "support", reaction_forces=reactions
    )
    motor_torque = friction.GetInputPort("motor_torques")
    return RigPlant(plant, scene_graph, tail_force, motor_torque, support.get_output_port())


def _add_air(
    builder: DiagramBuilder, plant: MultibodyPlant, scenario: RigScenario
) -> System | None:
    if scenario.experiment.kind == "bar_swing":
        return None
    jet = rig_jet(scenario)
    wind = add_wind(builder, WindModel.in_jet(jet, scenario.experiment.wind_speed))
    air = Air(scenario.environment.air_density, scenario.environment.air_viscosity)
    add_force = partial(add_tail_force, builder, plant, air=air, wind=wind, jet=jet)
    law, limit = rig_law(scenario)
    if not scenario.is_robot:
        add_force("bar", bar_layout(scenario), PolarLaw(scenario.bar.drag_coefficient))
    return add_force("tail", tail_layout(scenario), law, quasi_steady_limit=limit)


def _added_mass(plant: MultibodyPlant, scenario: RigScenario) -> AddedMass | None:
    mass = scenario.aero.added_mass
    if mass == 0.0 or scenario.experiment.kind == "bar_swing":
        return None
    layout = tail_layout(scenario, ADDED_MASS_PARTS)
    return add_added_mass(plant, plant.GetBodyByName("tail"), layout, mass, spanwise_free=False)


class Rig:
    """A rig as a diagram that is built once and evaluated many times.

    Attributes:
        scenario: scenario of the rig.
        plant: plant of the diagram.

    Args:
        scenario: scenario that names rig, tail, wind and coefficients.

    Raises:
        ModelError: see `add_rig_plant`.
    """

    def __init__(self, scenario: RigScenario):
        self.scenario = scenario
        builder = DiagramBuilder()
        self._rig = add_rig_plant(builder, scenario)
        self.plant = self._rig.plant
        builder.ExportInput(self._rig.motor_torque, "motor_torque")
        builder.ExportOutput(self._rig.wrench, "wrench")
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = self.plant.GetMyMutableContextFromRoot(self._context)
        self._torque = self._diagram.GetInputPort("motor_torque")
        self._wrench = self._diagram.GetOutputPort("wrench")
        self._acceleration = self.plant.get_generalized_acceleration_output_port()

    def reaction(self, angle: float, rate: float, torque: float) -> RigReaction:
        """Returns acceleration and wrench at a state and a motor torque; friction and air as in the
        scenario.

        Args:
            angle: angle of the rig, rad, positive downstream.
            rate: rate of that angle, rad/s.
            torque: torque of the motor on bar or tail along the joint axis, N m; positive swings
                downstream.

        Raises:
            UserError: the angle is outside `mount.angle_limit`, or an argument is not finite.
        """
        self.set_state(angle, rate, torque)
        acceleration = vector_of(self._acceleration, self._plant_context)
        return RigReaction(float(acceleration[0]), np.array(vector_of(self._wrench, self._context)))

    def torque_of(self, current: float) -> float:
        """Returns the motor torque along the joint axis (N m) at a current (A).

        A positive current pushes upstream. UserError beyond the limit of the motor.
        """
        scenario = self.scenario
        if scenario.is_robot:
            limit = scenario.robot_motor.torque_limit / scenario.robot.torque_constant
        else:
            limit = scenario.maxon.current_limit
        check_range("current", current, -limit, limit, "A")
        return -current * current_constant(scenario)

    def holding_current(self, angle: float) -> float:
        """Returns the motor current that holds an angle, A.

        Raises:
            UserError: the current is beyond the limit of the motor, or the angle outside its range.
        """
        free = self.reaction(angle, 0.0, 0.0).acceleration
        torque = -free * float(self.plant.CalcMassMatrix(self._plant_context)[0, 0])
        current = -torque / current_constant(self.scenario)
        try:
            self.torque_of(current)
        except UserError as error:
            raise UserError(
                f"holding {angle:g} rad ({math.degrees(angle):.1f} degrees) takes {error}"
            ) from None
        return current

    def is_exposed(self, angle: float) -> bool:
        """Tells whether any of the tail is inside the jet at an angle (rad)."""
        force = self._rig.tail_force
        if force is None:
            return False
        self.set_state(angle, 0.0, 0.0)
        validity = vector_of(
            force.GetOutputPort("validity"), force.GetMyContextFromRoot(self._context)
        )
        return bool(np.any(validity > 0.0))

    def set_state(self, angle: float, rate: float, torque: float) -> None:
        """Puts the rig into a state; see `reaction`."""
        limit = self.scenario.mount.angle_limit + 1e-9
        check_range("angle, see mount.angle_limit", angle, -limit, limit, "rad")
        check_range("rate", rate, -math.inf, math.inf, "rad/s")
        check_range("torque", torque, -math.inf, math.inf, "N m")
        self.plant.SetPositionsAndVelocities(self._plant_context, np.array([angle, rate]))
        self._torque.FixValue(self._context, np.array([torque]))


def current_constant(scenario: RigScenario) -> float:
    """Returns the torque per ampere at the joint, N m/A; a positive current pushes upstream."""
    return scenario.robot.torque_constant if scenario.is_robot else scenario.maxon.torque_constant


class SupportWrench(LeafSystem):
    """The reaction at the force sensor as a vector.

    Input ports:
        reaction_forces: list[SpatialForce], from the plant.
    Output ports:
        wrench (6): wrench of the support on the rig at W, W axes: force N, torque N m.

    Args:
        joint: index of the weld between world and mount, whose child frame is W.
    """

    def __init__(self, joint: int):
        super().__init__()
        self._joint = joint
        self._reactions = self.DeclareAbstractInputPort(
            "reaction_forces", Value[list[SpatialForce]]()
        )
        declare_output(self, "wrench", 6, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        reactions: Any = self._reactions.Eval(context)
        coefficients = reactions[self._joint].get_coeffs()
        output.SetFromVector(np.concatenate((coefficients[3:], coefficients[:3])))


class SpanwiseBalance(LeafSystem):
    """Takes the centripetal inertia of the added mass off the tail: added mass acts across the
    tail's axis only.

    The added mass is a body welded to the tail. On a pendulum its only acceleration along the axis
    is the centripetal one, so a push of that size makes the wrench exact, without one more degree
    of freedom.

    Input ports:
        plant_state (2): angle, rad, and rate, rad/s.
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
        declare_spatial_forces(self, self._calc)

    def _calc(self, context: Context, output: Any) -> None:
        plant = self._plant
        mine = self._context
        state = vector_of(self._state, context)
        plant.SetPositionsAndVelocities(mine, state)
        pose = plant.EvalBodyPoseInWorld(mine, plant.get_body(self._body))
        axis = pose.rotation().matrix()[:, 2]
        pivot = plant.EvalBodyPoseInWorld(
            mine, plant.GetJointByName("swing").child_body()
        ).translation()
        distance = axis @ (pose.translation() - pivot)
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._body
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(np.zeros(3), -self._mass * distance * state[1] ** 2 * axis)
        output.set_value([force])
