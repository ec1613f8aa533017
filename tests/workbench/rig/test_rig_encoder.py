"""Counts of the rig's encoder."""

import math

import pytest
from pydrake.systems.analysis import Simulator

from aerodima.workbench.rig.rig_sensors import RigEncoder, quantise
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario

SCENARIO = load_rig_scenario("static")


def turning(rate, until):
    """Angle and rate shown at `until` (s) by an encoder whose shaft turns steadily from 0.3 rad."""
    encoder = RigEncoder(SCENARIO.encoder, SCENARIO.count_angle)
    simulator = Simulator(encoder)
    context = simulator.get_mutable_context()
    for k in range(round(until * 1000) + 1):
        encoder.GetInputPort("joint_angle").FixValue(context, [0.3 + rate * k * 0.001])
        simulator.AdvanceTo((k + 0.5) * 0.001)
    return tuple(float(encoder.GetOutputPort(name).Eval(context)[0]) for name in ("angle", "rate"))


def test_one_count_is_the_published_angle():
    """512 pulses x 4 x 26: 53248 counts per turn of the bar, 1.18e-4 rad (section 4.7, ERRATA
    E19).
    """
    assert SCENARIO.count_angle == pytest.approx(2 * math.pi / 53248, rel=1e-12)
    assert SCENARIO.count_angle == pytest.approx(1.18e-4, abs=1e-7)


def test_the_nearest_count_is_read_on_both_sides_of_zero():
    assert quantise(0.4e-4, 1.0e-4) == 0.0
    assert quantise(0.6e-4, 1.0e-4) == pytest.approx(1.0e-4)
    assert quantise(-0.6e-4, 1.0e-4) == pytest.approx(-1.0e-4)


def test_it_never_wraps():
    assert turning(100.0, 0.1)[0] == pytest.approx(10.3, abs=1e-4)
