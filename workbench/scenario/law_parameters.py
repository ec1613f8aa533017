"""The tail laws of a scenario."""

from typing import Literal

from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.quantity import QuantityModel, quantity


class ControllerParameters(QuantityModel):
    """Tail controller of thesis Table 6.4, read with ERRATA E28 (design section 8); the same
    numbers for both sides.
    """

    rate: float = quantity("Hz", "controller rate", "(0, 10000]")
    hold_angle: float = quantity(
        "rad", "tail roll at rest, towards the inside of the turn", "(0, 3.1416]"
    )
    hold_kp: float = quantity("N m/rad", "position gain of the hold", "[0, 500]")
    hold_kd: float = quantity("N m s/rad", "velocity gain of the hold", "[0, 5]")
    swing_speed: float = quantity("rad/s", "commanded roll rate of the swing", "(0, 50]")
    swing_kp: float = quantity("N m/rad", "position gain of the swing", "[0, 500]")
    swing_kd: float = quantity("N m s/rad", "velocity gain of the swing", "[0, 5]")
    settle_kp: float = quantity("N m/rad", "position gain at the end of the swing", "[0, 500]")
    settle_kd: float = quantity("N m s/rad", "velocity gain at the end of the swing", "[0, 5]")
    trigger: Literal["yaw_rate", "lateral_acceleration", "steering"] = quantity(
        "1", "signal that starts the swing"
    )
    trigger_yaw_rate: float = quantity(
        "rad/s", "yaw rate into the planned turn that starts the swing", "(0, 100]"
    )
    trigger_lateral_acceleration: float = quantity(
        "m/s2", "lateral acceleration of the IMU into the turn that starts the swing", "(0, 100]"
    )
    trigger_steering_angle: float = quantity(
        "rad", "steering command into the turn that starts the swing", "(0, 1.2]"
    )
    delay: float = quantity("s", "wait between trigger and swing", "[0, 10]")
    travel: float = quantity(
        "rad", "roll travel after which position control takes over", "(0, 6.3]"
    )
    recock_speed: float = quantity(
        "rad/s", "roll rate of the slow return before the next turn", "(0, 50]"
    )
    pitch_angle: float = quantity(
        "rad", "tail pitch that is held all the time", "[-3.1416, 3.1416]"
    )
    swing_file: str = quantity(
        "1", "swing that is played: none (the law above), a name in models/swings, or a path"
    )
    law: Literal["swing", "feedback"] = quantity(
        "1", "law of the tail: the thesis' law or swing_file, or that of section feedback"
    )

    @property
    def hold_gains(self) -> Pair:
        """Gains kp (N m/rad) and kd (N m s/rad) of the hold."""
        return self.hold_kp, self.hold_kd


class RolloverControlParameters(QuantityModel):
    """Limit of the steering by speed and roll of the car (`control.rollover_control`)."""

    gain: float = quantity(
        "1/rad", "share of the steering that is lost per roll beyond start; 0 is off", "[0, 1000]"
    )
    start: float = quantity("rad", "roll from which steering is lost", "[0, 1.5708]")
    lead: float = quantity("s", "time by which the roll rate extrapolates the roll", "[0, 5]")
    acceleration: float = quantity(
        "m/s2", "lateral acceleration of the kinematic car at which the wheels stop", "(0, 1000]"
    )
    zero_time: float = quantity(
        "s", "time constant with which the zero of the roll follows the roll", "(0, 100]"
    )


class FeedbackParameters(QuantityModel):
    """Tail law that follows the state of the car (`control.feedback_law`, design section 8)."""

    lean_gain: float = quantity("rad", "roll of the tail at the limit of the floor", "[-10, 10]")
    roll_gain: float = quantity("1", "roll of the tail per roll of the car", "[-100, 100]")
    roll_rate_gain: float = quantity("s", "roll of the tail per roll rate of the car", "[-10, 10]")
    yaw_rate_gain: float = quantity(
        "s", "roll of the tail per yaw rate beyond that of the steering", "[-10, 10]"
    )
    grip: float = quantity("m/s2", "lateral acceleration at which the demand saturates", "(0, 200]")
    kick_roll: float = quantity(
        "rad", "roll of the tail to the inside as the steering starts", "[-3.1416, 3.1416]"
    )
    kick_time: float = quantity("s", "time for which the tail goes to kick_roll", "[0, 5]")
    counter_roll: float = quantity(
        "rad",
        "roll of the tail to the outside after kick_time; below 0 to the inside",
        "[-3.1416, 3.1416]",
    )
    counter_time: float = quantity("s", "time for which the tail goes to counter_roll", "[0, 5]")
    min_demand: float = quantity("1", "demand of the steering that releases a swing", "(0, 1)")
    zero_time: float = quantity(
        "s", "time constant with which the zero of the roll follows the roll", "(0, 100]"
    )
    most_roll: float = quantity("rad", "largest roll of the tail to either side", "(0, 3.1416]")
    out_speed: float = quantity(
        "rad/s", "roll rate of the reference towards a larger lean", "(0, 50]"
    )
    return_speed: float = quantity(
        "rad/s", "roll rate of the reference towards a lean that is no larger", "(0, 50]"
    )
    kp: float = quantity("N m/rad", "position gain of the roll motor", "[0, 500]")
    kd: float = quantity("N m s/rad", "velocity gain of the roll motor", "[0, 5]")
    pitch_angle: float = quantity("rad", "pitch at which the tail is held", "[-1.5708, 1.5708]")
