"""One AK70-10 in MIT mode on a continuous plant: the robot's tail on the wind-tunnel rig (design section 6)."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.actuators.ak70 import mit_torque, torque_speed_limits
from aerodima.workbench.config.car_parameters import TailMotorParameters
from aerodima.workbench.config.signal_table import TAIL_COMMAND
from aerodima.workbench.systems.port_values import vector_of


class MitMotor(LeafSystem):
    """The law of `mit_torque` at this instant, as the motor's firmware closes it at kHz.

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
        self._motor, self._torque_constant = motor, torque_constant
        self._line = torque_speed_limits(motor)
        self._state = self.DeclareVectorInputPort("joint_state", 2)
        self._command = self.DeclareVectorInputPort("tail_command", TAIL_COMMAND.size)
        tickets = {self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("torque", 1, self._calc_torque, tickets)
        self.DeclareVectorOutputPort("current", 1, self._calc_current, tickets)

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
