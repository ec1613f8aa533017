import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.analysis import Simulator

from aerodima.workbench.car.roll_estimator import RollEstimator
from aerodima.workbench.car.roll_filter import RollEstimate, RollFilterSettings, estimate_roll

RATE = 100.0
G = 9.81


def smooth_pulse(times, start, length, height):
    x = np.clip((times - start) / length, 0.0, 1.0)
    return height * np.sin(math.pi * x) ** 2


def imu_rows(times, roll, pitch, yaw_rate, speed, attitude_error=0.0, side_slip_acceleration=0.0):
    """What a perfect gyro and accelerometer report on a car with these histories, through a chip
    with a wrong roll.

    Body rates from the kinematics of roll, pitch, yaw; acceleration of a point that drives ahead at
    `speed` (so omega x v) in body axes; the chip removes gravity with its own roll, wrong by
    `attitude_error`.
    """
    roll_rate = np.gradient(roll, times)
    pitch_rate = np.gradient(pitch, times)
    p = roll_rate - yaw_rate * np.sin(pitch)
    q = pitch_rate * np.cos(roll) + yaw_rate * np.sin(roll) * np.cos(pitch)
    r = -pitch_rate * np.sin(roll) + yaw_rate * np.cos(roll) * np.cos(pitch)

    def up(angle):
        return np.array(
            [-np.sin(pitch), np.sin(angle) * np.cos(pitch), np.cos(angle) * np.cos(pitch)]
        ).T

    motion = np.array([np.gradient(speed, times), speed * r + side_slip_acceleration, -speed * q]).T
    linear = motion + G * up(roll) - G * up(roll + attitude_error)
    return np.column_stack([roll + attitude_error, pitch, np.zeros_like(roll), p, q, r, linear])


def run(rows, speed, settings=None):
    estimate = RollEstimate()
    estimates = []
    for row, v in zip(rows, speed, strict=True):
        estimate = estimate_roll(estimate, row, v, settings or RollFilterSettings())
        estimates.append(estimate)
    return np.array(estimates)


def hard_left_turn(times, side=1.0):
    """Left turn at 4 m/s, yaw rate up to 2.5 rad/s; the car rolls outwards (right, +) by up to 0.5
    rad.
    """
    roll = side * smooth_pulse(times, 2.0, 0.9, 0.5)
    pitch = 0.02 * np.ones_like(times)
    yaw_rate = side * smooth_pulse(times, 2.0, 0.7, 2.5)
    return roll, pitch, yaw_rate, np.full_like(times, 4.0)


TIMES = np.arange(0.0, 4.0, 1.0 / RATE)


def test_error_in_a_hard_turn_stays_below_three_hundredths_of_a_radian():
    """Perfect sensors: what remains is the integration at 100 Hz, one tick of the peak rate of 1.75
    rad/s at most.
    """
    roll, pitch, yaw_rate, speed = hard_left_turn(TIMES)
    estimate = run(imu_rows(TIMES, roll, pitch, yaw_rate, speed), speed)
    assert np.max(np.abs(estimate[:, 0] - roll)) < 0.03
    assert np.max(np.abs(estimate[:, 2] - np.gradient(roll, TIMES))) < 0.02
    assert estimate[:, 0].max() == pytest.approx(0.5, abs=0.03)


def test_slip_late_speed_and_gyro_bias_cost_less_than_a_tenth_of_a_radian():
    """The car slides (2 m/s2 less than v r), the GPS says 3 instead of 4 m/s, the gyro is off by
    0.02 rad/s.
    """
    roll, pitch, yaw_rate, speed = hard_left_turn(TIMES)
    rows = imu_rows(
        TIMES,
        roll,
        pitch,
        yaw_rate,
        speed,
        side_slip_acceleration=-smooth_pulse(TIMES, 2.0, 0.7, 2.0),
    )
    rows[:, 3] += 0.02
    estimate = run(rows, np.where(TIMES > 2.0, 3.0, 4.0))
    assert np.max(np.abs(estimate[:, 0] - roll)) < 0.1


def test_right_turn_mirrors_the_left_one():
    left = hard_left_turn(TIMES)
    right = hard_left_turn(TIMES, side=-1.0)
    a = run(imu_rows(TIMES, *left), left[3])
    b = run(imu_rows(TIMES, *right), right[3])
    assert_allclose(a[:, 0], -b[:, 0], atol=1e-12)
    assert_allclose(a[:, 2], -b[:, 2], atol=1e-12)


def test_yawing_while_pitched_is_no_roll():
    """Constant pitch of 0.1 rad and a slow circle: the body's p is not zero, the roll angle
    stays.
    """
    times = np.arange(0.0, 6.0, 0.01)
    zeros = np.zeros_like(times)
    rows = imu_rows(times, zeros, zeros + 0.1, zeros + 0.3, zeros + 1.0)
    assert np.max(np.abs(rows[:, 3])) > 0.02
    estimate = run(rows, zeros + 1.0)
    assert np.max(np.abs(estimate[:, 0])) < 0.005
    assert np.max(np.abs(estimate[:, 2])) < 0.005


@pytest.mark.parametrize(("share", "slower"), [(0.0, 1.0), (1.0, 2.0), (2.0, 17.0)])
def test_accelerometer_corrects_a_wrong_start_the_slower_the_more_the_car_accelerates(
    share, slower
):
    """The error decays as exp(-t / T); T is 1 s at rest and grows by 1 + (a / a_trust)^4. An
    acceleration upwards does not tilt what is felt.
    """
    settings = RollFilterSettings()
    estimate = RollEstimate(roll=0.2, pitch=-0.1, started=1.0)
    row = np.zeros(9)
    row[8] = share * settings.trust_acceleration
    for _ in range(100):
        estimate = estimate_roll(estimate, row, 0.0, settings)
    left = math.exp(-1.0 / (settings.time_constant * slower))
    assert estimate.roll == pytest.approx(0.2 * left, rel=0.01)
    assert estimate.pitch == pytest.approx(-0.1 * left, rel=0.01)


def test_gyro_bias_leaves_bias_times_time_constant():
    row = np.zeros(9)
    row[3] = 0.02
    estimate = RollEstimate()
    for _ in range(1000):
        estimate = estimate_roll(estimate, row, 0.0, RollFilterSettings())
    assert estimate.roll == pytest.approx(0.02, rel=0.03)


@pytest.mark.parametrize("error", [0.2, -0.1])
def test_wrong_attitude_of_the_chip_does_not_matter_at_rest(error):
    """The chip's own gravity removal is undone: whatever roll it shows, it has felt gravity where
    it is; from the first sample on.
    """
    times = np.arange(0.0, 20.0, 0.01)
    zeros = np.zeros_like(times)
    rows = imu_rows(times, zeros + 0.15, zeros - 0.1, zeros, zeros, attitude_error=error)
    estimate = run(rows, zeros)
    assert_allclose(estimate[:, :2] - [0.15, -0.1], 0.0, atol=1e-9)


def test_lost_imu_keeps_the_angle_and_shows_no_rate():
    before = RollEstimate(0.3, 0.1, 2.0, 1.0)
    after = estimate_roll(before, np.full(9, math.nan), 4.0, RollFilterSettings())
    assert after == RollEstimate(0.3, 0.1, 0.0, 1.0)
    assert math.isfinite(estimate_roll(before, np.zeros(9), math.nan, RollFilterSettings()).roll)


def test_overturned_car_is_followed_past_90_degrees():
    times = np.arange(0.0, 2.0, 0.01)
    roll = np.interp(times, [0.0, 0.5, 1.0, 2.0], [0.0, 0.0, 2.5, 2.5])
    zeros = np.zeros_like(times)
    estimate = run(imu_rows(times, roll, zeros, zeros, zeros), zeros)
    assert estimate[-1, 0] == pytest.approx(2.5, abs=0.05)


def test_system_runs_the_filter_at_100_hz():
    estimator = RollEstimator()
    simulator = Simulator(estimator)
    context = simulator.get_mutable_context()
    row = np.zeros(9)
    row[3] = 0.5
    estimator.GetInputPort("imu").FixValue(context, row)
    estimator.GetInputPort("speed").FixValue(context, [0.0])
    simulator.AdvanceTo(0.195)
    expected = run(np.tile(row, (20, 1)), np.zeros(20))[-1]
    assert estimator.GetOutputPort("roll_estimate").Eval(context)[0] == pytest.approx(
        expected[0], abs=1e-15
    )
    assert estimator.GetOutputPort("roll_rate_estimate").Eval(context)[0] == pytest.approx(0.5)
    assert not estimator.HasAnyDirectFeedthrough()
