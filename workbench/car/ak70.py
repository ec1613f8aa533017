"""AK70-10 motors in MIT mode (design section 6): on the tail of the car, and on that of the robot
on the rig.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.car.tail_plant import ArmInertia, FrictionLaw, arm_inertia, smooth_friction
from aerodima.workbench.core.port_wiring import vector_of
from aerodima.workbench.core.system_lifetime import weak_callback
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import TAIL_COMMAND
from aerodima.workbench.scenario.tail_parameters import TailMotorParameters

ROLL = 1
"""Pitch and roll joint stand in this order."""
NOW = (0.0, 1.0, 0.0)
"""Step without length, at whose instant a law holds."""


def torque_speed_limits(motor: TailMotorParameters) -> tuple[float, float]:
    """Stall torque (N m) and no-load speed (rad/s) at the output, from the pack voltage.

    Ideal DC machine: the torque constant in N m/A equals 1/speed_constant in SI units.
    """
    no_load_speed = motor.pack_voltage * motor.speed_constant / motor.gear_ratio
    stall_torque = (
        motor.pack_voltage / motor.winding_resistance / motor.speed_constant * motor.gear_ratio
    )
    return stall_torque, no_load_speed


def mit_torque(
    position: float,
    speed: float,
    command: Sequence[float],
    motor: TailMotorParameters,
    line: tuple[float, float],
    ahead: tuple[float, float, float] = NOW,
) -> float:
    """Torque (N m) of one motor in MIT mode, positive along the joint axis.

    tau = kp (q_d - q) + kd (qd_d - qd) + tau_ff with gains clipped to the frame's range, all of it
    wrong by the error of the torque constant, then held inside the peak torque and the torque-speed
    line: near the no-load speed the motor cannot push further, braking stays possible.

    The firmware closes this loop at kHz, the plant steps at 2 ms: damping that acts on the rate of
    the beginning of a step would push a light joint back and forth (kd h / I > 2 for the pitch
    joint of a tail that lies sideways). So angle and rate are those of the end of the step, q + h v
    and v = qd + (tau + load) h / I, solved for tau.

    Args:
        position: joint angle, rad.
        speed: joint rate, rad/s.
        command: q_d rad, qd_d rad/s, kp N m/rad, kd N m s/rad, tau_ff N m.
        motor: limits.
        line: stall torque N m and no-load speed rad/s, from `torque_speed_limits`.
        ahead: length of the plant's step, s, inertia of the joint with the reflected rotor, kg m2,
            and torque on it from all but its motor, N m; by default the law holds at this instant.
    """
    q_d, qd_d, kp, kd, feedforward = command
    scale = 1.0 + motor.torque_error
    kp = scale * min(max(kp, 0.0), motor.kp_max)
    kd = scale * min(max(kd, 0.0), motor.kd_max)
    step, inertia, load = ahead
    coasting = speed + step * load / inertia
    torque = kp * (q_d - position - step * coasting) + kd * (qd_d - coasting) + scale * feedforward
    torque /= 1.0 + step * (kd + step * kp) / inertia
    stall, no_load = line
    upper = min(motor.torque_limit, max(0.0, stall * (1.0 - speed / no_load)))
    lower = max(-motor.torque_limit, min(0.0, -stall * (1.0 + speed / no_load)))
    return min(max(torque, lower), upper)


class TailJoints:
    """What drives the tail's two joints: the motors' law at the end of the step, and the friction
    of the joints.

    The load on a joint is taken from the last step, inertia times acceleration less the torque that
    acted, with the friction of this instant. The reflected rotor inertia is part of the plant
    (tail.sdf).

    Args:
        motor: limits and rotor.
        arm: inertia of the arm about its joints.
        friction: of each joint.
        step: of the plant, s.
    """

    def __init__(
        self, motor: TailMotorParameters, arm: ArmInertia, friction: FrictionLaw, step: float
    ) -> None:
        self._motor = motor
        self._arm = arm
        self._friction = friction
        self._step = step
        self._line = torque_speed_limits(motor)
        self._rotor = motor.rotor_inertia * motor.gear_ratio**2

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> "TailJoints":
        """Motors, friction, arm and step of a scenario."""
        friction = scenario.friction
        law = smooth_friction(friction.coulomb, friction.viscous, friction.tanh_gain)
        inertia = arm_inertia(scenario.tail, scenario.tail_motor, scenario.car)
        return cls(scenario.tail_motor, inertia, law, scenario.simulation.step)

    def torques(
        self,
        angles: Sequence[float],
        rates: Sequence[float],
        accelerations: Sequence[float],
        last_torques: Sequence[float],
        commands: Sequence[Sequence[float]],
    ) -> list[tuple[float, float]]:
        """Motor and friction torque (N m) of each joint, pitch and roll in this order.

        Args:
            angles: rad.
            rates: rad/s.
            accelerations: of the plant's last step, rad/s2.
            last_torques: motor and friction together, of the plant's last step, N m.
            commands: per joint as in `mit_torque`; a NaN in it gives zero motor torque for that
                joint.
        """
        torques = []
        for joint, about_joint in enumerate(self._arm.about_joints(angles[ROLL])):
            angle = angles[joint]
            rate = rates[joint]
            inertia = about_joint + self._rotor
            friction = self._friction(rate)
            ahead = (
                self._step,
                inertia,
                inertia * accelerations[joint] - last_torques[joint] + friction,
            )
            torque = mit_torque(angle, rate, commands[joint], self._motor, self._line, ahead)
            torques.append((torque if torque == torque else 0.0, friction))
        return torques


class MitMotor(LeafSystem):
    """One motor on a continuous plant, on the robot's wind-tunnel rig: `mit_torque` at this
    instant.

    The motor's firmware closes the loop at kHz.

    A NaN in the command gives zero torque. The reflected rotor inertia is part of the plant.

    Input ports:
        joint_state (2): angle rad, rate rad/s.
        tail_command (5): position rad, velocity rad/s, kp N m/rad, kd N m s/rad, torque N m.
    Output ports:
        torque (1): N m along the joint axis.
        current (1): A, positive against the joint axis, as on the rig with the Maxon motor.

    Args:
        motor: limits.
        torque_constant: torque at the output per ampere, N m/A.
    """

    def __init__(self, motor: TailMotorParameters, torque_constant: float):
        super().__init__()
        self._motor = motor
        self._torque_constant = torque_constant
        self._line = torque_speed_limits(motor)
        self._state = self.DeclareVectorInputPort("joint_state", 2)
        self._command = self.DeclareVectorInputPort("tail_command", TAIL_COMMAND.size)
        tickets = {self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("torque", 1, weak_callback(self._calc_torque), tickets)
        self.DeclareVectorOutputPort("current", 1, weak_callback(self._calc_current), tickets)

    def _torque(self, context: Context) -> float:
        state = vector_of(self._state, context)
        command = vector_of(self._command, context)
        angle, rate = state.tolist()
        torque = mit_torque(angle, rate, command.tolist(), self._motor, self._line)
        return torque if torque == torque else 0.0

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._torque(context)]))

    def _calc_current(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([-self._torque(context) / self._torque_constant]))
