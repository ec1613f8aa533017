"""The tail's two joints as they are driven: motors and friction, wired to a plant."""

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, System

from aerodima.workbench.actuators.ak70 import TailJoints, TailMotors
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.systems.connections import select


def add_tail_drive(
    builder: DiagramBuilder, plant: MultibodyPlant, arm: ModelInstanceIndex, scenario: Scenario
) -> System:
    """Adds motors and joint friction of a tail arm and wires them to its actuation.

    Args:
        builder: that owns the plant.
        plant: finalised, discrete.
        arm: model instance of `tail_sdf` in the plant.
        scenario: motors, friction, arm and step.

    Returns:
        The `TailMotors`; its inputs `tail_pitch_command` and `tail_roll_command` are left to the caller.
    """
    joints = [plant.GetJointByName(name, arm) for name in ("tail_pitch", "tail_roll")]
    angles = [joint.position_start() for joint in joints]
    rates = [joint.velocity_start() for joint in joints]
    state = select(
        builder,
        "tail_joint_state",
        plant.get_state_output_port(),
        angles + [plant.num_positions() + rate for rate in rates],
    )
    motors = TailMotors(TailJoints.of_scenario(scenario))
    builder.AddNamedSystem("tail_torques", motors)
    builder.Connect(state, motors.GetInputPort("joint_state"))
    builder.Connect(motors.GetOutputPort("actuation"), plant.get_actuation_input_port(arm))
    builder.Connect(plant.get_net_actuation_output_port(arm), motors.GetInputPort("joint_torque"))
    acceleration = select(builder, "tail_joint_acceleration", plant.GetOutputPort("generalized_acceleration"), rates)
    builder.Connect(acceleration, motors.GetInputPort("joint_acceleration"))
    return motors
