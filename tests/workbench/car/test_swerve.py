"""Measures of a swerve on motions whose values are known."""

from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench import load_scenario
from aerodima.workbench.car import swerve as measures
from aerodima.workbench.car.swerve import Swerve, car_outline

TIME = np.linspace(-0.1, 2.6, 271)
ACCELERATION = 4.0
SPEED = 6.0
CORNERS = np.array([[0.3, 0.3, -0.1, -0.1], [0.15, -0.15, 0.15, -0.15]])


def slide(turned=0.0):
    """A car that slides to the left at a constant acceleration and never yaws, in a world that is
    turned by an angle.
    """
    side = 0.5 * ACCELERATION * np.maximum(TIME, 0.0) ** 2
    ahead = SPEED * TIME
    rate = ACCELERATION * np.maximum(TIME, 0.0)
    x = np.cos(turned) * ahead - np.sin(turned) * side
    y = np.sin(turned) * ahead + np.cos(turned) * side
    column = np.ones((len(TIME), 1))
    return Swerve(
        time=TIME,
        x=x[:, None],
        y=y[:, None],
        heading=turned * column,
        course=turned + np.arctan2(rate, SPEED)[:, None],
        speed=np.hypot(rate, SPEED)[:, None],
        yaw_rate=0.0 * column,
        roll=0.0 * column,
        steering=0.1 * column * (TIME[:, None] >= 0.0),
        lifts=np.full((len(TIME), 4, 1), -1e-3),
        heights=np.full((len(TIME), 2, 1), 0.1),
        tail=np.zeros((len(TIME), 2, 1)),
        lag=0.0 * column,
        torques=np.zeros((len(TIME), 2, 1)),
        power=0.0 * column,
        flipped=np.array([False]),
        com_x=np.array([0.1]),
        outline=CORNERS[..., None],
    )


@pytest.mark.parametrize("turned", [0.0, 2.5])
def test_displacement_is_from_the_course_at_the_start_whatever_the_world(turned):
    swerve = slide(turned)
    for after in (0.5, 1.0):
        moved = 0.5 * ACCELERATION * after**2
        assert measures.aside(swerve, after) == pytest.approx([moved], abs=1e-6)
        assert measures.centre_aside(swerve, after) == pytest.approx([moved], abs=1e-6)
    change = np.arctan2(ACCELERATION, SPEED)
    assert measures.course_change(swerve) == pytest.approx([change], abs=1e-6)
    assert np.isnan(measures.aside(swerve, 3.0)).all()


def test_a_car_that_turns_about_its_centre_of_mass_has_not_moved_aside():
    """Its centre stays, and its last point goes back to the right."""
    angle = np.maximum(TIME, 0.0)[:, None]
    still = slide()
    along = SPEED * TIME[:, None]
    turning = replace(
        still,
        x=along + 0.1 * (1.0 - np.cos(angle)),
        y=-0.1 * np.sin(angle),
        heading=angle,
        course=0.0 * angle,
    )
    assert measures.centre_aside(turning) == pytest.approx([0.0], abs=1e-9)
    corners = CORNERS - [[0.1], [0.0]]
    left = np.sin(0.5) * corners[0] + np.cos(0.5) * corners[1]
    assert measures.aside(turning) == pytest.approx([left.min() + 0.15], abs=1e-4)
    assert measures.aside(turning)[0] < -0.02


def test_sustained_is_speed_times_rate_of_the_course():
    circle = replace(slide(), course=0.7 * TIME[:, None], speed=np.full((len(TIME), 1), 5.0))
    assert measures.sustained(circle) == pytest.approx([3.5])


def test_energy_is_positive_work_from_the_start_on():
    power = np.where(TIME < 0.0, 50.0, np.where(TIME < 1.0, 2.0, -2.0))
    assert measures.energy(replace(slide(), power=power[:, None])) == pytest.approx([2.0], abs=0.03)


@pytest.mark.parametrize(
    ("changes", "upright", "straight"),
    [
        ({}, True, True),
        ({"lifts": [[0.006], [0.0], [0.006], [0.0]]}, False, True),
        ({"lifts": [[0.006], [0.006], [0.0], [0.0]]}, True, True),
        ({"heights": [[0.0], [0.1]]}, False, True),
        ({"heights": [[0.1], [0.0]]}, False, True),
        ({"course": [0.02]}, True, False),
        ({"heading": 0.03 * TIME[:, None]}, True, False),
        ({"yaw_rate": 0.3 * np.cos(700.0 * TIME[:, None])}, True, True),
        ({"yaw_rate": [0.2]}, True, True),
        ({"flipped": [True]}, False, True),
    ],
)
def test_a_swerve_counts_that_is_straight_at_both_ends_and_upright_in_between(
    changes, upright, straight
):
    swerve = slide()
    for name, values in changes.items():
        whole = np.broadcast_to(values, getattr(swerve, name).shape)
        swerve = replace(swerve, **{name: whole})
    assert measures.is_upright(swerve).tolist() == [upright]
    assert measures.starts_straight(swerve).tolist() == [straight]
    ends_straight = abs(measures.end_yaw_rate(swerve)[0]) <= 0.1
    assert measures.swerve_counts(swerve).tolist() == [upright and straight and ends_straight]


def test_what_happens_before_the_steering_does_not_tip_a_car():
    lifts = np.where(TIME < -0.01, 0.02, -1e-3)[:, None, None] * np.ones((1, 4, 1))
    assert measures.is_upright(replace(slide(), lifts=lifts)).all()


def test_the_outline_reaches_from_the_front_tyres_to_the_board():
    car = load_scenario("swerve").car
    ahead, left = car_outline(car)
    assert ahead.max() == car.wheelbase + car.tyre_radius
    assert ahead.min() == car.board_x
    assert left.max() == -left.min() == 0.5 * (car.track + car.tyre_width)
