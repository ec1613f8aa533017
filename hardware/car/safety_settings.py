"""Limits at which computer and firmware stop the car; the parameter files have their reasons."""

from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario_file import load_section


class DriveSafety(QuantityModel):
    """Limits of `models/parameters/hardware/drive_safety.yaml`."""

    operator_silence: float = quantity(
        "s", "age of the operator's command at which the car stops", "(0, 1]"
    )
    tail_hold: float = quantity(
        "s", "least time from throttle 0 to the exit of the motors", "[0, 5]"
    )
    max_tail_hold: float = quantity(
        "s", "longest time from throttle 0 to the exit of the motors of a car that moves", "[0, 5]"
    )
    rest_speed: float = quantity("m/s", "measured speed below which the car is at rest", "(0, 5]")
    after_exit: float = quantity(
        "s", "time from the exit of the motors to the end of the loop", "[0, 5]"
    )
    imu_silence: float = quantity(
        "s", "age of a sample at which the IMU counts as silent", "(0, 1]"
    )
    gps_silence: float = quantity(
        "s", "age of a sample at which the GPS counts as silent", "(0, 10]"
    )
    attitude_limit: float = quantity(
        "rad", "largest roll and pitch, and largest lean by the accelerometer", "(0, 3.2]"
    )
    attitude_time: float = quantity(
        "s", "time beyond the attitude limit, after which the car stops", "[0, 1]"
    )
    full_steering: float = quantity(
        "rad", "steering at which a car that drives must turn", "(0, 1.2]"
    )
    driving_throttle: float = quantity(
        "1", "throttle at which the car moves, whatever its load", "(0, 1]"
    )
    least_yaw_rate: float = quantity(
        "rad/s",
        "least yaw rate of a car that turns at full steering and driving throttle",
        "(0, 10]",
    )
    straight_time: float = quantity(
        "s",
        "time below least_yaw_rate, at full steering and driving throttle, before the car stops",
        "[0, 5]",
    )
    throttle_limit: float = quantity("1", "largest throttle, forwards and backwards", "(0, 1]")
    throttle_start: float = quantity("1", "throttle that comes on at once", "[0, 1]")
    throttle_rate: float = quantity(
        "1/s", "rate at which the rest of the throttle comes on; it goes back at once", "(0, 100]"
    )
    speed_limit: float = quantity("m/s", "measured speed at which the car stops", "(0, 30]")
    speed_time: float = quantity(
        "s",
        "time above speed_limit after which the car stops, or below rest_speed until it is at rest",
        "[0, 2]",
    )
    still_time: float = quantity(
        "s", "time for which the car is observed before it is armed", "(0, 10]"
    )
    still_rate: float = quantity(
        "rad/s", "largest turning rate of a car that stands still", "(0, 10]"
    )
    still_acceleration: float = quantity(
        "m/s2", "largest mean acceleration of a car that stands still, gravity removed", "(0, 20]"
    )
    upright: float = quantity(
        "rad", "largest roll and pitch of a car that may be armed", "(0, 1.6]"
    )
    gyro_calibration: int = quantity(
        "1", "least calibration level of the IMU's gyro, 0 to 3", "[0, 3]"
    )
    overrun: float = quantity("s", "lateness of a cycle that counts as an overrun", "(0, 1]")
    most_overruns: int = quantity("1", "overruns in a row at which the car stops", "[1, 1000]")
    slow_tick: float = quantity(
        "s", "computing time of a controller beyond which a tick counts as slow", "(0, 1]"
    )
    most_slow_ticks: int = quantity(
        "1", "slow ticks within a second at which the car stops", "[1, 1000]"
    )
    longest_tick: float = quantity(
        "s", "computing time after which a controller is interrupted", "(0, 1]"
    )
    arm_timeout: float = quantity("s", "time in which the motors must take commands", "(0, 60]")
    answer_timeout: float = quantity(
        "s", "time in which every device must have answered", "(0, 60]"
    )
    heartbeat_answer: float = quantity(
        "s",
        "time without the Teensy's answer to a heartbeat, after which the car stops",
        "(0, 0.25]",
    )
    longest_watchdog_test: float = quantity(
        "s", "longest time from the cut to the exit frames in a watchdog test", "(0, 1]"
    )
    zero_tolerance: float = quantity(
        "rad", "largest difference between the mark of a held tail and its measured angle", "(0, 1]"
    )
    least_disk: float = quantity("MB", "least free space where the log is written", "[0, 1e6]")
    least_voltage: float = quantity("V", "lowest voltage of the tail motors' pack", "[0, 100]")
    most_voltage: float = quantity("V", "highest voltage of the tail motors' pack", "[0, 100]")
    fuse: float = quantity("A", "rating of the fuse of the tail motors' pack", "(0, 1000]")


def load_drive_safety() -> DriveSafety:
    """Loads the limits; a `ScenarioError` names what is wrong in the file."""
    return load_section(model_path("parameters/hardware/drive_safety.yaml"), DriveSafety)


class TeensyTiming(QuantityModel):
    """Timing of the Teensy's watchdog and of what it sends once it has acted."""

    watchdog_timeout: float = quantity(
        "s",
        "time without a valid text frame or heartbeat, after which the Teensy acts",
        "[0.1, 0.25]",
    )
    exit_burst: int = quantity("1", "exit frames per motor at once", "[1, 10]")
    exit_cycles: int = quantity("1", "exit frames per motor after those sent at once", "[1, 1000]")
    exit_cycle: float = quantity(
        "s", "interval of the exit frames after those sent at once", "(0, 0.1]"
    )
    reminder: float = quantity("s", "interval of all later exit frames", "(0, 1]")
    attitude_time: float = quantity(
        "s", "time beyond the attitude limit, after which the Teensy acts", "[0, 1]"
    )
    straight_time: float = quantity(
        "s", "time without a turn at full steering, after which the Teensy acts", "[0, 5]"
    )
    attitude_age: float = quantity(
        "s", "largest age of an attitude with which the car drives", "(0, 1]"
    )
    reply_wait: float = quantity(
        "s", "longest time for which a reply text frame waits for the motors", "(0, 0.01]"
    )


def load_teensy_timing() -> TeensyTiming:
    """Loads the values of `models/parameters/hardware/teensy_firmware.yaml`; a `ScenarioError`
    names what is wrong in it.
    """
    return load_section(model_path("parameters/hardware/teensy_firmware.yaml"), TeensyTiming)
