"""Names, order and sizes of the vector ports that the simulated and the real rig share (design section 9).

Angles are 0 hanging and positive downstream; a positive motor current pushes upstream; forces and torques are readings
of the force sensor in W axes (design section 4).
"""

from aerodima.workbench.config.ports import TAIL_COMMAND, PortFields

RIG_STATUS_SOURCES = ("motor", "force", "operator")

CURRENT_COMMAND = PortFields("CurrentCommand", ("current",))
"""Of the Maxon motor, A."""

RIG_STATE = PortFields("RigState", ("angle", "rate"))
"""rad and rad/s, as encoder or motor report them."""

MOTOR_CURRENT = PortFields("MotorCurrent", ("current",))
"""A."""

FORCE_TORQUE = PortFields("ForceTorque", ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z"))
"""N and N m, zeroed: add the offsets for the wrench of the support on the rig."""

RIG_STATUS = PortFields(
    "RigStatus", (*(f"{source}_{what}" for source in RIG_STATUS_SOURCES for what in ("age", "fault")), "armed")
)
"""Per source: age of its newest sample in s, fault code (0 = none). Armed: 0 or 1."""

ROBOT_RIG_INPUTS: dict[str, PortFields] = {"tail_command": TAIL_COMMAND}
CHEETAH_RIG_INPUTS: dict[str, PortFields] = {"current_command": CURRENT_COMMAND}

RIG_OUTPUTS: dict[str, PortFields] = {
    "rig_state": RIG_STATE,
    "motor_current": MOTOR_CURRENT,
    "force_torque": FORCE_TORQUE,
    "status": RIG_STATUS,
}
