"""The tail as a point mass on a massless arm, for which every moment is known in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench.car.tail_impulses import tail_impulses, tail_yaw_impulses
from aerodima.workbench.core.errors import LogError
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import GRAVITY, TAIL_MASS, both_sides, changed, made_up_run, times

LENGTH, HEIGHT = 0.6, 0.24
"""Of the arm and of its axis above the ground, m."""
ACCELERATION = 40.0
"""Of the arm's roll angle while it speeds up, rad/s2."""
START, SPEED_UP = 2.0, 0.2
FORWARD = 3.0
"""Speed of the car, m/s."""


def in_axes(stem, suffix, values):
    return {f"{stem}_{axis}_{suffix}": values[:, number] for number, axis in enumerate("xyz")}


def tail_columns(yaw, ground, com, velocity):
    """Of a car at places `ground` whose tail is a point mass at `com`."""
    momentum = TAIL_MASS * velocity
    return {
        "yaw_truth_rad": yaw,
        **in_axes("position", "truth_m", ground),
        **in_axes("tail_com", "truth_m", com),
        **in_axes("tail_momentum", "truth_n_s", momentum),
        **in_axes("tail_angular_momentum", "truth_n_m_s", np.cross(com, momentum)),
    }


def point_mass_run(roll, roll_rate, yaw=0.0, direction="left"):
    """A car that goes straight at heading `yaw` from (5, -2) m, its tail at these roll angles (0
    up, positive to the right).
    """
    t = times()
    ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    left = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    ground = np.array([5.0, -2.0, 0.01]) + np.outer(FORWARD * t, ahead)
    arm = LENGTH * (np.outer(-np.sin(roll), left) + np.outer(np.cos(roll), up))
    swing = np.outer(-np.cos(roll), left) + np.outer(-np.sin(roll), up)
    velocity = FORWARD * ahead + LENGTH * roll_rate[:, None] * swing
    com = ground + (HEIGHT - 0.01) * up + arm
    columns = tail_columns(np.full(t.size, yaw), ground, com, velocity)
    side = 1.0 if direction == "left" else -1.0
    columns["roll_truth_rad"] = side * 0.1 * np.exp(-(((t - 2.2) / 0.1) ** 2))
    return made_up_run(columns, direction)


def speeding_up(side):
    """Roll angle and rate: at rest on the inside, even acceleration for 0.2 s, then even speed."""
    since = np.clip(times() - START, 0.0, SPEED_UP)
    rate = ACCELERATION * since
    after = np.maximum(times() - START - SPEED_UP, 0.0)
    roll = -math.pi / 2 + 0.5 * ACCELERATION * since**2 + rate[-1] * after
    return side * roll, side * rate


def at_rest(roll):
    return np.full(times().size, roll), np.zeros(times().size)


def at(time):
    return round(time / (times()[1] - times()[0]))


@both_sides
@pytest.mark.parametrize("yaw", [0.0, 2.1])
def test_the_weight_of_a_tail_on_the_inside_helps(direction, side, yaw):
    """m g l about the ground point, in any heading and however far the car is from the origin of
    the world.
    """
    inside = -side * math.pi / 2
    result = tail_impulses(point_mass_run(*at_rest(inside), yaw=yaw, direction=direction))
    expected = TAIL_MASS * GRAVITY * LENGTH
    assert result.weight == pytest.approx(expected * 0.64, rel=1e-9)
    assert result.inertial == pytest.approx(0.0, abs=1e-9)
    assert result.aerodynamic == 0.0
    outside = tail_impulses(point_mass_run(*at_rest(-inside), yaw=yaw, direction=direction))
    assert outside.weight == pytest.approx(-expected * 0.64, rel=1e-9)


@both_sides
@pytest.mark.parametrize("yaw", [0.0, 2.1])
def test_speeding_the_tail_up_outwards_helps(direction, side, yaw):
    """Angular momentum about the ground point along the heading: m (l^2 + h l cos(roll)) times the
    roll rate.

    The swing starts on the inside, so the tail gains momentum that points outwards and the car
    gains as much inwards.
    """
    roll, rate = speeding_up(side)
    result = tail_impulses(point_mass_run(roll, rate, yaw=yaw, direction=direction))
    gained = TAIL_MASS * (LENGTH**2 + HEIGHT * LENGTH * np.cos(roll)) * rate * side
    assert result.inertial == pytest.approx(gained[at(2.64)] - gained[at(2.0)], rel=1e-6)


@both_sides
def test_air_that_holds_the_tail_back_while_it_swings_outwards_helps(direction, side):
    """Upright tail moving outwards: drag points to the inside at height h + l.

    The log has its moment about Wo, 2 m beside the car, about which the lift has one too; about the
    ground point the lift has none.
    """
    run = point_mass_run(*at_rest(0.0), direction=direction)
    force = np.tile([0.0, side * 2.0, 1.0], (times().size, 1))
    moment = np.cross(run.vector("tail_com", "truth_m"), force)
    columns = in_axes("tail_force", "truth_n", force)
    columns |= in_axes("tail_force_moment", "truth_n_m", moment)
    result = tail_impulses(changed(run, **columns))
    assert result.aerodynamic == pytest.approx(2.0 * (HEIGHT + LENGTH) * 0.64, rel=1e-9)


def test_a_jump_of_the_momentum_counts_in_full():
    rate = np.where(times() >= 2.3, 5.0, 0.0)
    roll = np.where(times() >= 2.3, 5.0 * (times() - 2.3), 0.0) - math.pi / 2
    roll = np.minimum(roll, 3.0)
    result = tail_impulses(point_mass_run(roll, rate))
    gained = TAIL_MASS * (LENGTH**2 + HEIGHT * LENGTH * math.cos(roll[at(2.64)])) * 5.0
    assert result.inertial == pytest.approx(gained, rel=1e-6)


def test_inertial_moment_of_any_motion_is_minus_arm_cross_mass_times_acceleration():
    """Car on a curve with a turning heading while the tail swings: -(c - p) x m d2c/dt2 about the
    heading axis.

    The independent side differentiates the path twice; all motions are slow sines, so both differ
    by (w dt)^2 < 1e-3.
    """
    t = times()
    yaw = 0.4 * np.sin(2.0 * t)
    ground = np.column_stack([5.0 + 3.0 * t, -2.0 + 1.5 * np.sin(3.0 * t), np.zeros_like(t)])
    roll = 1.2 * np.sin(4.0 * t)
    arm = LENGTH * np.column_stack(
        [np.sin(roll) * np.sin(yaw), -np.sin(roll) * np.cos(yaw), np.cos(roll)]
    )
    com = ground + np.array([0.0, 0.0, HEIGHT]) + arm
    velocity = np.gradient(com, t, axis=0)
    result = tail_impulses(made_up_run(tail_columns(yaw, ground, com, velocity)))
    acceleration = np.gradient(velocity, t, axis=0)
    heading = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)])
    about_heading = np.sum(-np.cross(com - ground, TAIL_MASS * acceleration) * heading, axis=1)
    scale = float(np.max(np.abs(about_heading)))
    impulse = float(np.sum(-about_heading[at(2.0) : at(2.64)]) * (t[1] - t[0]))
    assert result.inertial == pytest.approx(
        impulse, abs=2e-3 * scale * 0.64 + scale * (t[1] - t[0])
    )


def test_no_tail_no_impulses_and_no_truth_is_an_error():
    assert tail_impulses(made_up_run(tail_mode="none")) is None
    without_mass = replace(made_up_run(), extra={})
    assert_refused(lambda: tail_impulses(made_up_run(truth=False)), LogError, "truth")
    assert_refused(lambda: tail_impulses(without_mass), LogError, "tail_mass_kg")


@both_sides
@pytest.mark.parametrize("yaw", [0.0, 2.1])
def test_a_tail_behind_the_centre_of_mass_that_speeds_up_outwards_turns_the_car_out_of_the_turn(
    direction, side, yaw
):
    """Lever times change of momentum; the window ends while the tail still moves outwards, before
    it is upright.
    """
    lever = 0.15
    run = point_mass_run(*speeding_up(side), yaw=yaw, direction=direction)
    ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    com = run.vector("position", "truth_m") + lever * ahead
    run = changed(run, **in_axes("com", "truth_m", com))
    shorter = {
        **run.scenario,
        "manoeuvre": {**run.scenario["manoeuvre"], "turn_hold": 0.1},
    }  # until 2.24 s
    found = tail_yaw_impulses(replace(run, scenario=shorter))
    roll, rate = speeding_up(1.0)
    outwards = LENGTH * rate[at(2.24)] * math.cos(roll[at(2.24)])
    assert outwards > 1.0
    assert found.inertial == pytest.approx(-lever * TAIL_MASS * outwards, rel=1e-3)
    assert (found.weight, found.aerodynamic) == (0.0, 0.0)
