"""The force sensor as a system: the same numbers as a log made at once, and a rate that fits the
step.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator

from aerodima.workbench.rig.rig_sensors import RigSensor, force_errors
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.workbench.samples import sampled

SETTINGS = load_rig_scenario("static").force_sensor
OFFSETS = (-0.064, -0.019, 15.695, -0.011, -0.538, 0.013)
WRENCH = np.array([1.0, -2.0, 16.0, 0.3, -0.4, 0.05])


def sensor_readings(wrench, count, settings):
    return force_errors(settings, OFFSETS, 4).first_readings(wrench, count, settings.rate)


def test_system_and_whole_log_give_the_same_readings():
    """The system's are seen half a period after each sample."""
    errors = force_errors(SETTINGS, OFFSETS, 4)
    sensor = RigSensor("force_sensor", SETTINGS.rate, errors)
    simulator = Simulator(sensor)
    sensor.GetInputPort("value").FixValue(simulator.get_mutable_context(), WRENCH)
    shown = sampled(simulator, (np.arange(150) + 0.5) / SETTINGS.rate, "reading")
    assert_allclose(shown, sensor_readings(WRENCH, 150, SETTINGS), atol=1e-12)


def test_errors_of_a_seed_scale_with_the_accuracy():
    doubled = SETTINGS.model_copy(update={"fx_accuracy": 2 * SETTINGS.fx_accuracy})
    one, two = (force_errors(settings, OFFSETS, 9) for settings in (SETTINGS, doubled))
    for name in ("bias", "drift", "noise"):
        assert getattr(two, name)[0] == pytest.approx(2 * getattr(one, name)[0])
        assert_array_equal(getattr(two, name)[1:], getattr(one, name)[1:])


def test_readings_end_at_the_range_of_the_sensor():
    limits = np.array(SETTINGS.ranges)
    readings = sensor_readings(np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]) * 2e4, 3, SETTINGS)
    assert_array_equal(readings, np.tile(limits * [1, -1, 1, -1, 1, -1], (3, 1)))
