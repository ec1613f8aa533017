import numpy as np
import pytest

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.signals import (
    GPS_FILTER,
    IMU_FILTER,
    RIG_FILTER,
    LowPass,
    RowUnwrapper,
    check_signals,
    in_parts,
    low_pass,
)
from tests.refusals import assert_refused

FILTERS = [IMU_FILTER, GPS_FILTER, RIG_FILTER]


def sine(time, hertz):
    return np.sin(2.0 * np.pi * hertz * time)


def gain_and_lag(design, hertz):
    """Measured gain and phase lag (rad) at one frequency, from the middle of 40 periods."""
    time = np.arange(0.0, 40.0 / hertz, 1.0 / (200.0 * design.cutoff_hz))
    middle = slice(len(time) // 4, 3 * len(time) // 4)
    out = low_pass(time, sine(time, hertz), design)[middle]
    basis = np.column_stack([sine(time, hertz), np.cos(2.0 * np.pi * hertz * time)])[middle]
    in_phase, out_of_phase = np.linalg.lstsq(basis, out, rcond=None)[0]
    return float(np.hypot(in_phase, out_of_phase)), float(np.arctan2(-out_of_phase, in_phase))


@pytest.mark.parametrize(
    "design", FILTERS, ids=lambda design: f"order {design.order}, {design.cutoff_hz:g} Hz"
)
@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.5])
def test_two_passes_square_the_butterworth_gain_and_shift_nothing(design, ratio):
    """1/(1 + (f/fc)^2n) is the analogue gain squared; at 200 samples per period of fc the digital
    filter meets it.
    """
    gain, lag = gain_and_lag(design, ratio * design.cutoff_hz)
    assert gain == pytest.approx(1.0 / (1.0 + ratio ** (2 * design.order)), rel=1e-2)
    assert lag == pytest.approx(0.0, abs=1e-3)


def test_jittered_times_are_filtered_like_even_ones():
    rng = np.random.default_rng(1)
    time = np.arange(2000) / 100.0 + rng.uniform(-0.002, 0.002, 2000)
    out = low_pass(time, sine(time, 0.5), IMU_FILTER)
    # Linear interpolation of a 0.5 Hz sine at 10 ms errs by (2 pi 0.5)^2 0.01^2 / 8 = 1.2e-4 each
    # way.
    np.testing.assert_allclose(out[300:-300], sine(time, 0.5)[300:-300], atol=1e-3)


SHORT = np.arange(10) / 10.0
WITH_NAN = np.where(np.isin(np.arange(100), [42, 50]), np.nan, 0.0)
HUNDRED = np.arange(100) / 100.0
WITH_GAP = np.delete(HUNDRED, np.arange(50, 56))


def with_time(row, value):
    time = SHORT.copy()
    time[row] = value
    return time


@pytest.mark.parametrize(
    ("work", "named"),
    [
        (
            lambda: low_pass(10.0 * HUNDRED, np.zeros(100), IMU_FILTER, "gyro"),
            ["gyro", "5 Hz", "10"],
        ),
        (
            lambda: low_pass(0.5 * HUNDRED[::10], np.zeros(10), LowPass(6, 5.0), "gyro"),
            ["gyro", "10", "6"],
        ),
        (
            lambda: check_signals(HUNDRED, {"fine": np.zeros(100), "current_a": WITH_NAN}),
            ["current_a", "2", "nan", "0.42 s"],
        ),
        (lambda: check_signals(with_time(4, 0.2), {}), ["time_s", "row 5", "0.2 s"]),
        (lambda: check_signals(with_time(7, 0.6), {}), ["time_s", "row 8", "0.6 s"]),
        (lambda: check_signals(with_time(3, np.nan), {}), ["time_s", "nan", "row 4"]),
        (lambda: check_signals(SHORT[:1], {}), ["time_s", "1", "2"]),
        (
            lambda: check_signals(WITH_GAP, {}),
            ["time_s", "1 gap", "0.07 s", "0.49 s", "0.015 s"],
        ),
        (lambda: check_signals(SHORT, {"angle_rad": np.zeros(9)}), ["angle_rad", "9", "10"]),
    ],
)
def test_what_is_wrong_with_a_signal_is_named_with_column_and_time(work, named):
    assert_refused(work, LogError, *named)


def test_headings_of_rows_are_unwrapped_by_whole_turns_over_any_jump():
    """The first row stays; each later one comes within half a turn of the one before."""
    unwrapper = RowUnwrapper(["time_s", "imu_yaw_rad", "sail_angle_rad"])
    rows = [unwrapper.apply(np.array([0.0, yaw, yaw])) for yaw in (9.0, -3.0, 3.0, -3.0, 0.4)]
    turn = 2 * np.pi
    expected = [9.0, turn - 3.0 + turn, turn + 3.0, 2 * turn - 3.0, turn + 0.4]
    assert [row[1] for row in rows] == pytest.approx(expected)
    assert [row[2] for row in rows] == [9.0, -3.0, 3.0, -3.0, 0.4]


@pytest.mark.parametrize("parts", [[(0.2, 0.4)], [(0.2, 0.3), (0.4, 0.4)]])
def test_both_ends_of_a_part_belong_to_it(parts):
    time = np.arange(8) * 0.1
    inside = in_parts(time.round(1), parts)
    assert inside.tolist() == [False, False, True, True, True, False, False, False]
