"""The car as a plant: mass, fall, rest, contact, differential."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_model import car_sdf, wheel_rates
from aerodima.workbench.car.car_plant import parse_model
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import WHEELS
from tests.certain_cars import HEAVY_TAIL, HIGH_CAR
from tests.refusals import assert_refused
from tests.workbench.stands import CarStand, edited

G = 9.81
LEFT = [wheel for wheel in WHEELS if wheel.endswith("left")]
RIGHT = [wheel for wheel in WHEELS if wheel.endswith("right")]


def stand(tail="none", direction="left", **sections):
    """A car on rigid tyres whose tail, which no motor holds, rests on a stop."""
    overrides = {
        "car": {"tyre_slip_angle": 0.0},
        "tail": {"mode": tail, "roll_stop": math.pi / 2, **HEAVY_TAIL},
        "manoeuvre": {"direction": direction},
    }
    for section, values in sections.items():
        overrides[section] = overrides.get(section, {}) | values
    return CarStand(scenario_from_dict(overrides))


@pytest.mark.parametrize("car", [{}, {"mass": 7.5, "com_height": 0.2, "com_x": 0.15}])
def test_car_has_the_mass_and_centre_of_mass_of_the_scenario(car):
    at_rest = stand(car=car)
    expected = at_rest.scenario.car
    assert at_rest.plant.CalcTotalMass(at_rest.plant_context) == pytest.approx(
        expected.mass, rel=1e-8
    )
    # The SDF carries nine digits.
    assert_allclose(at_rest.com(), [expected.com_x, 0.0, expected.com_height], atol=1e-8)


def test_sprung_body_has_the_radii_of_gyration_of_the_scenario_about_its_own_axes():
    radii = {"gyration_roll": 0.09, "gyration_pitch": 0.13, "gyration_yaw": 0.15}
    car = stand(car=radii)
    inertia = car.chassis.CalcSpatialInertiaInBodyFrame(car.plant_context)
    about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
    assert_allclose(
        about_com.get_moments() / inertia.get_mass(), np.square(list(radii.values())), rtol=1e-6
    )
    assert_allclose(about_com.get_products(), 0.0, atol=1e-9)


@pytest.mark.parametrize(("tail", "gravity"), [("none", 1.62), ("swing", G)])
def test_lifted_car_falls_freely(tail, gravity):
    # No air force; inner springs, servo and joint stops push in pairs, so the centre of mass knows
    # gravity only.
    still_air = {"mode": tail, "normal_force_coefficient": 0.0}
    falling = CarStand(scenario_from_dict({"tail": still_air, "environment": {"gravity": gravity}}))
    falling.place(RigidTransform([0.0, 0.0, 2.0]))
    start = falling.com()
    time = 0.3
    step = falling.scenario.simulation.step
    falling.advance(time)
    # Solver tolerance: 1e-6 of a velocity of 3 m/s.
    assert_allclose(falling.com_velocity(), [0.0, 0.0, -gravity * time], atol=3e-6)
    # Symplectic Euler falls half a step ahead of the parabola, exactly.
    assert_allclose(
        falling.com() - start, [0.0, 0.0, -0.5 * gravity * time * (time + step)], atol=1e-6
    )
    assert not falling.contacts()


@pytest.mark.parametrize("car", [{}, {"mass": 7.5}, {"com_x": 0.16, "com_height": 0.18}])
def test_car_rests_at_nominal_ride_height_on_its_tyres(car):
    resting = stand(car=car)
    resting.advance(0.5)
    numbers = resting.scenario.car
    forces = resting.wheel_forces()
    for wheel in WHEELS:
        front = wheel.startswith("front")
        share = (
            numbers.com_x / numbers.wheelbase if front else 1 - numbers.com_x / numbers.wheelbase
        )
        load = numbers.mass * G * share / 2
        # Contact is solved to 1e-6; the ground's own stiffness of 1e10 N/m adds 1.5e-6 to the
        # tyres' compliance.
        assert_allclose(forces[wheel], [0.0, 0.0, load], rtol=1e-5, atol=1e-5)
        tyre = numbers.tyre_stiffness_front if front else numbers.tyre_stiffness_rear
        depth = numbers.tyre_radius - resting.wheel_height(wheel)
        assert depth == pytest.approx(load / tyre, rel=1e-4)
        assert abs(resting.suspension(wheel)) < 1e-8
    assert np.abs(resting.plant.GetVelocities(resting.plant_context)).max() < 1e-7


def test_springs_and_tyres_give_way_by_their_rates():
    # The same car with 1 kg in its chassis that its springs were not preloaded for.
    resting = stand()
    chassis = resting.chassis
    numbers = resting.scenario.car
    resting.advance(0.3)
    before = resting.wheel_loads()
    chassis.SetMass(resting.plant_context, chassis.get_mass(resting.plant_context) + 1.0)
    resting.advance(1.3)
    after = resting.wheel_loads()
    assert sum(after.values()) - sum(before.values()) == pytest.approx(1.0 * G, rel=1e-4)
    for wheel in WHEELS:
        front = wheel.startswith("front")
        more = after[wheel] - before[wheel]
        assert more > 1.0
        spring, _ = wheel_rates(numbers, "front" if front else "rear")
        # The springs stand off the vertical by a pitch of milliradians: its cosine is 1 to 1e-5.
        assert resting.suspension(wheel) == pytest.approx(more / spring, rel=1e-3)
        tyre = numbers.tyre_stiffness_front if front else numbers.tyre_stiffness_rear
        depth = numbers.tyre_radius - resting.wheel_height(wheel)
        assert depth == pytest.approx(after[wheel] / tyre, rel=1e-3)


@pytest.mark.parametrize(
    ("direction", "heavy", "light"), [("left", LEFT, RIGHT), ("right", RIGHT, LEFT)]
)
def test_tail_at_rest_loads_the_side_it_lies_on(direction, heavy, light):
    resting = stand("held", direction)
    resting.advance(2.0)
    assert len(resting.contacts()) == 8, "two edges of each tyre, and nothing within the car"
    forces = resting.wheel_loads()
    total = sum(forces.values())
    assert total == pytest.approx(resting.plant.CalcTotalMass(resting.plant_context) * G, rel=1e-5)
    assert sum(forces[wheel] for wheel in heavy) > sum(forces[wheel] for wheel in light)
    # Moments about the world's x axis: the wheels carry the weight where the centre of mass is.
    side = 1.0 if direction == "left" else -1.0
    moment = sum(forces[wheel] * point[1] for wheel, point in resting.wheel_contacts().items())
    # The edges of a tyre push against each other sideways, a fraction of a millimetre apart in
    # height.
    assert moment == pytest.approx(total * resting.com()[1], rel=1e-3)
    # The middle of the rod is half its length beside the car's middle, and the sail further out.
    tail = resting.scenario.tail
    assert side * resting.com()[1] > 0.5 * tail.length * tail.mass / (total / G)


def test_sliding_tyres_give_the_friction_of_the_scenario():
    stiff = {"suspension_motion_ratio": 1.0}
    sliding = stand(car={"tyre_friction": 0.3, "com_height": 0.15, **stiff})
    sliding.place(RigidTransform(), (0.0, 1.5, 0.0))
    sliding.advance(0.2)
    assert len(sliding.contacts()) == 8  # two edges per tyre
    for contact in sliding.contacts():
        assert sliding.shape_of(contact).startswith("tyre_")
    for wheel, force in sliding.wheel_forces().items():
        # Sideways sliding to the left: friction to the right. The solver is exact to about 1e-4 of
        # the normal force.
        assert force[1] == pytest.approx(-0.3 * force[2], rel=1e-3), wheel
        assert force[2] > 1.0


@pytest.mark.parametrize("tail", ["none", "held"])
def test_cage_slides_with_its_own_friction(tail):
    sliding = stand(tail, car={"tyre_friction": 0.7, "cage_friction": 0.3})
    sliding.place(
        RigidTransform(RollPitchYaw(math.pi, 0.0, 0.0), [0.0, 0.0, 0.3299]), (1.5, 0.0, 0.0)
    )
    sliding.advance(0.25)
    contacts = sliding.contacts()
    assert len(contacts) >= 3
    for contact in contacts:
        # `kLagged` bounds friction by the normal force of the step before, which no longer changes
        # here.
        force = contact.contact_force()
        assert contact.slip_speed() > 0.2
        assert np.linalg.norm(force[:2]) == pytest.approx(0.3 * abs(force[2]), rel=0.02), (
            sliding.shape_of(contact)
        )
        assert sliding.shape_of(contact).split("_")[0] in ("cage", "board", "tail")
    assert sliding.com_velocity()[0] == pytest.approx(1.5 - 0.3 * G * 0.25, rel=0.05)


@pytest.mark.slow
def test_differential_shaft_turns_at_the_mean_of_the_rear_wheels(standard_runs):
    for run in standard_runs.values():
        spins = {
            name: run.signal(f"plant_velocity_car_{name}_w")
            for name in ("rear_left_spin", "rear_right_spin", "drive_shaft_spin")
        }
        mean = (spins["rear_left_spin"] + spins["rear_right_spin"]) / 2
        # A hard constraint, solved to 0.01 rad/s of 50 in the worst steps (a wheel that lands),
        # once the tyres hold: the error of the start halves with every step of 2 ms.
        moving = run.time > 0.03
        assert_allclose(spins["drive_shaft_spin"][moving], mean[moving], atol=0.03)


@pytest.mark.slow
def test_outer_rear_wheel_turns_faster_through_a_turn():
    scenario = load_scenario("turn_held", [*HIGH_CAR, "manoeuvre.speed=2.0"])
    run = simulate(scenario)
    left, right = (
        run.signal(f"plant_velocity_car_rear_{side}_spin_w") for side in ("left", "right")
    )
    turning = (run.time > 2.2) & (run.time < 2.4)
    # All wheels stay on the ground. Left turn: r track / radius faster on the right, and up to 1
    # rad/s more, because the outer tyre is pressed flatter: 10 N more on one edge of it are 1.4 mm
    # of its radius.
    expected = run.signal("gyro_z_truth_rad_per_s") * scenario.car.track / scenario.car.tyre_radius
    assert_allclose((right - left)[turning], expected[turning], rtol=0.25)
    assert np.all(expected[turning] > 3.0)


def test_a_tail_begins_where_its_law_waits():
    """Backwards (pitch below 0) and in the middle for the feedback law, to the side for the
    others.
    """

    def begins(**sections):
        car = stand(tail=sections.pop("tail", "swing"), **sections)
        angles = [car.angle(name) for name in ("tail_pitch", "tail_roll")]
        return angles, car.plant.GetFrameByName("tail_rod").CalcPoseInWorld(
            car.plant_context
        ).rotation().col(2)

    feedback = {"controller": {"law": "feedback"}, "feedback": {"pitch_angle": -1.2}}
    angles, axis = begins(**feedback)
    assert angles == [-1.2, 0.0]
    assert_allclose(axis, [-math.sin(1.2), 0.0, math.cos(1.2)], atol=1e-12)
    assert begins(tail="held", **feedback)[0] == pytest.approx([0.0, -math.pi / 2])
    assert begins(direction="right", controller={"pitch_angle": 0.1})[0] == pytest.approx(
        [0.1, math.pi / 2]
    )


@pytest.mark.parametrize(
    ("car", "named"),
    [
        ({"mass": 2.0}, ("car.mass", "2")),
        ({"com_height": 0.05, "mass": 6.0}, ("car.com_height", "0.05")),
    ],
    ids=str,
)
def test_car_that_its_chassis_cannot_make_is_refused(car, named):
    assert_refused(lambda: car_sdf(scenario_from_dict({"car": car})), ModelError, *named)


MOUNT = '<joint name="gearbox_mount" type="fixed">'


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('type="prismatic"', 'type="telescopic"'),
        ("<mass>", "<mass>-"),
        ('name="rear_left_spin" a=', 'name="rear_left_spun" a='),
        (MOUNT, f"{MOUNT}<springiness>3</springiness>"),
    ],
    ids=["joint", "mass", "mimic", "warning"],
)
def test_model_of_which_the_parser_complains_is_refused_by_file(tmp_path, old, new):
    broken = edited(car_sdf(scenario_from_dict({})), old, new, tmp_path / "broken.sdf")
    assert_refused(lambda: parse_model(MultibodyPlant(0.002), broken), ModelError, "broken.sdf")
