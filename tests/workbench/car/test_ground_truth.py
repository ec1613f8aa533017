"""The ground truth agrees with itself: derivatives, Newton's law, momentum, lines of action,
power.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import WHEELS

STEP = 0.002
G = 9.81


@pytest.fixture(params=["none", "held", "designed"])
def run(standard_runs, request):
    return standard_runs[request.param]


@pytest.fixture(params=["held", "designed"])
def tailed(standard_runs, request):
    return standard_runs[request.param]


def rate_of(values):
    """Backward difference: what happened in the step before each row but the first."""
    return np.diff(values, axis=0) / STEP


def rotation(run):
    """R_WB per row from roll, pitch and yaw, shape (n, 3, 3)."""
    angles = [run.signal(f"{name}_truth_rad") for name in ("yaw", "pitch", "roll")]
    return Rotation.from_euler("ZYX", np.column_stack(angles)).as_matrix()


def in_world(run, vectors):
    return np.einsum("nij,nj->ni", rotation(run), vectors)


def test_velocity_is_the_derivative_of_position_in_body_axes(run):
    velocity = in_world(run, run.vector("velocity", "truth_m_per_s"))
    # The plant moves with the velocity of the end of the step; the turning of the body adds |gyro|
    # v dt = 0.02 m/s.
    assert_allclose(rate_of(run.vector("position", "truth_m")), velocity[1:], atol=0.02)


def test_tilt_is_the_angle_between_both_up_axes(run):
    expected = np.arccos(np.clip(rotation(run)[:, 2, 2], -1.0, 1.0))
    # Near zero the cosine resolves angles to 2e-8 only.
    assert_allclose(run.signal("tilt_truth_rad"), expected, atol=1e-7)


def test_acceleration_is_that_of_the_imu_with_the_turning_of_the_axes(run):
    velocity = run.vector("velocity", "truth_m_per_s")
    gyro = run.vector("gyro", "truth_rad_per_s")
    imu = run.scenario["imu"]
    lever = np.array([imu["x"], 0.0, imu["z"]])
    turning = gyro[1:]
    expected = (
        rate_of(velocity)
        + np.cross(turning, velocity[1:])
        + np.cross(rate_of(gyro), lever)
        + np.cross(turning, np.cross(turning, lever))
    )
    error = run.vector("acceleration", "truth_m_per_s2")[1:] - expected
    # First order in the step: 0.002 s times jerks of up to 1000 m/s3 at the kick of the drive.
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.02
    assert np.abs(np.cross(turning, velocity[1:])[:, 1]).max() > 3.0


def test_wheels_air_and_weight_accelerate_the_centre_of_mass(run):
    com = run.vector("com", "truth_m")
    mass = run.extra["total_mass_kg"]
    acceleration = np.diff(com, n=2, axis=0) / STEP**2
    force = sum(run.vector(f"wheel_force_{wheel}", "truth_n") for wheel in WHEELS)[2:] - [
        0.0,
        0.0,
        mass * G,
    ]
    if run.has_tail:
        force = force + run.vector("tail_force", "truth_n")[1:-1]
    error = force / mass - acceleration
    # Rows of the second difference see the force of the step between them: noise of first order in
    # the step.
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.05
    assert np.abs(acceleration[:, :2]).max() > 2.0


def test_contact_points_lie_on_the_ground_under_their_wheels(run):
    row = 950
    scenario = run.scenario["car"]
    # Contact is that of the plant's last step, which began at the row before.
    origin = run.vector("position", "truth_m")[row - 1]
    yaw = run.signal("yaw_truth_rad")[row - 1]
    R_BW = np.array(
        [[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    )
    for wheel in WHEELS:
        x = scenario["wheelbase"] if wheel.startswith("front") else 0.0
        y = scenario["track"] / 2 * (1 if wheel.endswith("left") else -1)
        point = R_BW @ (
            run.vector(f"wheel_contact_{wheel}", "truth_m")[row] - [origin[0], origin[1], 0.0]
        )
        # The tyres of a car that leans by a few mrad stand more on one edge than on the other, and
        # 2 mm deep.
        assert_allclose(point[[0, 2]], [x, 0.0], atol=0.003)
        assert abs(point[1] - y) < 0.4 * scenario["tyre_width"]


def test_nothing_but_wheels_touches_the_ground_in_a_clean_turn(run):
    for part in ("cage", "board", "tail"):
        assert np.all(run.signal(f"ground_contact_{part}_truth_n") == 0.0)


def test_tail_momentum_is_its_mass_times_the_velocity_of_its_centre_of_mass(tailed):
    mass = tailed.extra["tail_mass_kg"]
    momentum = tailed.vector("tail_momentum", "truth_n_s")[1:]
    assert np.abs(momentum).max() > 0.4
    # Along an arc at 8 rad/s the chord of a step differs from the velocity at its end by 1 % of 0.5
    # N s.
    assert_allclose(mass * rate_of(tailed.vector("tail_com", "truth_m")), momentum, atol=0.006)


def test_angular_momentum_counts_about_the_world_origin(standard_runs):
    run = standard_runs["held"]
    com = run.vector("tail_com", "truth_m")
    momentum = run.vector("tail_momentum", "truth_n_s")
    spin = run.vector("tail_angular_momentum", "truth_n_m_s") - np.cross(com, momentum)
    # The held tail turns with the car only: inertia about its own centre of mass times the car's
    # rates.
    straight = (run.time > 1.5) & (run.time < 2.0)
    assert_allclose(spin[straight], 0.0, atol=1e-3)
    turning = (run.time > 2.2) & (run.time < 2.5)
    inertia = spin[turning, 2] / run.signal("gyro_z_truth_rad_per_s")[turning]
    tail = run.scenario["tail"]
    rod = tail["mass"] * (1 - tail["sail_mass_fraction"])
    sail = tail["mass"] * tail["sail_mass_fraction"]
    middle = tail["length"] - tail["sail_length"] / 2
    about_root = (
        rod * tail["length"] ** 2 / 3
        + sail * (middle**2 + tail["sail_length"] ** 2 / 12)
        + sail * tail["sail_width"] ** 2 / 12
    )
    offset = (rod * tail["length"] / 2 + sail * middle) / run.extra["tail_mass_kg"]
    # The hub of 0.05 kg adds its own 2e-5 kg m2.
    assert_allclose(inertia, about_root - run.extra["tail_mass_kg"] * offset**2, rtol=0.02)


def test_tip_is_one_length_from_the_joints_and_on_the_side_of_the_roll_angle(tailed):
    length = tailed.scenario["tail"]["length"]
    mount = np.array(
        [tailed.scenario["tail"]["mount_x"], 0.0, tailed.scenario["tail"]["mount_height"]]
    )
    root = tailed.vector("position", "truth_m") + in_world(
        tailed, np.tile(mount, (len(tailed.table), 1))
    )
    arm = tailed.vector("tail_tip", "truth_m") - root
    # The chassis frame is B: the joints move with it exactly.
    assert_allclose(np.linalg.norm(arm, axis=1), length, atol=1e-6)
    in_body = np.einsum("nji,nj->ni", rotation(tailed), arm)
    roll = tailed.signal("plant_position_tail_tail_roll_q")
    assert_allclose(in_body[:, 1], -length * np.sin(roll), atol=0.01)


def test_drive_power_becomes_kinetic_energy_on_rigid_tyres():
    settings = ("car.tyre_slip_angle=0", "manoeuvre.duration=2.6")
    run = simulate(load_scenario("turn_none", settings))
    until = run.time <= 1.9
    work = trapezoid(run.signal("drive_power_truth_w")[until], run.time[until])
    car = run.scenario["car"]
    drive = run.scenario["drive"]
    speed = run.signal("velocity_x_truth_m_per_s")[950]
    spin = run.signal("plant_velocity_car_drive_shaft_spin_w")[950]
    wheels = 4 * 0.5 * car["wheel_mass"] * car["tyre_radius"] ** 2
    kinetic = 0.5 * car["mass"] * speed**2 + 0.5 * (wheels + drive["rotor_inertia"]) * spin**2
    # The rest is slip of the driven tyres while the car accelerates.
    assert kinetic < work < 1.05 * kinetic
