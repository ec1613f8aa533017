"""The Teensy's count of milliseconds on the computer's clock."""

import random

import pytest

from aerodima.hardware.devices.teensy_link import ClockAlignment


def test_delays_are_taken_out_up_to_the_shortest_one():
    generator = random.Random(1)
    clock = ClockAlignment()
    errors = []
    for i in range(2000):
        sent = 50.0 + 0.01 * i
        estimate = clock.add(1000 + 10 * i, sent + 0.0005 + generator.expovariate(1 / 0.004))
        errors.append(estimate - sent)
    # the shortest delay, 0.5 ms, stays; the rest is found within a few messages
    assert max(errors[100:]) < 0.0015
    assert min(errors) >= 0.0005 - 1e-9


def test_drift_is_followed():
    clock = ClockAlignment()
    for i in range(5000):
        sent = 0.01 * i
        estimate = clock.add(round(10 * i * (1 + 1e-4)), sent + 0.001)
    assert estimate == pytest.approx(sent + 0.001, abs=0.0015)


def test_counter_that_wraps_goes_on():
    clock = ClockAlignment()
    first = clock.add(2**32 - 10, 5.0)
    second = clock.add(10, 5.02)
    assert second - first == pytest.approx(0.02)


def test_restart_begins_anew():
    clock = ClockAlignment()
    clock.add(500_000, 5.0)
    assert clock.add(100, 9.0) == pytest.approx(9.0)
