import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator

from aerodima.workbench.car.car_sensors import SailEncoder, quantise_symmetric
from tests.workbench.samples import sampled


def sail_encoder(bits=12, rate=500.0, delay=0.0, noise=0.0, **arguments):
    return SailEncoder(SimpleNamespace(bits=bits, rate=rate, delay=delay, noise=noise), **arguments)


def reading(angle, bits=12):
    encoder = sail_encoder(bits)
    simulator = Simulator(encoder)
    encoder.GetInputPort("joint_angle").FixValue(simulator.get_mutable_context(), [angle])
    simulator.Initialize()
    return encoder.GetOutputPort("angle").Eval(simulator.get_context())[0]


def turning(rate_of_turn, until, **arguments):
    """Angle and rate shown at `until` by an encoder whose shaft turns steadily, moved every 2
    ms.
    """
    encoder = sail_encoder(**arguments)
    simulator = Simulator(encoder)
    context = simulator.get_mutable_context()
    port = encoder.GetInputPort("joint_angle")
    port.FixValue(context, [0.0])
    simulator.Initialize()
    for k in range(round(until / 0.002)):
        port.FixValue(context, [rate_of_turn * 0.002 * k])
        simulator.AdvanceTo(0.002 * k + 0.001)
    return [encoder.GetOutputPort(name).Eval(context)[0] for name in ("angle", "rate")]


@pytest.mark.parametrize("bits", [10, 12])
def test_angle_is_the_lower_edge_of_one_of_2_to_the_n_steps(bits):
    step = 2 * math.pi / 2**bits
    for angle in np.linspace(0.0, 6.28, 50):
        count = reading(angle, bits) / step
        assert count == pytest.approx(round(count), abs=1e-9)
        assert 0.0 <= angle - reading(angle, bits) <= step
    assert reading(2.5 * step, bits) == pytest.approx(2 * step)


@pytest.mark.parametrize(
    ("angle", "expected"), [(-math.pi / 2, 1.5 * math.pi), (7.0, 7.0 - 2 * math.pi), (-1e-20, 0.0)]
)
def test_angle_is_absolute_within_one_turn(angle, expected):
    shown = reading(angle)
    assert 0.0 <= shown < 2 * math.pi
    assert math.remainder(shown - expected, 2 * math.pi) == pytest.approx(
        0.0, abs=2 * math.pi / 4095
    )


@pytest.mark.parametrize("rate_of_turn", [12.0, -12.0, 0.4])
def test_rate_from_differences_also_across_the_wrap(rate_of_turn):
    """One step of 12 bit over the window of 20 ms is 0.077 rad/s."""
    for until in (0.3, 0.53, 0.8):
        assert turning(rate_of_turn, until)[1] == pytest.approx(rate_of_turn, abs=0.08)


def test_rate_is_zero_until_the_window_is_filled():
    assert turning(12.0, 0.01)[1] == 0.0


def noisy_readings(seed, noise=0.01):
    """Angles and rates of a 20 bit encoder at a shaft at rest, a sample apart."""
    encoder = sail_encoder(bits=20, noise=noise, seed=seed)
    simulator = Simulator(encoder)
    encoder.GetInputPort("joint_angle").FixValue(simulator.get_mutable_context(), [1.0])
    simulator.Initialize()
    return sampled(simulator, 0.002 * np.arange(400) + 0.001, "angle", "rate").T


def test_noise_has_its_standard_deviation_and_belongs_to_the_seed():
    angle, rate = noisy_readings(seed=3)
    assert np.mean(angle) == pytest.approx(1.0, abs=0.002)
    assert np.std(angle) == pytest.approx(0.01, rel=0.15)
    assert_array_equal(noisy_readings(seed=3)[0], angle)
    assert np.any(noisy_readings(seed=4)[0] != angle)
    assert np.ptp(noisy_readings(seed=3, noise=0.0)[0]) == 0.0
    assert_allclose(rate[10:], (angle[10:] - angle[:-10]) / 0.02, atol=1e-9)  # of the shown angles


def test_motor_reply_is_rounded_to_the_nearest_of_2_to_the_n_minus_1_steps():
    position_step = 25.0 / 65535
    values = np.linspace(-12.0, 12.0, 101)
    shown = np.array([quantise_symmetric(value, 12.5, 16) for value in values])
    assert np.max(np.abs(shown - values)) <= position_step / 2 * (1 + 1e-9)
    counts = (shown + 12.5) / position_step
    assert_allclose(counts, np.round(counts), atol=1e-6)


def test_motor_reply_saturates_at_its_ranges():
    for side in (1.0, -1.0):
        assert quantise_symmetric(side * 80.0, 50.0, 12) == pytest.approx(side * 50.0)
