import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from aerodima.workbench.car.car_sensors import STEPS, ChassisMotion, Imu, motion_at_imu
from aerodima.workbench.scenario.signal_table import IMU
from tests.workbench.car.body_motion import motion_vector
from tests.workbench.samples import sampled

QUIET = {"gyro_noise": 0.0, "gyro_bias": 0.0, "accelerometer_noise": 0.0, "attitude_noise": 0.0}
ORIGIN = np.zeros(3)
STEP = 0.002


def settings(**changes):
    return SimpleNamespace(**({"rate": 100.0, "delay": 0.0} | QUIET | changes))


def still(R_WB=None):
    """Pose, velocity, acceleration of a body at rest."""
    return (
        RigidTransform(R_WB or RotationMatrix(), [1.0, 2.0, 3.0]),
        SpatialVelocity(np.zeros(3), np.zeros(3)),
        SpatialAcceleration(np.zeros(3), np.zeros(3)),
    )


def imu_on(motion, p_BoImu_B=ORIGIN, seed=1, **changes):
    """IMU whose input is fixed to a motion; the simulator that runs it."""
    imu = Imu(settings(**changes), p_BoImu_B=p_BoImu_B, seed=seed, step=STEP)
    simulator = Simulator(imu)
    imu.get_input_port().FixValue(simulator.get_mutable_context(), motion_vector(*motion, STEP))
    simulator.Initialize()
    return simulator


def sample(motion, **arguments):
    return IMU.read(sampled(imu_on(motion, **arguments), [0.0], "imu")[0])


def samples(count, **arguments):
    """(count, 9) successive samples."""
    return sampled(imu_on(**arguments), 0.01 * np.arange(count) + 0.005, "imu")


def test_hanging_still_shows_no_linear_acceleration_in_any_attitude():
    """Gravity is removed completely, with the chip's resolution of 0.01 m/s2 exactly at zero."""
    for roll_pitch_yaw in ([0.0, 0.0, 0.0], [0.5, -0.3, 2.0], [3.0, 0.2, -1.0]):
        shown = sample(still(RotationMatrix(RollPitchYaw(roll_pitch_yaw))))
        assert (shown.acceleration_x, shown.acceleration_y, shown.acceleration_z) == (0.0, 0.0, 0.0)
        assert (shown.gyro_x, shown.gyro_y, shown.gyro_z) == (0.0, 0.0, 0.0)
        # One count of the attitude is 1/900 rad; rounding makes half of it.
        assert_allclose([shown.roll, shown.pitch, shown.yaw], roll_pitch_yaw, atol=0.51 / 900)


def test_motion_at_the_imu_is_the_second_derivative_of_its_path():
    """A body that stands askew, turns faster and faster about another axis, and is pushed: against
    differences of the path (error about 1e-5).
    """
    attitude = [0.9, -0.3, 1.5]
    R_WB = RotationMatrix(RollPitchYaw(attitude)).matrix()
    omega, alpha, pushed = np.array([[3.0, -0.5, 1.5], [2.0, 4.0, -3.0], [0.7, -2.0, 1.6]])
    lever = np.array([0.12, -0.05, 0.2])
    t = np.array([[-1e-3], [0.0], [1e-3]])
    turned = Rotation.from_rotvec(t * omega + t**2 / 2 * alpha)
    path = t**2 / 2 * pushed + turned.apply(R_WB @ lever)
    shown = motion_at_imu(ChassisMotion(R_WB, omega, alpha, pushed), lever)
    expected = (attitude, R_WB.T @ omega, R_WB.T @ np.diff(path, 2, axis=0)[0] / 1e-6)
    for found, value, error in zip(shown, expected, (1e-12, 1e-9, 1e-3), strict=True):
        assert_allclose(found, value, atol=error)


def test_ranges_of_the_chip():
    """The gyro stops at 2000 deg/s; the accelerometer at 4 g of specific force, so 3 g upwards and
    5 g downwards.
    """
    hard = np.array([100.0, -100.0, 100.0])
    up = (
        RigidTransform(),
        SpatialVelocity(hard, np.zeros(3)),
        SpatialAcceleration(np.zeros(3), [90.0, -90.0, 90.0]),
    )
    shown = sample(up)
    limit = math.radians(2000.0)
    assert_allclose(shown[3:6], [limit, -limit, limit], atol=1e-3)
    four_g = 4 * 9.80665
    # The horizontal axes also feel the centripetal part of the lever arm, which is zero here.
    assert_allclose(shown[6:], [four_g, -four_g, four_g - 9.81], atol=0.006)
    down = (
        RigidTransform(),
        SpatialVelocity(np.zeros(3), np.zeros(3)),
        SpatialAcceleration(np.zeros(3), [0.0, 0.0, -90.0]),
    )
    assert sample(down).acceleration_z == pytest.approx(-four_g - 9.81, abs=0.006)


def test_noise_has_the_asked_deviations_and_one_bias_per_run():
    """2000 samples per axis: a standard deviation is known to 1.6 %, so 8 % is five standard
    errors.
    """
    noisy = {
        "gyro_noise": 0.05,
        "gyro_bias": 0.2,
        "accelerometer_noise": 0.5,
        "attitude_noise": 0.02,
    }
    rows = samples(2000, motion=still(), **noisy)
    assert_allclose(rows.std(axis=0), np.repeat([0.02, 0.05, 0.5], 3), rtol=0.08)
    bias = rows[:, 3:6].mean(axis=0)
    assert np.all(np.abs(bias) > 0.006), (
        "more than five standard errors of the mean: a bias, not noise"
    )
    assert_allclose(rows[:, [0, 1, 2]].mean(axis=0), 0.0, atol=5 * 0.02 / math.sqrt(2000))
    assert_allclose(rows[:, 6:].mean(axis=0), 0.0, atol=5 * 0.5 / math.sqrt(2000))
    biases = [sample(still(), seed=seed, gyro_bias=0.2)[3:6] for seed in range(300)]
    # 900 biases: their deviation is known to 2.4 %.
    assert np.std(biases) == pytest.approx(0.2, rel=0.12)


def test_resolution_of_the_data_sheet():
    rows = samples(
        20, motion=still(), gyro_noise=0.05, accelerometer_noise=0.5, attitude_noise=0.02
    )
    counts = rows * np.repeat([900.0, 900.0, 100.0], 3)
    assert_allclose(counts, np.round(counts), atol=1e-9)
    assert STEPS[0] == pytest.approx(1 / 900)
