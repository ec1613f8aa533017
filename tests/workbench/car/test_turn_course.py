"""Motions in closed form: straight lines, circles, a spin, a lean. The turn is from 2 to 2.64 s."""

import math

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from aerodima.workbench.car.turn_course import turn_course
from aerodima.workbench.car.verdict import velocity_over_ground
from tests.workbench.made_up_runs import COM_X, STEP, made_up_run, times

V = 3.0
"""Below the centre of mass, m/s."""


def moving(course, heading, yaw_rate, roll=0.0, side=1.0):
    """Of a run in which the point below the centre of mass moves along `course`.

    The body points along `heading` and leans by `roll`. The columns are those of the chassis' own
    origin, in its frame: the rear axle, on the ground.
    """
    t = times()
    course, heading, yaw_rate, roll = (
        side * np.broadcast_to(value, t.shape) for value in (course, heading, yaw_rate, roll)
    )
    roll_rate = np.gradient(roll, t)
    slip = course - heading
    ahead = V * np.cos(slip)
    left = V * np.sin(slip)
    v_WC_B = np.column_stack((ahead, np.cos(roll) * left, -np.sin(roll) * left))
    w_WB_B = np.column_stack((roll_rate, np.sin(roll) * yaw_rate, np.cos(roll) * yaw_rate))
    v_WBo_B = v_WC_B - np.cross(w_WB_B, [COM_X, 0.0, 0.0])
    columns = {
        "yaw_truth_rad": np.remainder(heading + math.pi, 2 * math.pi) - math.pi,
        "roll_truth_rad": roll,
    }
    for index, axis in enumerate("xyz"):
        columns |= {
            f"velocity_{axis}_truth_m_per_s": v_WBo_B[:, index],
            f"gyro_{axis}_truth_rad_per_s": w_WB_B[:, index],
        }
    columns["tilt_truth_rad"] = np.abs(roll)
    return turn_course(made_up_run(columns, "left" if side > 0 else "right"))


def arc(rate, until=2.64):
    """Angle and rate of an even turn from 2 s to some time."""
    t = times()
    return rate * np.clip(t - 2.0, 0.0, until - 2.0), rate * ((t >= 2.0) & (t <= until + 1e-9))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("away", [0.0, 3.0])
def test_a_circle_turns_course_and_body_alike(side, away):
    """On whatever heading it begins, also across the branch of the angle; the origin behind slides
    outwards.
    """
    angle, rate = arc(2.0)
    found = moving(away + angle, away + angle, rate, side=side)
    assert found.course_change_rad == pytest.approx(1.28)
    assert found.exit_heading_change_rad == pytest.approx(1.28)
    assert found.exit_sideslip_rad == pytest.approx(0.0, abs=1e-9)
    assert found.exit_speed_m_per_s == pytest.approx(V)
    assert found.exit_time_s == pytest.approx(0.64 + STEP), "the first sample after the window"


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_spin_turns_the_body_and_not_the_course(side):
    angle, rate = arc(2.0)
    found = moving(0.0, angle, rate, side=side)
    assert found.course_change_rad == pytest.approx(0.0, abs=1e-9)
    assert found.exit_heading_change_rad == pytest.approx(1.28)
    assert found.exit_sideslip_rad == pytest.approx(1.28), "the nose points into the turn"
    assert moving(angle, 0.0, 0.0, side=side).exit_sideslip_rad == pytest.approx(-1.28)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_lean_is_no_course(side):
    """A car that slides by 0.2 rad while it rolls to 0.4 rad about the ground and back: its path is
    straight.

    At the exit it rolls back by 1 rad/s, which moves its centre of mass by 0.2 m/s.
    """
    lean = 0.4 * np.sin(np.pi * np.clip((times() - 2.0) / 1.28, 0.0, 1.0))
    found = moving(0.5, 0.7, 0.0, roll=lean, side=side)
    assert found.course_change_rad == pytest.approx(0.0, abs=1e-4), "numeric roll rate"
    assert found.exit_sideslip_rad == pytest.approx(0.2, abs=1e-4)
    assert found.exit_speed_m_per_s == pytest.approx(V, abs=1e-4)


def test_velocity_over_the_ground_is_that_of_the_point_turned_into_the_heading():
    """Of a point `com_x` ahead of the origin of a body that rolls, pitches and turns."""
    v_WBo_B = np.array([2.0, -0.5, 0.3])
    w_WB_B = np.array([1.5, -2.0, 3.0])
    roll, pitch, com_x = 0.4, -0.3, 0.12
    v_WC_B = v_WBo_B + np.cross(w_WB_B, [com_x, 0.0, 0.0])
    expected = RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix() @ v_WC_B
    found = velocity_over_ground(v_WBo_B, w_WB_B, np.array(roll), np.array(pitch), com_x)
    assert found == pytest.approx(expected[:2])


def test_the_turn_ends_when_it_yaws_less_than_a_tenth():
    """From 2 s on at 1 rad/s, from 2.64 s on slower by 2 rad/s2: below 0.1 rad/s after 0.45 s."""
    rate = np.where(times() < 2.64, 1.0, np.maximum(1.0 - 2.0 * (times() - 2.64), 0.0)) * (
        times() >= 2.0
    )
    angle = np.concatenate(([0.0], np.cumsum(0.5 * STEP * (rate[1:] + rate[:-1]))))
    found = moving(angle, angle, rate)
    assert found.exit_time_s == pytest.approx(0.64 + 0.45, abs=1.5 * STEP)
    assert found.course_change_rad == pytest.approx(0.64 + 0.5 * (1.0 + 0.1) * 0.45, abs=0.003)


def test_a_car_that_goes_on_yawing_has_no_exit():
    angle, rate = arc(0.5, until=9.0)
    found = moving(angle, angle, rate)
    exits = {found.exit_time_s, found.course_change_rad, found.exit_speed_m_per_s}
    assert exits == {None}


def test_the_course_is_that_of_the_path_in_a_simulated_run(tailless):
    """From the places of the rear axle and the attitude, differentiated."""
    found = turn_course(tailless)
    pitch, yaw = (tailless.signal(f"{name}_truth_rad") for name in ("pitch", "yaw"))
    ahead = tailless.number("car", "com_x") * np.array(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch)]
    )
    places = ahead + [tailless.signal(f"position_{axis}_truth_m") for axis in "xy"]
    x, y = np.gradient(places, tailless.time, axis=1)
    start, end = np.searchsorted(tailless.time, [0.6 - 1e-6, 0.6 + found.exit_time_s - 1e-6])
    assert found.course_change_rad > 0.05
    assert found.course_change_rad == pytest.approx(
        np.arctan2(y, x)[end] - np.arctan2(y, x)[start], abs=2e-3
    )
    assert found.exit_speed_m_per_s == pytest.approx(np.hypot(x, y)[end], abs=2e-3)
