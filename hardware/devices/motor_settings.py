"""Settings of a tail motor: what it can do, where it may go, when it is switched off."""

from dataclasses import dataclass

from aerodima.hardware.protocol.ak70 import MAX_ID, FirmwareProfile
from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario_file import load_section
from aerodima.workbench.scenario.tail_parameters import TailMotorParameters


class MotorSafety(QuantityModel):
    """Limits at which the computer switches a motor off, and how gently it is taken over."""

    speed_limit: float = quantity(
        "rad/s", "largest speed, commanded (clipped) and measured (fault)", "(0, 50]"
    )
    rated_torque: float = quantity("N m", "torque that the winding bears indefinitely", "(0, 50]")
    overload: float = quantity(
        "N2 m2 s", "budget of squared torque less squared rated torque, over time", "(0, 1e5]"
    )
    overload_share: float = quantity(
        "1", "fraction of `overload` at which the motor is disabled", "(0, 1]"
    )
    follow_torque: float = quantity(
        "N m", "least commanded torque with which the reported one is compared", "(0, 25]"
    )
    follow_share: float = quantity(
        "1", "fraction of the commanded torque that must be reported", "(0, 1]"
    )
    follow_time: float = quantity(
        "s", "time below `follow_share`, after which the motor counts as not following", "(0, 1]"
    )
    torque_share: float = quantity(
        "1", "fraction of a command's torque, down or up, that belongs to it", "(0, 1]"
    )
    torque_margin: float = quantity(
        "N m", "margin beyond `torque_share` of a torque that belongs to a command", "(0, 5]"
    )
    strange_replies: int = quantity(
        "1",
        "replies in a row with a torque that belongs to no command, which switch the motor off",
        "[1, 100]",
    )
    tracking_error: float = quantity(
        "rad", "largest difference between commanded and measured position", "(0, 3.2]"
    )
    tracking_time: float = quantity(
        "s",
        "time beyond `tracking_error`, not approaching, after which a motor is not following",
        "(0, 5]",
    )
    temperature_limit: float = quantity("degC", "highest permitted temperature reading", "(0, 150]")
    range_margin: float = quantity(
        "rad", "largest angle beyond its range at which a joint may be measured", "[0, 1]"
    )
    jump_margin: float = quantity(
        "rad", "largest change of a reading beyond what the motor's speed allows", "[0, 1]"
    )
    ramp_speed: float = quantity(
        "rad/s", "speed of the way from the measured position to the first command", "(0, 10]"
    )
    gain_ramp: float = quantity("s", "time in which the gains come on", "(0, 5]")
    missed_replies: int = quantity(
        "1", "cycles in a row without a reply, which switch the motor off", "[1, 100]"
    )
    reply_time: float = quantity(
        "s", "time in which a motor answers; shorter cycles are never missed", "[0, 0.1]"
    )
    enter_replies: int = quantity(
        "1", "replies to the neutral command before the motor is used", "[1, 100]"
    )
    enter_timeout: float = quantity(
        "s",
        "longest wait for the replies to the neutral command, and then for a joint at rest",
        "(0, 5]",
    )
    probe_torque: float = quantity(
        "N m", "largest torque with which the direction is tried", "(0, 5]"
    )
    command_timeout: float = quantity(
        "s", "time without a command, after which the position is held", "(0, 0.15]"
    )
    stall_time: float = quantity("s", "longest gap between two cycles", "(0, 1]")
    exit_burst: int = quantity("1", "exit frames sent at once", "[1, 50]")
    exit_cycles: int = quantity("1", "cycles in which a further exit frame is sent", "[1, 1000]")


def load_motor_safety() -> MotorSafety:
    """Loads the values of `models/parameters/hardware/motor_safety.yaml`; a `ScenarioError` names
    key, value and what is allowed.
    """
    return load_section(model_path("parameters/hardware/motor_safety.yaml"), MotorSafety)


@dataclass(frozen=True)
class MotorSettings:
    """One motor on its joint. Joint angle = direction * (motor angle - zero).

    Attributes:
        name: name of the joint, for messages.
        motor_id: id of the motor on the bus.
        profile: firmware profile, with the ranges of the fields.
        safety: limits at which the motor is switched off, and how gently it is taken over.
        low: lower end of the joint's range, rad.
        high: upper end of the joint's range, rad.
        torque_limit: limit of the total PD torque, N m.
        kp_max: largest position gain, N m/rad.
        kd_max: largest velocity gain, N m s/rad.
        jump_speed: fastest change of position that is believed, rad/s.
        hold_kp: position gain with which a position is held, N m/rad.
        hold_kd: velocity gain with which a position is held, N m s/rad.
        direction: sign of the motor's angle relative to the joint's, +1 or -1.
        zero: motor angle at joint angle 0, rad.

    Raises:
        HardwareError: a range that the profile cannot express.
    """

    name: str
    motor_id: int
    profile: FirmwareProfile
    safety: MotorSafety
    low: float
    high: float
    torque_limit: float
    kp_max: float
    kd_max: float
    jump_speed: float
    hold_kp: float
    hold_kd: float
    direction: int = 1
    zero: float = 0.0

    def __post_init__(self) -> None:
        ends = (self.motor_angle(self.low), self.motor_angle(self.high))
        # Below this a command looks like a reply of the motor, see
        # `aerodima.hardware.protocol.ak70.MAX_ID`.
        lowest = self.profile.position * (2 * (MAX_ID + 1) / 256 - 1)
        if not lowest < min(ends) or not max(ends) < self.profile.position:
            allowed = f"{lowest:.3g} to {self.profile.position:g} rad"
            raise HardwareError(
                f"{self.name}: motor angles {min(ends):.3g} to {max(ends):.3g} rad; firmware "
                f"profile {self.profile.name} allows {allowed}: set the zero nearer"
            )

    def motor_angle(self, joint: float) -> float:
        """Returns the motor angle (rad) at a joint angle (rad)."""
        return self.zero + self.direction * joint

    def joint_angle(self, motor: float) -> float:
        """Returns the joint angle (rad) at a motor angle (rad)."""
        return self.direction * (motor - self.zero)


def motor_settings(
    name: str,
    motor_id: int,
    profile: FirmwareProfile,
    parameters: TailMotorParameters,
    joint_range: Pair,
    hold_gains: Pair,
    direction: int = 1,
    zero: float = 0.0,
) -> MotorSettings:
    """Makes settings whose physical limits are the scenario's, never wider than the profile can
    express.

    Args:
        parameters: parameters of the motor, `scenario.tail_motor`.
        joint_range: lower and upper end of the joint's range, rad (`scenario.tail.roll_limit` to
            either side, ...).
        hold_gains: kp and kd of holding (`scenario.controller.hold_gains`).
    """
    kp_max = min(parameters.kp_max, profile.kp)
    kd_max = min(parameters.kd_max, profile.kd)
    return MotorSettings(
        name=name,
        motor_id=motor_id,
        profile=profile,
        safety=load_motor_safety(),
        low=joint_range[0],
        high=joint_range[1],
        torque_limit=min(parameters.torque_limit, profile.torque),
        kp_max=kp_max,
        kd_max=kd_max,
        jump_speed=min(parameters.speed_range, profile.speed),
        hold_kp=min(hold_gains[0], kp_max),
        hold_kd=min(hold_gains[1], kd_max),
        direction=direction,
        zero=zero,
    )
