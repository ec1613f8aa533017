from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.systems.analysis import Simulator

from aerodima.workbench.car.car_sensors import GpsSpeed
from tests.workbench.car.body_motion import motion_vector
from tests.workbench.samples import sampled


def chassis_motion_at(velocity):
    still = np.zeros(3)
    return motion_vector(
        RigidTransform(),
        SpatialVelocity([9.0, 9.0, 9.0], velocity),
        SpatialAcceleration(still, still),
        0.002,
    )


def receiver(velocity, noise=0.0, delay=0.0, seed=1):
    gps = GpsSpeed(SimpleNamespace(rate=10.0, delay=delay, noise=noise), seed=seed)
    simulator = Simulator(gps)
    gps.get_input_port().FixValue(simulator.get_mutable_context(), chassis_motion_at(velocity))
    simulator.Initialize()
    return gps, simulator


def readings(count, **arguments):
    _, simulator = receiver(**arguments)
    return sampled(simulator, 0.1 * np.arange(count) + 0.05, "speed")[:, 0]


def test_speed_is_horizontal_and_has_no_sign():
    assert readings(1, velocity=[-3.0, 4.0, 12.0])[0] == pytest.approx(5.0)


def test_standing_car_never_shows_a_negative_speed():
    """Half of the noise falls below zero and is cut off there."""
    shown = readings(400, velocity=[0.0, 0.0, 0.0], noise=0.1)
    assert shown.min() == 0.0
    assert np.mean(shown == 0.0) == pytest.approx(0.5, abs=0.13)


def test_noise_has_the_asked_deviation():
    """1000 readings: known to 2.2 %; 12 % is five standard errors."""
    shown = readings(1000, velocity=[4.0, 0.0, 0.0], noise=0.05)
    assert shown.std() == pytest.approx(0.05, rel=0.12)
    assert shown.mean() == pytest.approx(4.0, abs=0.01)


def test_change_of_speed_shows_after_the_delay():
    gps, simulator = receiver([1.0, 0.0, 0.0], delay=0.13)
    simulator.AdvanceTo(0.95)
    gps.get_input_port().FixValue(
        simulator.get_mutable_context(), chassis_motion_at([2.0, 0.0, 0.0])
    )
    assert sampled(simulator, (1.1299, 1.1301), "speed").tolist() == [[1.0], [2.0]]
