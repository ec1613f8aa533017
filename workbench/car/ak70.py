"""AK70-10 motors in MIT mode (design section 6): on the joints of the car's tail, and on the joint
of the robot's tail on the rig.
"""

from collections.abc import Callable

from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem, OutputPort

from aerodima.workbench.car.laws import (
    joint_friction,
    mit_torque,
    torque_speed_limits,
)
from aerodima.workbench.car.tail_plant import arm_inertia, inertia_about_joints
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_wiring import declare_output, vector_of
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import TAIL_COMMAND
from aerodima.workbench.scenario.tail_parameters import (
    FrictionParameters,
    TailMotorParameters,
)

TAIL_JOINTS = ("tail_pitch", "tail_roll")
"""Joints that a motor drives, in the order of all vectors of two."""


class TailMotor(LeafSystem):
    """One motor on a joint of the car's tail: `mit_torque` at the end of the plant's step.

    The load on the joint is that of the last step, inertia times acceleration less the torque that
    acted, with the friction of this instant. The reflected rotor inertia is part of the plant
    (tail.sdf).

    Input ports:
        joint_motion (6): angle, rad, and rate, rad/s, of the joint; 1, or 0 before the first step;
            rate before the last step, rad/s; torque of motor and friction in that step, N m; angle
            of the roll joint now, rad.
        tail_command (5): position rad, velocity rad/s, kp N m/rad, kd N m s/rad, torque N m; a NaN
            in it gives zero torque.
    Output ports:
        torque (1): torque along the joint axis, N m.

    Args:
        scenario: scenario with the motor, the arm, the friction of the joints and the plant's step.
        joint: name of the joint, one of `TAIL_JOINTS`.
    """

    def __init__(self, scenario: Scenario, joint: str) -> None:
        super().__init__()
        motor = scenario.tail_motor
        self._motor = motor
        self._axis = TAIL_JOINTS.index(joint)
        self._arm = arm_inertia(scenario.tail, motor, scenario.car)
        self._friction = scenario.friction
        self._step = scenario.simulation.step
        self._line = torque_speed_limits(motor)
        self._rotor = motor.reflected_inertia
        self._motion = self.DeclareVectorInputPort("joint_motion", 6)
        self._command = self.DeclareVectorInputPort("tail_command", TAIL_COMMAND.size)
        declare_output(self, "torque", 1, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        motion = vector_of(self._motion, context).tolist()
        angle, rate, stepped, last_rate, last_torque, roll = motion
        command = vector_of(self._command, context).tolist()
        inertia = inertia_about_joints(self._arm, roll)[self._axis] + self._rotor
        acceleration = stepped * (rate - last_rate) / self._step
        law = self._friction
        friction = joint_friction(rate, law.coulomb, law.viscous, law.tanh_gain)
        load = inertia * acceleration - last_torque + friction
        ahead = (self._step, inertia, load)
        torque = mit_torque(angle, rate, command, self._motor, self._line, ahead)
        output[0] = torque if torque == torque else 0.0


class JointFriction(LeafSystem):
    """Friction of n joints, added to the torques of their motors.

    Input ports:
        rates (n): rates of the joints, rad/s.
        motor_torques (n): torques of their motors, N m; a NaN counts as 0.
    Output ports:
        joint_torques (n): torques of motor and friction together, N m.

    Args:
        law: parameters of the friction law, see `joint_friction`.
        size: number of joints, n.
    """

    def __init__(self, law: FrictionParameters, size: int) -> None:
        super().__init__()
        self.set_name("joint_friction")
        self._friction = law
        self._rates = self.DeclareVectorInputPort("rates", size)
        self._torques = self.DeclareVectorInputPort("motor_torques", size)
        declare_output(self, "joint_torques", size, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        law = self._friction
        rates = vector_of(self._rates, context).tolist()
        torques = vector_of(self._torques, context).tolist()
        for joint, (rate, torque) in enumerate(zip(rates, torques, strict=True)):
            driving = torque if torque == torque else 0.0  # a motor of the user may give NaN
            output[joint] = driving + joint_friction(rate, law.coulomb, law.viscous, law.tanh_gain)


TailMotorFactory = Callable[["Scenario", str], LeafSystem]
"""Makes the motor of one of `TAIL_JOINTS`. Its output port `torque` (1) drives the joint, N m. It
has only the input ports that it needs: `joint_state` (2), angle, rad, and rate, rad/s, of the
joint, or those of `TailMotor`."""


def add_tail_motor(
    builder: DiagramBuilder,
    make: TailMotorFactory,
    scenario: Scenario,
    joint: str,
    **inputs: OutputPort,
) -> LeafSystem:
    """Adds a motor, named after its joint, and connects those inputs for which it has a port.

    Raises:
        UserError: the motor has no output port `torque` (1), or an input port of another name.
    """
    motor = make(scenario, joint)
    motor.set_name(f"{joint}_motor")
    builder.AddSystem(motor)
    for index in range(motor.num_input_ports()):
        port = motor.get_input_port(index)
        source = inputs.get(port.get_name())
        if source is not None:
            builder.Connect(source, port)
        elif port.get_name() != "tail_command":
            raise UserError(
                f"tail_motor: input port {port.get_name()!r}; must be one of tail_command, "
                f"{', '.join(inputs)}"
            )
    if not motor.HasOutputPort("torque") or motor.GetOutputPort("torque").size() != 1:
        raise UserError("tail_motor: must have an output port 'torque' with one element")
    return motor


class MitMotor(LeafSystem):
    """One motor on a continuous plant, on the robot's wind-tunnel rig: `mit_torque` at this
    instant.

    The motor's firmware closes the loop at kHz.

    A NaN in the command gives zero torque. The reflected rotor inertia is part of the plant.

    Input ports:
        joint_state (2): angle, rad, and rate, rad/s, of the joint.
        tail_command (5): position rad, velocity rad/s, kp N m/rad, kd N m s/rad, torque N m.
    Output ports:
        torque (1): torque along the joint axis, N m.
        current (1): current, A, positive against the joint axis, as on the rig with the Maxon
            motor.

    Args:
        motor: parameters of the motor, with its limits.
        torque_constant: torque at the output per ampere, N m/A.
    """

    def __init__(self, motor: TailMotorParameters, torque_constant: float):
        super().__init__()
        self._motor = motor
        self._torque_constant = torque_constant
        self._line = torque_speed_limits(motor)
        self._state = self.DeclareVectorInputPort("joint_state", 2)
        self._command = self.DeclareVectorInputPort("tail_command", TAIL_COMMAND.size)
        declare_output(self, "torque", 1, self._calc_torque)
        declare_output(self, "current", 1, self._calc_current)

    def _torque(self, context: Context) -> float:
        angle, rate = vector_of(self._state, context).tolist()
        command = vector_of(self._command, context).tolist()
        torque = mit_torque(angle, rate, command, self._motor, self._line)
        return torque if torque == torque else 0.0

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        output[0] = self._torque(context)

    def _calc_current(self, context: Context, output: BasicVector) -> None:
        output[0] = -self._torque(context) / self._torque_constant
