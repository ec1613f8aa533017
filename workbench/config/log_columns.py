"""The columns of a run log: name, unit and meaning.

A name ends in its unit; a rate reads `rad_per_s`, a moment `n_m`, a number without unit has none. Columns with
`_truth` exist in simulated runs only. Frames and signs are those of the car: B has x forward, y left, z up and its
origin on the ground under the rear axle; W is the world, z up. Tail roll is 0 upright and positive to the right.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aerodima.workbench.config.ports import STATUS_SOURCES

AXLES = ("front", "rear")
SIDES = ("left", "right")
WHEELS = tuple(f"{axle}_{side}" for axle in AXLES for side in SIDES)
"""front_left, front_right, rear_left, rear_right: the order of every quantity per wheel."""
GROUND_CONTACTS = ("cage", "board", "tail")
PLANT_POSITION_PREFIX = "plant_position_"
RIG_KINDS = ("static", "swing", "bar_swing", "robot_swing")
"""Kinds of rig log: tail held by the motor, tail let go, bar let go without a tail, tail of the robot swung."""
TIME = "time_s"
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Column:
    """One column of a run log: its exact name, its unit ("" for a pure number) and what it means."""

    name: str
    unit: str
    meaning: str


def _vector(stem: str, suffix: str, unit: str, meaning: str) -> list[Column]:
    """Three columns `<stem>_{x,y,z}_<suffix>`."""
    return [Column(f"{stem}_{axis}_{suffix}", unit, f"{meaning}, {axis}") for axis in _AXES]


def command_columns() -> list[Column]:
    """What the driver and the tail controller ask for."""
    columns = [
        Column(TIME, "s", "time since the start of the run"),
        Column("steering_command_rad", "rad", "steering command before the servo, positive to the left"),
        Column("throttle_command", "", "throttle command, -1 to 1"),
        Column("planned_turn", "", "turn that the driver announces: +1 left, -1 right, 0 none"),
    ]
    for joint in ("pitch", "roll"):
        stem = f"tail_{joint}_command"
        columns += [
            Column(f"{stem}_position_rad", "rad", f"tail {joint} position command"),
            Column(f"{stem}_velocity_rad_per_s", "rad/s", f"tail {joint} velocity command"),
            Column(f"{stem}_kp", "N m/rad", f"tail {joint} position gain"),
            Column(f"{stem}_kd", "N m s/rad", f"tail {joint} velocity gain"),
            Column(f"{stem}_torque_n_m", "N m", f"tail {joint} feed-forward torque"),
        ]
    return [*columns, Column("controller_state", "", "number of the tail controller's state")]


def tail_columns() -> list[Column]:
    """Tail angles, rates and motor torques as the station gives them."""
    parts = ("pitch", "roll", "sail")
    named = {"pitch": "tail_pitch", "roll": "tail_roll", "sail": "sail"}
    return [
        *(Column(f"{named[part]}_angle_rad", "rad", f"{part} angle") for part in ("pitch", "roll", "sail")),
        *(Column(f"{named[part]}_rate_rad_per_s", "rad/s", f"{part} rate") for part in parts),
        *(Column(f"tail_{part}_torque_n_m", "N m", f"torque of the tail {part} motor") for part in ("pitch", "roll")),
    ]


def sensor_columns() -> list[Column]:
    """Every column that a run on the real car has too. Sensor columns hold their last sample."""
    attitude = [Column(f"imu_{angle}_rad", "rad", f"IMU {angle}") for angle in ("roll", "pitch", "yaw")]
    return [
        *command_columns(),
        *tail_columns(),
        *attitude,
        *_vector("imu_gyro", "rad_per_s", "rad/s", "IMU angular rate, B axes"),
        *_vector("imu_acceleration", "m_per_s2", "m/s2", "IMU linear acceleration, gravity removed, B axes"),
        Column("speed_m_per_s", "m/s", "ground speed of the GPS"),
        *status_columns(),
        Column("roll_estimate_rad", "rad", "roll angle from the on-board estimator"),
        Column("roll_rate_estimate_rad_per_s", "rad/s", "roll rate from the on-board estimator"),
    ]


def status_columns() -> list[Column]:
    """Age of the newest sample and fault code of each source; whether the motors are armed."""
    columns: list[Column] = []
    for source in STATUS_SOURCES:
        columns.append(Column(f"status_{source}_age_s", "s", f"age of the newest sample of {source}"))
        columns.append(Column(f"status_{source}_fault", "", f"fault code of {source}, 0 = none"))
    return [*columns, Column("status_armed", "", "1 when the tail motors are armed")]


def body_truth_columns() -> list[Column]:
    """Motion of the chassis and the centre of mass of the whole vehicle."""
    return [
        *_vector("position", "truth_m", "m", "position of Bo in W"),
        Column("roll_truth_rad", "rad", "roll of B, positive leans to the right"),
        Column("pitch_truth_rad", "rad", "pitch of B, positive nose down"),
        Column("yaw_truth_rad", "rad", "yaw of B, positive to the left, unwrapped"),
        Column("tilt_truth_rad", "rad", "angle of the body's z axis from the world's"),
        *_vector("velocity", "truth_m_per_s", "m/s", "velocity of Bo in W, B axes"),
        *_vector("gyro", "truth_rad_per_s", "rad/s", "angular velocity of B in W, B axes"),
        *_vector("acceleration", "truth_m_per_s2", "m/s2", "acceleration at the IMU, gravity removed, B axes"),
        *_vector("com", "truth_m", "m", "centre of mass of the whole vehicle in W"),
    ]


def tail_truth_columns() -> list[Column]:
    """Motion of the tail, what the air does to it, and the work of its motors. Absent in a car without a tail."""
    return [
        *_vector("tail_tip", "truth_m", "m", "tip of the tail in W"),
        *_vector("tail_com", "truth_m", "m", "centre of mass of the tail in W"),
        *_vector("tail_momentum", "truth_n_s", "N s", "linear momentum of the tail, W axes"),
        *_vector("tail_angular_momentum", "truth_n_m_s", "N m s", "angular momentum of the tail about Wo, W axes"),
        *_vector("tail_force", "truth_n", "N", "aerodynamic force on the tail, W axes"),
        *_vector("tail_force_moment", "truth_n_m", "N m", "aerodynamic moment on the tail about Wo, W axes"),
        Column("tail_power_truth_w", "W", "mechanical power of the tail motors"),
    ]


def wind_truth_columns() -> list[Column]:
    """Motion of the air over the ground. Present in a run with wind only."""
    return _vector("wind", "truth_m_per_s", "m/s", "velocity of the air, W axes")


def contact_truth_columns() -> list[Column]:
    """Ground on the wheels and on the parts that should not touch it; power of the drive."""
    columns: list[Column] = []
    for wheel in WHEELS:
        columns += _vector(f"wheel_force_{wheel}", "truth_n", "N", f"force of the ground on the {wheel} wheel, W axes")
    for wheel in WHEELS:
        columns += _vector(
            f"wheel_contact_{wheel}", "truth_m", "m", f"contact point of the {wheel} wheel in W, weighted by load"
        )
    for part in GROUND_CONTACTS:
        columns.append(Column(f"ground_contact_{part}_truth_n", "N", f"magnitude of the ground's force on the {part}"))
    return [*columns, Column("drive_power_truth_w", "W", "mechanical power of the drive")]


def plant_position_columns(position_names: Iterable[str]) -> list[Column]:
    """One column per plant position, in the order of `plant.GetPositionNames()`; what the replay reads."""
    return [
        Column(f"{PLANT_POSITION_PREFIX}{name}", "rad, m or 1", f"plant position {name}") for name in position_names
    ]


def truth_columns() -> list[Column]:
    """Every ground-truth column of a simulated run with a tail, without the plant positions."""
    return [*body_truth_columns(), *tail_truth_columns(), *contact_truth_columns()]


def car_run_columns(position_names: Sequence[str] = ()) -> list[Column]:
    """Sensor columns, truth columns and plant positions: the whole table of a simulated run with a tail."""
    return [*sensor_columns(), *truth_columns(), *plant_position_columns(position_names)]


def rig_columns() -> list[Column]:
    """The table of a wind-tunnel log. W has its origin at the force sensor's point, z up, x along the motor axis.

    The wind blows towards -y. The forces are readings: add the offsets of Table 4.4 (`offsets_to_add` in the metadata)
    for the wrench of the support on the rig.
    """
    return [
        Column(TIME, "s", "time since the start of the log"),
        Column("angle_rad", "rad", "angle of the tail, 0 hanging, positive swung downstream"),
        Column("angular_velocity_rad_per_s", "rad/s", "rate of that angle"),
        Column("current_a", "A", "motor current, positive pushes the tail upstream"),
        *_vector("force", "n", "N", "force reading, W axes"),
        *_vector("torque", "n_m", "N m", "torque reading at W, W axes"),
    ]


def missing_columns(names: Iterable[str], kind: str, has_tail: bool) -> list[str]:
    """Names that a log of this kind must have and has not.

    A `car_run` has every sensor column; if it has one truth column it has all of them, apart from those of the tail
    when the car has none. A rig log needs time and angle: what its force sensor did not give, a fit goes without. Other
    kinds need their time. Further columns are welcome.
    """
    present = set(names)
    required = [TIME, "angle_rad"] if kind in RIG_KINDS else [TIME]
    if kind == "car_run":
        required = [column.name for column in sensor_columns()]
        if any("_truth_" in name for name in present):
            required += [column.name for column in [*body_truth_columns(), *contact_truth_columns()]]
            required += [column.name for column in tail_truth_columns()] if has_tail else []
    return [name for name in required if name not in present]
