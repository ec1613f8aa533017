"""The turn of a body by its tail: against closed forms, by sign, and with air."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydrake.multibody.tree import SpatialInertia
from scipy.integrate import trapezoid

from aerodima.optimisation.studies.other_tail_systems import PITCH, ROLL, gecko, values_of
from aerodima.optimisation.studies.tail_steering import steer_by_tail
from aerodima.optimisation.studies.tailed_body import (
    Swing,
    TailAir,
    TailedBody,
    at,
    moment_about,
    planar_turn,
    swing_tail,
)
from aerodima.workbench.aero.sections import SectionLayout

BODY = SpatialInertia.SolidBoxWithMass(2.0, 0.4, 0.2, 0.1)
TAIL_MASS, TAIL_LENGTH = 0.3, 0.5
TAIL = at(SpatialInertia.SolidCylinderWithMass(TAIL_MASS, 0.01, TAIL_LENGTH, [1.0, 0.0, 0.0]), (-TAIL_LENGTH / 2, 0, 0))
FIRST, LAST = math.radians(-60.0), math.radians(150.0)


def system(hinge: float) -> TailedBody:
    return TailedBody(BODY, TAIL, (-hinge, 0.0, 0.0), PITCH)


@pytest.mark.parametrize("hinge", [0.0, 0.2, 0.35], ids=lambda h: f"hinge {h:g} m behind the centre")
def test_the_turn_is_that_of_zero_angular_momentum(hinge: float) -> None:
    motion = swing_tail(system(hinge), Swing(FIRST, LAST, 0.4), accuracy=1e-8)
    moments = moment_about(BODY, PITCH), moment_about(TAIL, PITCH, central=True)
    swept = (float(motion.tail[0]), float(motion.tail[-1]))
    expected = planar_turn(*moments, (2.0, TAIL_MASS), (hinge, TAIL_LENGTH / 2.0), swept)
    # Ten times the integrator's accuracy.
    assert motion.turn[-1] == pytest.approx(expected, rel=1e-7)


def test_with_the_hinge_at_the_centre_the_ratio_is_that_of_the_inertias() -> None:
    moments = moment_about(BODY, PITCH), moment_about(TAIL, PITCH, central=True)
    reduced = 2.0 * TAIL_MASS / (2.0 + TAIL_MASS)
    tail = moments[1] + reduced * (TAIL_LENGTH / 2.0) ** 2
    turned = planar_turn(*moments, (2.0, TAIL_MASS), (0.0, TAIL_LENGTH / 2.0), (0.0, 1.0))
    assert turned == pytest.approx(-tail / (moments[0] + tail), rel=1e-12)


def test_the_turn_depends_on_the_way_of_the_tail_and_not_on_the_time() -> None:
    fast, slow = (swing_tail(system(0.2), Swing(0.0, 1.0, time)).turn[-1] for time in (0.05, 2.0))
    assert fast == pytest.approx(slow, rel=1e-4)


def test_the_body_turns_against_the_tail_and_comes_back_with_it() -> None:
    there = swing_tail(system(0.2), Swing(0.0, 1.5, 0.3))
    back = swing_tail(system(0.2), Swing(1.5, 0.0, 0.3))
    assert there.turn[-1] < -0.05
    assert back.turn[-1] == pytest.approx(-there.turn[-1], rel=1e-4)
    mirrored = swing_tail(system(0.2), Swing(0.0, -1.5, 0.3))
    assert mirrored.turn[-1] == pytest.approx(-there.turn[-1], rel=1e-4)


def test_a_heavier_tail_turns_the_body_further() -> None:
    heavy = at(SpatialInertia.SolidCylinderWithMass(0.6, 0.01, TAIL_LENGTH, [1, 0, 0]), (-TAIL_LENGTH / 2, 0, 0))
    light, more = (
        swing_tail(TailedBody(BODY, tail, (-0.2, 0, 0), PITCH), Swing(0.0, 1.0, 0.3)).turn_per_tail
        for tail in (TAIL, heavy)
    )
    assert more < light < 0.0


def test_still_air_holds_the_tail_back_and_turns_the_body_further() -> None:
    """The air's moment on the tail is against its swing; it is a moment on body and tail together, which stays."""
    layout = SectionLayout.strip(start=0.0, length=0.5, width=0.3, axis_B=(-1.0, 0, 0), normal_B=(0.0, 0.0, 1.0))
    swing = Swing(0.0, 1.5, 0.15)
    without, with_air = swing_tail(system(0.2), swing), swing_tail(system(0.2), swing, TailAir(layout, 2.0))
    assert without.air_impulse == 0.0
    assert with_air.air_impulse < 0.0
    assert with_air.turn[-1] < without.turn[-1] < 0.0


def test_the_impulse_of_the_air_on_a_held_body_is_that_of_the_strip() -> None:
    """1/8 rho C c L^4 times the integral of the rate squared."""
    length, width = 0.5, 0.1
    layout = SectionLayout.strip(start=0.0, length=length, width=width, number=50, normal_B=(0.0, 1.0, 0.0))
    tail = at(SpatialInertia.SolidBoxWithMass(0.1, width, 1e-3, length), (0.0, 0.0, length / 2))
    plate = TailedBody(BODY, tail, (0.0, 0.0, 0.0), ROLL)
    held = swing_tail(plate, Swing(0.0, 1.2, 0.4), TailAir(layout, 2.0), held=True)
    squared = trapezoid(np.gradient(held.tail, held.time) ** 2, held.time)
    # 50 sections err by 1 / 5000, differences of 480 samples by less.
    assert -held.air_impulse == pytest.approx(1.225 * 2.0 * width * length**4 / 8.0 * squared, rel=5e-4)
    np.testing.assert_array_equal(held.turn, 0.0)


def test_a_roll_out_of_plane_keeps_the_angular_momentum_at_zero() -> None:
    """The gecko's tail turns behind its body: the body rolls and nods, and a full turn does not bring it back."""
    motion = swing_tail(gecko(values_of("gecko")), Swing(0.0, 2.0 * math.pi, 0.11))
    assert math.degrees(motion.turn[-1]) == pytest.approx(-172.7, abs=0.1)
    assert np.abs(motion.rpy[:, 1]).max() > math.radians(3.0)


def test_the_running_robot_turns_by_what_its_tail_was_given() -> None:
    values = values_of("taylroach")
    turn = steer_by_tail(values)
    assert math.degrees(abs(turn.turned)) == pytest.approx(90.0, rel=0.02)  # the tail lags as the swing ends
    heavier = steer_by_tail({**values, "tail_inertia": 2.0})
    assert heavier.radius_in_lengths == pytest.approx(turn.radius_in_lengths, rel=1e-3)
    faster = steer_by_tail({**values, "speed": 6.4})
    assert faster.radius_in_lengths == pytest.approx(2.0 * turn.radius_in_lengths, rel=0.01)
