"""The Maxon motor of the cheetah rig, driven by current."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.core.port_wiring import declare_output, vector_of
from aerodima.workbench.scenario.rig_scenario import MaxonParameters


class MaxonMotor(LeafSystem):
    """Turns current into torque on the bar: torque = -k_t N current, since a positive current
    pushes the tail upstream.

    The current loop is taken as ideal inside the limit of the amplifier. The reflected rotor
    inertia is part of the plant (cheetah_rig.sdf). A NaN in the command gives no current.

    Input ports:
        current_command (1): commanded current, A.
    Output ports:
        torque (1): torque along the joint axis, N m; positive swings downstream.
        current (1): current after the limit, A.
    """

    def __init__(self, settings: MaxonParameters):
        super().__init__()
        self._settings = settings
        self._command = self.DeclareVectorInputPort("current_command", 1)
        declare_output(self, "torque", 1, self._calc_torque)
        declare_output(self, "current", 1, self._calc_current)

    def current(self, command: float) -> float:
        """Returns the current that flows at a command, A."""
        limit = self._settings.current_limit
        return float(np.clip(np.nan_to_num(command), -limit, limit))

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        command = vector_of(self._command, context)
        output[0] = -self._settings.torque_constant * self.current(command[0])

    def _calc_current(self, context: Context, output: BasicVector) -> None:
        output[0] = self.current(vector_of(self._command, context)[0])
