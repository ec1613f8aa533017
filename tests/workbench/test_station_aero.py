"""The car's tail in moving air: wind and speed load the sail, a free sail is a vane, added mass is
inertia.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.math import RigidTransform

from aerodima.workbench.car.ground_truth import BODY_TRUTH, TAIL_TRUTH
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.scenario.scenario import scenario_from_dict
from aerodima.workbench.scenario.signal_table import TAIL_STATE
from tests.refusals import assert_refused
from tests.workbench.stands import CarStand

RHO, CN, AREA, ROOT, LENGTH = 1.225, 2.0, 0.12, 0.3, 0.6
LARGE = {"length": ROOT + LENGTH, "mass": 0.15, "sail_mass_fraction": 0.6, "hub_mass": 0.05} | {
    "sail_length": LENGTH,
    "sail_width": AREA / LENGTH,
    "sail_bearing_damping": 5e-4,
}
"""A sail that the air moves: 0.6 m x 0.2 m, from 0.3 m to 0.9 m of the tail."""
STIFF = [0.0, 0.0, 100.0, 5.0, 0.0]
SPACE = RigidTransform(np.array([0.0, 0.0, 50.0]))
"""Far above the ground, where without gravity nothing but the air acts on the car."""


def stand(tail=None, wind=None, gravity=9.81, **inputs):
    held = {"tail_pitch_command": STIFF, "tail_roll_command": STIFF} | inputs
    car = CarStand(
        scenario_from_dict(
            {
                "tail": {"mode": "held", "sail": "locked"} | LARGE | (tail or {}),
                "wind": wind or {},
                "car": {"tyre_slip_angle": 0.0, "suspension_motion_ratio": 0.684},
                "environment": {"gravity": gravity},
                "friction": {"coulomb": 0.0, "viscous": 0.0},
            }
        ),
        **held,
    )
    if car.tail is not None:
        car.turn("tail_roll", 0.0)
    return car


def floating(velocity, **options):
    """A car without gravity that moves at one velocity (m/s, W), tail upright."""
    car = stand(gravity=0.0, **options)
    car.place(SPACE, velocity)
    return car


def force(car):
    return car.output("tail_truth")[TAIL_TRUTH.index("tail_force_x_truth_n") :][:3]


def sail_angle(car):
    """rad, in [-pi, pi]."""
    return math.remainder(car.angle("tail_sail_turn"), 2 * math.pi)


def swing_load(speed, wind, rate):
    """F_y of the upright tail: each section meets its own swing speed across and the rest along the
    chord.
    """
    s = ROOT + LENGTH * (np.arange(5) + 0.5) / 5
    across = rate * s
    along = speed - wind
    return 0.5 * RHO * CN * AREA / 5 * np.sum(np.hypot(across, along) * across)


@pytest.mark.parametrize("rate", [8.0, -8.0])
def test_head_wind_loads_the_swing_and_tail_wind_relieves_it(rate):
    loads = []
    for wind in (-3.0, 0.0, 3.0):
        car = floating((4.0, 0.0, 0.0), wind={"mean_x": wind})
        car.spin("tail_roll", rate)
        load = force(car)
        # Positive roll takes the tip to the right (-y), so the air pushes to the left.
        assert_allclose(load, [0.0, swing_load(4.0, wind, rate), 0.0], rtol=1e-9, atol=1e-9)
        loads.append(abs(load[1]))
    assert loads[0] > loads[1] > loads[2]


@pytest.mark.parametrize("wind", [3.0, -3.0])
def test_cross_wind_pushes_the_upright_sail_downwind_at_its_middle(wind):
    car = stand(wind={"mean_y": wind})
    place = np.array([3.0, -2.0, 50.0])
    car.place(RigidTransform(place))
    assert_array_equal(car.output("wind_truth"), [0.0, wind, 0.0])
    push = [0.0, 0.5 * RHO * CN * AREA * wind * abs(wind), 0.0]
    assert_allclose(force(car), push, atol=1e-9)
    tail = car.scenario.tail
    middle = place + np.array([tail.mount_x, 0.0, tail.mount_height + ROOT + LENGTH / 2])
    start = TAIL_TRUTH.index("tail_force_moment_x_truth_n_m")
    about_origin = car.output("tail_truth")[start:][:3]
    assert_allclose(about_origin, np.cross(middle, push), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(("wind", "coefficient"), [(-3.0, 2.3), (3.0, 1.2)])
def test_half_cylinder_is_hollow_towards_the_left_as_it_is_drawn(wind, coefficient):
    # models/tail/half_cylinder.obj opens to +y: wind towards -y blows into it (2.3), wind towards
    # +y onto its back.
    car = stand({"coefficients": "half_cylinder"}, wind={"mean_y": wind})
    assert_allclose(
        force(car), [0.0, 0.5 * RHO * coefficient * AREA * wind * abs(wind), 0.0], atol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wind", "offset", "end"),
    [(-6.0, 0.25, -1), (-6.0, -0.9, 1), (6.0, 0.25, 1)],
    ids=["head wind", "bearing too far back: away", "tail wind"],
)
@pytest.mark.parametrize("start", [1.2, -1.2])
def test_free_sail_settles_broadside_with_its_board_downwind(wind, offset, end, start):
    tail = {"sail": "free", "sail_shell_offset": offset, "sail_bearing_damping": 0.002}
    car = stand(tail, wind={"mean_x": wind})
    car.turn("tail_sail_turn", end * math.pi / 2 + start)
    car.advance(2.0)
    assert sail_angle(car) == pytest.approx(end * math.pi / 2, abs=0.1)


def test_free_sail_of_a_standing_car_turns_to_the_wind_with_full_drag_and_its_encoder_sees_it():
    # Wind from the right (towards +y): the hollow, to the left at angle 0, turns half a turn round.
    car = stand({"sail": "free", "sail_bearing_damping": 0.005}, wind={"mean_y": 4.0})
    car.turn("tail_sail_turn", 1.0)
    car.advance(2.0)
    assert abs(sail_angle(car)) == pytest.approx(math.pi, abs=0.1)
    state = TAIL_STATE.read(car.output("tail_state"))
    assert math.remainder(state.sail_angle - sail_angle(car), 2 * math.pi) == pytest.approx(
        0.0, abs=0.02
    )
    assert force(car)[1] == pytest.approx(0.5 * RHO * CN * AREA * 16.0, rel=0.02)


def test_added_mass_has_no_weight_and_is_no_part_of_the_vehicle():
    heavy = stand({"added_mass": 0.1})
    plain = stand()
    start = BODY_TRUTH.index("com_x_truth_m")
    assert_allclose(
        heavy.output("body_truth")[start:][:3], plain.output("body_truth")[start:][:3], atol=1e-12
    )
    for car in (heavy, plain):
        car.advance(1.0)
    loads = [sum(car.wheel_loads().values()) for car in (heavy, plain)]
    assert loads[0] == pytest.approx(
        plain.plant.CalcTotalMass(plain.plant_context) * 9.81, rel=2e-3
    )
    assert loads[0] == pytest.approx(loads[1], rel=2e-3)  # still settling by less than that


def test_a_gust_accelerates_added_mass_with_the_air():
    # With C_N = 0 the air reaches the tail only through the added mass, as M A_air.
    gust = {"gust_amplitude": 2.0, "gust_period": 0.5, "gust_direction": math.pi / 2}
    speeds = []
    for mass in (0.0, 0.1):
        car = floating(
            (0.0, 0.0, 0.0), tail={"added_mass": mass, "normal_force_coefficient": 0.0}, wind=gust
        )
        car.advance(0.02)
        speeds.append(car.com_velocity()[1])
    impulse = 5 * 0.1 * 2.0 * math.sin(2 * math.pi * 0.02 / 0.5)
    assert speeds[0] == pytest.approx(0.0, abs=1e-9)
    # The air in turn has to move the added mass of the vehicle's tail, 0.5 kg of 8.2 kg: within 10
    # %.
    assert speeds[1] == pytest.approx(impulse / car.plant.CalcTotalMass(car.plant_context), rel=0.1)


@pytest.mark.parametrize(
    ("mass", "named"), [(-0.2, ("-0.2", "'tail_rod'", "-0.0")), (-0.0412, ("-0.0412", "-0.040"))]
)
def test_too_negative_added_mass_is_refused_by_name_with_the_limit(mass, named):
    """At -0.0412 kg M + M_added is positive definite, but Drake's solver does not get through a
    swing with it.
    """
    assert_refused(lambda: stand({"added_mass": mass}), ModelError, "tail.added_mass", *named)
