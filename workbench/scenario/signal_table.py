"""The signals of car and rig in one table: ports, their fields, and their columns in a log.

The simulated and the real station have the same vector ports (design section 9). A column's name
ends in its unit; a rate reads `rad_per_s`, a moment `n_m`, a number without unit has none. Columns
with `_truth` exist in simulated runs only. Plain Python: the controllers of the no-Drake mode read
the same names.

Signs and axes of the car: body frame B x forward, y left, z up, its origin on the ground under the
rear axle; W is the world, z up; steering and yaw positive to the left; tail roll 0 = straight up,
positive to the right; acceleration is linear (gravity removed) in body axes. Of the rig: angles are
0 hanging and positive downstream; a positive motor current pushes upstream; forces and torques are
readings of the force sensor in W axes (design section 4), zeroed: add the offsets of Table 4.4
(`offsets_to_add` in a log's metadata) for the wrench of the support on the rig.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, product

from aerodima.workbench.core.port_fields import PortFields

AXLES = ("front", "rear")
SIDES = ("left", "right")
WHEELS = tuple(f"{axle}_{side}" for axle in AXLES for side in SIDES)
"""front_left, front_right, rear_left, rear_right: the order of every quantity per wheel."""
GROUND_CONTACTS = ("cage", "board", "tail")
PLANT_POSITION_PREFIX = "plant_position_"
RIG_KINDS = ("static", "swing", "bar_swing", "robot_swing")
"""Kinds of rig log: tail held by the motor, tail released, bar released without a tail, tail of the
robot swung."""
TIME = "time_s"
UNARMED_SOURCES = ("sail", "imu", "speed", "operator")
"""Sources of `status` that report before the motors are armed."""
STATUS_SOURCES = ("tail_pitch", "tail_roll", *UNARMED_SOURCES)
RIG_STATUS_SOURCES = ("motor", "force", "operator")
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Column:
    """One column of a run log.

    Attributes:
        name: exact name of the column.
        unit: unit of the column; "" for a pure number.
        meaning: meaning of the column in words.
        optional: whether logs were written before the column existed; where it is not in a file it
            is read as NaN.
    """

    name: str
    unit: str
    meaning: str
    optional: bool = False


def _columns(name: str, unit: str, meaning: str) -> list[Column]:
    """Make the columns of a line: `stem_{x,y}_m` gives two, with x or y for {} in the meaning."""
    choices = [words.split(",") for words in re.findall(r"\{(.*?)\}", name)]
    template = re.sub(r"\{.*?\}", "{}", name)
    return [
        Column(template.format(*words), unit, meaning.format(*words)) for words in product(*choices)
    ]


def _ports(table: str) -> dict[str, list[Column]]:
    """Read a table with a line `[port]` and below it a line `name | unit | meaning` per column."""
    ports: dict[str, list[Column]] = {}
    for line in table.strip().splitlines():
        if line.startswith("["):
            port = line.strip("[]")
            ports[port] = []
        else:
            name, unit, meaning = [cell.strip() for cell in line.split("|")]
            ports[port] += _columns(name, unit, meaning)
    return ports


def _status_fields(sources: Sequence[str]) -> tuple[str, ...]:
    return (*(f"{source}_{what}" for source in sources for what in ("age", "fault")), "armed")


STEERING_ANGLE = PortFields("SteeringAngle", ("steering_angle",))
"""Steering command, rad, positive to the left."""
THROTTLE = PortFields("Throttle", ("throttle",))
"""Throttle command, -1 to 1."""
TAIL_COMMAND = PortFields("TailCommand", ("position", "velocity", "kp", "kd", "torque"))
"""Command to one tail motor in MIT mode: rad, rad/s, N m/rad, N m s/rad, N m."""
TAIL_STATE = PortFields(
    "TailState", ("pitch_angle", "roll_angle", "sail_angle", "pitch_rate", "roll_rate", "sail_rate")
)
"""Angles (rad) and rates (rad/s) as the encoders report them."""
TAIL_TORQUE = PortFields("TailTorque", ("pitch", "roll"))
"""Torques as the motors report them, N m."""
IMU = PortFields(
    "ImuSample",
    (
        "roll",
        "pitch",
        "yaw",
        *(f"{what}_{axis}" for what in ("gyro", "acceleration") for axis in _AXES),
    ),
)
"""Attitude, rad; angular rate, rad/s; acceleration without gravity, m/s2. All in body axes."""
SPEED = PortFields("Speed", ("speed",))
"""Horizontal speed, m/s."""
STATUS = PortFields("Status", _status_fields(STATUS_SOURCES))
"""Age of the newest sample (s) and fault code (0 = none) of each source; armed is 0 or 1."""
PLANNED_TURN = PortFields("PlannedTurn", ("planned_turn",))
"""The turn that the driver announces to the tail controller, from the start of the run on: +1 left,
-1 right, 0 none."""
RIG_STATUS = PortFields("RigStatus", _status_fields(RIG_STATUS_SOURCES))
"""Status of the rig; its fields are like those of `STATUS`."""

STATION_INPUTS: dict[str, PortFields] = {
    "steering_angle": STEERING_ANGLE,
    "throttle": THROTTLE,
    "tail_pitch_command": TAIL_COMMAND,
    "tail_roll_command": TAIL_COMMAND,
}
STATION_OUTPUTS: dict[str, PortFields] = {
    "tail_state": TAIL_STATE,
    "tail_torque": TAIL_TORQUE,
    "imu": IMU,
    "speed": SPEED,
    "status": STATUS,
}


CAR_PORTS = _ports("""
[steering_angle]
steering_command_rad | rad | steering command before the servo, positive to the left
[throttle]
throttle_command | | throttle command, -1 to 1
[planned_turn]
planned_turn | | turn that the driver announces: +1 left, -1 right, 0 none
[tail_pitch_command]
tail_pitch_command_position_rad | rad | tail pitch position command
tail_pitch_command_velocity_rad_per_s | rad/s | tail pitch velocity command
tail_pitch_command_kp | N m/rad | tail pitch position gain
tail_pitch_command_kd | N m s/rad | tail pitch velocity gain
tail_pitch_command_torque_n_m | N m | tail pitch feed-forward torque
[tail_roll_command]
tail_roll_command_position_rad | rad | tail roll position command
tail_roll_command_velocity_rad_per_s | rad/s | tail roll velocity command
tail_roll_command_kp | N m/rad | tail roll position gain
tail_roll_command_kd | N m s/rad | tail roll velocity gain
tail_roll_command_torque_n_m | N m | tail roll feed-forward torque
[state]
controller_state | | number of the tail controller's state
[tail_state]
tail_{pitch,roll}_angle_rad | rad | tail {} angle
sail_angle_rad | rad | sail angle
tail_{pitch,roll}_rate_rad_per_s | rad/s | tail {} rate
sail_rate_rad_per_s | rad/s | sail rate
[tail_torque]
tail_{pitch,roll}_torque_n_m | N m | torque of the tail {} motor
[imu]
imu_{roll,pitch,yaw}_rad | rad | IMU {}
imu_gyro_{x,y,z}_rad_per_s | rad/s | IMU angular rate, B axes, {}
imu_acceleration_{x,y,z}_m_per_s2 | m/s2 | IMU linear acceleration, gravity removed, B axes, {}
[speed]
speed_m_per_s | m/s | ground speed of the GPS
[status]
status_tail_pitch_age_s | s | age of the newest sample of tail_pitch
status_tail_pitch_fault | | fault code of tail_pitch, 0 = none
status_tail_roll_age_s | s | age of the newest sample of tail_roll
status_tail_roll_fault | | fault code of tail_roll, 0 = none
status_sail_age_s | s | age of the newest sample of sail
status_sail_fault | | fault code of sail, 0 = none
status_imu_age_s | s | age of the newest sample of imu
status_imu_fault | | fault code of imu, 0 = none
status_speed_age_s | s | age of the newest sample of speed
status_speed_fault | | fault code of speed, 0 = none
status_operator_age_s | s | age of the newest sample of operator
status_operator_fault | | fault code of operator, 0 = none
status_armed | | 1 when the tail motors are armed
[roll_estimate]
roll_estimate_rad | rad | roll angle from the on-board estimator
[roll_rate_estimate]
roll_rate_estimate_rad_per_s | rad/s | roll rate from the on-board estimator
""")
"""Columns of each port of driver, tail controller, station or roll estimator, which a run on the
real car has too. Sensor columns hold their last sample."""

CAR_TRUTH = _ports("""
[body_truth]
position_{x,y,z}_truth_m | m | position of Bo in W, {}
roll_truth_rad | rad | roll of B, positive leans to the right
pitch_truth_rad | rad | pitch of B, positive nose down
yaw_truth_rad | rad | yaw of B, positive to the left, unwrapped
tilt_truth_rad | rad | angle of the body's z axis from the world's
velocity_{x,y,z}_truth_m_per_s | m/s | velocity of Bo in W, B axes, {}
gyro_{x,y,z}_truth_rad_per_s | rad/s | angular velocity of B in W, B axes, {}
acceleration_{x,y,z}_truth_m_per_s2 | m/s2 | acceleration at the IMU, gravity removed, B axes, {}
com_{x,y,z}_truth_m | m | centre of mass of the whole vehicle in W, {}
[tail_truth]
tail_tip_{x,y,z}_truth_m | m | tip of the tail in W, {}
tail_com_{x,y,z}_truth_m | m | centre of mass of the tail in W, {}
tail_momentum_{x,y,z}_truth_n_s | N s | linear momentum of the tail, W axes, {}
tail_angular_momentum_{x,y,z}_truth_n_m_s | N m s \
| angular momentum of the tail about Wo, W axes, {}
tail_force_{x,y,z}_truth_n | N | aerodynamic force on the tail, W axes, {}
tail_force_moment_{x,y,z}_truth_n_m | N m | aerodynamic moment on the tail about Wo, W axes, {}
tail_power_truth_w | W | mechanical power of the tail motors
[contact_truth]
wheel_force_{front_left,front_right,rear_left,rear_right}_{x,y,z}_truth_n | N \
| force of the ground on the {} wheel in the last step, W axes, {}
wheel_contact_{front_left,front_right,rear_left,rear_right}_{x,y,z}_truth_m | m \
| contact point of the {} wheel in W, weighted by load, {}
ground_contact_{cage,board,tail}_truth_n | N | magnitude of the ground's force on the {}
drive_power_truth_w | W | mechanical power of the drive
[wind_truth]
wind_{x,y,z}_truth_m_per_s | m/s | velocity of the air, W axes, {}
""")
"""Columns of each port of a simulated station. A car without a tail has no `tail_truth`, a run
without wind no `wind_truth`."""

RIG_PORTS = _ports("""
[rig_state]
angle_rad | rad | angle of the tail, 0 hanging, positive swung downstream
angular_velocity_rad_per_s | rad/s | rate of that angle
[motor_current]
current_a | A | motor current, positive pushes the tail upstream
[force_torque]
force_{x,y,z}_n | N | force reading, W axes, {}
torque_{x,y,z}_n_m | N m | torque reading at W, W axes, {}
""")
"""Columns of each port of a rig's station. W has its origin at the force sensor's point, z up, x
along the motor axis; the wind blows towards -y."""

RIG_TRUTH = _ports("""
[state_truth]
angle_truth_rad | rad | angle of the tail
angular_velocity_truth_rad_per_s | rad/s | rate of that angle
[wrench_truth]
force_{x,y,z}_truth_n | N | force of the support on the rig, W axes, {}
torque_{x,y,z}_truth_n_m | N m | torque of the support on the rig at W, W axes, {}
[motor_torque_truth]
motor_torque_truth_n_m | N m | torque of the motor
""")
"""Columns of each port of a simulated rig in the log of a swing."""


def names_of(columns: Iterable[Column]) -> list[str]:
    """List the names of columns."""
    return [column.name for column in columns]


def sensor_columns() -> list[Column]:
    """List every column that a run on the real car has too."""
    return [Column(TIME, "s", "time since the start of the run"), *chain(*CAR_PORTS.values())]


def plant_position_columns(position_names: Iterable[str]) -> list[Column]:
    """Make a column per plant position, in the order of `plant.GetPositionNames()`."""
    return [
        Column(f"{PLANT_POSITION_PREFIX}{name}", "rad, m or 1", f"plant position {name}")
        for name in position_names
    ]


def truth_columns() -> list[Column]:
    """List every ground-truth column of a run with a tail and without wind; no plant positions."""
    return [*chain(*(CAR_TRUTH[port] for port in CAR_TRUTH if port != "wind_truth"))]


def rig_columns() -> list[Column]:
    """List the columns of a wind-tunnel log."""
    return [Column(TIME, "s", "time since the start of the log"), *chain(*RIG_PORTS.values())]
