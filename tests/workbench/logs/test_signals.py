import numpy as np
import pytest

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.signals import (
    GPS_FILTER,
    IMU_FILTER,
    RIG_FILTER,
    LowPass,
    check_gaps,
    check_signals,
    low_pass,
)

FILTERS = [IMU_FILTER, GPS_FILTER, RIG_FILTER]


def sine(time: np.ndarray, hertz: float) -> np.ndarray:
    return np.sin(2.0 * np.pi * hertz * time)


def gain_and_lag(design: LowPass, hertz: float) -> tuple[float, float]:
    """Measured gain and phase lag (rad) at one frequency, from the middle of 40 periods."""
    time = np.arange(0.0, 40.0 / hertz, 1.0 / (200.0 * design.cutoff_hz))
    middle = slice(len(time) // 4, 3 * len(time) // 4)
    out = low_pass(time, sine(time, hertz), design)[middle]
    basis = np.column_stack([sine(time, hertz), np.cos(2.0 * np.pi * hertz * time)])[middle]
    in_phase, out_of_phase = np.linalg.lstsq(basis, out, rcond=None)[0]
    return float(np.hypot(in_phase, out_of_phase)), float(np.arctan2(-out_of_phase, in_phase))


def test_the_filters_are_those_of_the_car_and_the_rig() -> None:
    assert [(design.order, design.cutoff_hz) for design in FILTERS] == [
        (2, 5.0),
        (2, 1.0),
        (6, 20.0),
    ]


@pytest.mark.parametrize(
    "design", FILTERS, ids=lambda design: f"order {design.order}, {design.cutoff_hz:g} Hz"
)
@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.5])
def test_two_passes_square_the_butterworth_gain_and_shift_nothing(
    design: LowPass, ratio: float
) -> None:
    """1/(1 + (f/fc)^2n) is the analogue gain squared; at 200 samples per period of fc the digital
    filter meets it.
    """
    gain, lag = gain_and_lag(design, ratio * design.cutoff_hz)
    assert gain == pytest.approx(1.0 / (1.0 + ratio ** (2 * design.order)), rel=1e-2)
    assert lag == pytest.approx(0.0, abs=1e-3)


def test_a_constant_passes_unchanged() -> None:
    time = np.arange(500) / 100.0
    np.testing.assert_allclose(low_pass(time, np.full(500, -3.7), IMU_FILTER), -3.7, rtol=1e-12)


def test_jittered_times_are_filtered_like_even_ones() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(2000) / 100.0 + rng.uniform(-0.002, 0.002, 2000)
    out = low_pass(time, sine(time, 0.5), IMU_FILTER)
    # Linear interpolation of a 0.5 Hz sine at 10 ms errs by (2 pi 0.5)^2 0.01^2 / 8 = 1.2e-4 each
    # way.
    np.testing.assert_allclose(out[300:-300], sine(time, 0.5)[300:-300], atol=1e-3)


def test_a_filter_that_the_sample_rate_cannot_carry_is_refused() -> None:
    time = np.arange(100) / 10.0
    with pytest.raises(
        LogError, match="'gyro': cut-off 5 Hz needs more than 10 samples per second"
    ):
        low_pass(time, np.zeros(100), IMU_FILTER, "gyro")
    with pytest.raises(LogError, match="too few"):
        low_pass(time[:4] / 10.0, np.zeros(4), IMU_FILTER, "gyro")


def test_a_nan_is_reported_with_column_and_time() -> None:
    time = np.arange(100) / 100.0
    bad = np.zeros(100)
    bad[[42, 50]] = np.nan
    for act in (
        lambda: check_signals(time, {"fine": np.zeros(100), "current_a": bad}),
        lambda: low_pass(time, bad, IMU_FILTER, "current_a"),
    ):
        with pytest.raises(
            LogError, match=r"'current_a': 2 sample\(s\) not finite, first nan at 0.42 s"
        ):
            act()


def test_unsorted_and_repeated_times_are_reported() -> None:
    time = np.arange(10) / 10.0
    for row, value in ((4, 0.2), (7, 0.6)):
        wrong = time.copy()
        wrong[row] = value
        with pytest.raises(
            LogError, match=rf"'time_s': not increasing in row {row}, {value:g} s after"
        ):
            check_signals(wrong, {})
    time[3] = np.nan
    with pytest.raises(LogError, match="nan in row 3"):
        check_signals(time, {})


def test_a_gap_is_reported_with_its_place_and_length() -> None:
    time = np.concatenate([np.arange(50), np.arange(56, 100)]) / 100.0
    with pytest.raises(
        LogError, match=r"1 gap\(s\), the first of 0.07 s after 0.49 s; at most 0.015 s"
    ):
        check_signals(time, {})
    check_gaps(time, largest_step=0.1)


def test_a_signal_of_another_length_is_refused() -> None:
    with pytest.raises(LogError, match="'angle_rad': 9 samples for 10 times"):
        check_signals(np.arange(10.0), {"angle_rad": np.zeros(9)})
