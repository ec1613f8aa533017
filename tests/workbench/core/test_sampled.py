import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.analysis import Simulator

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.quantity import check_rate
from aerodima.workbench.core.sampled import SampledSensor
from tests.refusals import assert_refused
from tests.workbench.samples import sampled


class Clock(SampledSensor):
    """Measures the time and its square, and counts."""

    def __init__(self, rate=100.0, delay=0.0):
        super().__init__(name="clock", outputs={"time": 1, "more": 2}, rate=rate, delay=delay)
        self.indices = []

    def measure(self, context, index):
        self.indices.append(index)
        time = context.get_time()
        return np.array([time, time**2, index])


def record(clock, times):
    """Time shown and sample time just before each of `times`."""
    simulator = Simulator(clock)
    simulator.Initialize()
    return sampled(simulator, times, "time", "sample_time").T


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.01, 0.025, 0.1])
def test_delay_is_exact_for_whole_and_broken_periods(delay):
    """Between its appearances the output holds the sample of k / rate that is at least `delay`
    old; of a robot that stood still before the run, aged as in steady running.
    """
    times = 0.0011 + 0.002 * np.arange(350)
    shown, sample_time = record(Clock(delay=delay), times)
    expected = np.floor((times - delay) * 100.0 + 1e-6) / 100.0
    assert_allclose(shown, np.maximum(0.0, expected), atol=1e-12)
    assert_allclose(sample_time[5:], expected[5:], atol=1e-12)
    age = times - sample_time
    assert delay - 1e-12 <= age.min() <= delay + 0.002
    assert delay + 0.008 <= age.max() <= delay + 0.01


def test_sample_appears_at_the_very_instant_delay_after_it_was_taken():
    shown, _ = record(Clock(delay=0.025), [0.5349, 0.5351])
    assert_allclose(shown, [0.50, 0.51])


def test_exactly_one_sample_every_period():
    clock = Clock(delay=0.004)
    simulator = Simulator(clock)
    simulator.Initialize()
    clock.indices.clear()
    simulator.AdvanceTo(1.0)
    assert clock.indices == list(range(100))


def test_several_outputs_cut_the_sample():
    clock = Clock()
    simulator = Simulator(clock)
    simulator.AdvanceTo(0.055)
    assert_allclose(clock.GetOutputPort("more").Eval(simulator.get_context()), [0.05**2, 5.0])


def test_outputs_have_no_feedthrough():
    assert not Clock().HasAnyDirectFeedthrough()


@pytest.mark.parametrize(("rate", "step"), [(500.0, 0.002), (1000.0, 0.001), (3.0, 1.0 / 3.0)])
def test_rate_up_to_one_per_step_is_allowed(rate, step):
    check_rate(rate, step, "imu.rate")


@pytest.mark.parametrize("rate", [501.0, 0.0, -1.0, math.nan, math.inf])
def test_impossible_rate_is_refused(rate):
    assert_refused(lambda: check_rate(rate, 0.002, "imu.rate"), UserError, "imu.rate", f"{rate:g}")
