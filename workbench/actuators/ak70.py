"""AK70-10 tail motors in MIT mode (design section 6)."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from workbench.parameters import TailMotorParameters
from workbench.ports import TAIL_COMMAND

JOINTS = 2
"""Pitch and roll, in this order, as in the tail plant."""


def torque_speed_limits(motor: TailMotorParameters) -> tuple[float, float]:
    """Stall torque (N m) and no-load speed (rad/s) at the output, from the pack voltage.

    Ideal DC machine: the torque constant in N m/A equals 1/speed_constant in SI units.
    """
    no_load_speed = motor.pack_voltage * motor.speed_constant / motor.gear_ratio
    stall_torque = motor.pack_voltage / motor.winding_resistance / motor.speed_constant * motor.gear_ratio
    return stall_torque, no_load_speed


def mit_torque(
    position: float, speed: float, command: tuple[float, ...], motor: TailMotorParameters, line: tuple[float, float]
) -> float:
    """Torque (N m) of one motor in MIT mode, positive along the joint axis.

    tau = kp (q_d - q) + kd (qd_d - qd) + tau_ff with gains clipped to the frame's range, then held inside the peak
    torque and the torque-speed line: near the no-load speed the motor cannot push further, braking stays possible.

    Args:
        position: joint angle, rad.
        speed: joint rate, rad/s.
        command: q_d rad, qd_d rad/s, kp N m/rad, kd N m s/rad, tau_ff N m.
        motor: limits.
        line: stall torque N m and no-load speed rad/s, from `torque_speed_limits`.
    """
    q_d, qd_d, kp, kd, feedforward = command
    kp = min(max(kp, 0.0), motor.kp_max)
    kd = min(max(kd, 0.0), motor.kd_max)
    torque = kp * (q_d - position) + kd * (qd_d - speed) + feedforward
    stall, no_load = line
    upper = min(motor.torque_limit, max(0.0, stall * (1.0 - speed / no_load)))
    lower = max(-motor.torque_limit, min(0.0, -stall * (1.0 + speed / no_load)))
    return min(max(torque, lower), upper)


class TailMotors(LeafSystem):
    """The two tail motors: commands in, joint torques out.

    The law is evaluated at every step of the plant, as the motor's own firmware does it at kHz. The reflected rotor
    inertia is part of the plant (tail.sdf). A NaN in a command gives zero torque for that joint.

    Input ports:
        joint_state (4): pitch and roll angle rad, pitch and roll rate rad/s, from the plant.
        tail_pitch_command (5), tail_roll_command (5): position rad, velocity rad/s, kp N m/rad, kd N m s/rad,
            torque N m.
    Output ports:
        torque (2): pitch and roll, N m, along the joint axes.
    """

    def __init__(self, motor: TailMotorParameters):
        super().__init__()
        self._motor = motor
        self._line = torque_speed_limits(motor)
        self._state = self.DeclareVectorInputPort("joint_state", 2 * JOINTS)
        self._commands = [
            self.DeclareVectorInputPort(f"tail_{joint}_command", TAIL_COMMAND.size) for joint in ("pitch", "roll")
        ]
        self.DeclareVectorOutputPort(
            "torque", JOINTS, self._calc_torque, prerequisites_of_calc={self.all_input_ports_ticket()}
        )

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        joint_state: Any = self._state.Eval(context)
        state = joint_state.tolist()
        torques = []
        for joint, port in enumerate(self._commands):
            command: Any = port.Eval(context)
            torque = mit_torque(state[joint], state[JOINTS + joint], command.tolist(), self._motor, self._line)
            torques.append(torque if torque == torque else 0.0)
        output.SetFromVector(np.array(torques))
