"""What the tail does in runs of the default car and of that on the field, where the thesis states
something about it.
"""

from itertools import pairwise

import numpy as np

from aerodima.workbench.control.swing_law import SwingState
from tests.built.registry import run
from tests.built.turns import TAILED, column, field_trial, signals_of, throttle_speed, trial


@run
def states_of_the_law():
    """In the order in which a turn goes through them."""
    states = column(trial("swing", TAILED), "controller_state")
    order = [int(states[0]), *(int(b) for a, b in pairwise(states) if a != b)]
    return ", ".join(SwingState(state).name.lower() for state in order if state != SwingState.OFF)


@run
def feed_forward_torque():
    return float(np.max(np.abs(column(trial("swing", TAILED), "tail_roll_command_torque_n_m"))))


def first_of(state):
    return int(np.flatnonzero(column(trial("swing", TAILED), "controller_state") == state)[0])


@run
def tail_angle_before_the_turn():
    """Left turn; positive is to the right, so the inside is at -90 degrees, rad."""
    one = trial("swing", TAILED)
    return float(
        column(one, "tail_roll_angle_rad")[one.run_log.time < signals_of(one).window[0]][-1]
    )


@run
def tail_angle_at_the_end():
    return float(column(trial("swing", TAILED), "tail_roll_angle_rad")[-1])


@run
def yaw_rate_at_the_trigger():
    """What the IMU reported when the swing began, rad/s."""
    return float(column(trial("swing", TAILED), "imu_gyro_z_rad_per_s")[first_of(SwingState.SWING)])


@run
def travel_of_the_swing():
    """Roll travel (rad) from the trigger until position control takes over."""
    angle = column(trial("swing", TAILED), "tail_roll_angle_rad")
    return float(angle[first_of(SwingState.SETTLE)] - angle[first_of(SwingState.SWING)])


@run
def fastest_tail_speed():
    return float(np.max(column(trial("swing", TAILED), "tail_roll_rate_rad_per_s")))


@run
def largest_tail_torque():
    return float(np.max(np.abs(column(trial("swing", TAILED), "tail_roll_torque_n_m"))))


@run
def tail_touches_the_ground():
    return "tail" in trial("swing", TAILED).summary.metrics.outcome.touched


@run
def air_turns_the_car_out_of_the_turn():
    """Yaw impulse (N m s, into the turn) of the air on the tail while it swings, about the car's
    centre of mass.
    """
    one = trial("swing", TAILED)
    com, force, moment = (
        np.array([column(one, f"{stem}_{axis}_truth_{unit}") for axis in "xyz"])
        for stem, unit in (("com", "m"), ("tail_force", "n"), ("tail_force_moment", "n_m"))
    )
    about_com = moment[2] - (com[0] * force[1] - com[1] * force[0])
    swing = column(one, "controller_state") == SwingState.SWING
    return float(np.trapezoid(about_com[swing], one.run_log.time[swing]))


# The held tail at 55 % throttle


def held_at_55_percent():
    return field_trial("held", throttle_speed(0.55))


@run
def outcome_held_at_55_percent():
    return held_at_55_percent().summary.metrics.outcome.result


@run
def yaw_rate_held_at_55_percent():
    """Largest yaw rate into the turn that the IMU reports, rad/s: above 1 the tail would have
    swung.
    """
    return held_at_55_percent().summary.peak_gyro
