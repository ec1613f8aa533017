import numpy as np
from numpy.testing import assert_array_equal

from aerodima.workbench.core.sampled import CounterNoise


def test_same_seed_and_name_repeat_bit_for_bit_in_any_order():
    forwards = CounterNoise(7, "imu", 9)
    backwards = CounterNoise(7, "imu", 9)
    a = np.array([forwards.at(k) for k in range(300)])
    b = np.array([backwards.at(k) for k in reversed(range(300))])[::-1]
    assert_array_equal(a, b)


def test_other_seed_or_name_is_independent():
    """20000 numbers each: the correlation of independent streams is 0 +- 0.007; 0.03 is four
    deviations.
    """
    streams = [
        np.array([noise.at(k) for k in range(20000)])[:, 0]
        for noise in (
            CounterNoise(7, "imu", 1),
            CounterNoise(8, "imu", 1),
            CounterNoise(7, "gps", 1),
        )
    ]
    correlation = np.corrcoef(streams)
    assert np.max(np.abs(correlation - np.eye(3))) < 0.03


def test_numbers_are_standard_normal_and_white():
    """Mean, deviation, kurtosis and autocorrelation of 45000 numbers, within five standard
    errors.
    """
    noise = CounterNoise(1, "imu", 9)
    x = np.array([noise.at(k) for k in range(5000)])
    n = x.size
    assert abs(x.mean()) < 5 / np.sqrt(n)
    assert abs(x.std() - 1.0) < 5 / np.sqrt(2 * n)
    assert abs((x**4).mean() - 3.0) < 5 * np.sqrt(96 / n)
    for lag in (1, 64):
        assert abs((x[lag:] * x[:-lag]).mean()) < 5 / np.sqrt(n)


def test_bias_of_the_run_is_constant_and_no_sample():
    noise = CounterNoise(3, "imu", 9)
    assert_array_equal(noise.constant(), CounterNoise(3, "imu", 9).constant())
    assert not any(np.array_equal(noise.constant(), noise.at(k)) for k in range(200))
