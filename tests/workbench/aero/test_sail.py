"""The sail on its bearing: it faces the wind broadside like a vane, or turns away with its bearing
too far back.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.aero.sail import FreeSail
from aerodima.workbench.aero.section_laws import (
    NormalForceLaw,
    TwoSidedLaw,
    dot,
    facing_law,
)
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.aero.wind import WindModel, add_wind
from tests.workbench.aero.plants import add_plant
from tests.workbench.aero.vanes import Vane, add_air, add_vane

WIND, RHO = 6.0, 1.225
SAIL = {"length": 0.4, "width": 0.1, "centre_of_pressure": 0.025, "board_width": 0.05}
VANE = Vane(FreeSail(**SAIL), mass=0.05, inertia=5e-3)
"""Heavy about its bearing, so that it swings: zeta is 0.1."""
LIGHT = replace(VANE, inertia=1e-4, damping=1e-3)


def in_wind(vane, angle, time_step=0.0):
    """The sail on a mast in a wind that blows along -y, into its hollow side at angle 0."""
    builder = DiagramBuilder()
    plant = add_plant(builder, time_step)
    _, joint = add_vane(plant, vane)
    plant.Finalize()
    systems = add_air(
        builder, plant, vane.sail, wind=add_wind(builder, WindModel(mean=(0.0, -WIND, 0.0)))
    )
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    joint.set_angle(context, angle)
    return simulator, plant, joint, systems


def swing(vane, angle, duration, time_step=0.0):
    """Times and angles, s and rad."""
    simulator, plant, joint, _ = in_wind(vane, angle, time_step)
    times = []
    angles = []
    for time in np.arange(0.0, duration, 5e-3):
        simulator.AdvanceTo(time)
        times.append(simulator.get_context().get_time())
        angles.append(joint.get_angle(plant.GetMyContextFromRoot(simulator.get_context())))
    return np.array(times), np.array(angles)


def side_moment_by_hand():
    """S and S2 of `SAIL`: shell 0.05 m deep at 0.025 m, board 0.05 m at 0.025 + 0.025 + 0.025 m
    behind the bearing.
    """
    return 0.4 * (0.05 * 0.025 + 0.05 * 0.075), 0.4 * (0.05 * 0.025**2 + 0.05 * 0.075**2)


@pytest.mark.parametrize("time_step", [0.0, 2e-3])
def test_it_swings_and_settles_as_theory_says(time_step):
    """Frequency to 2 % and decay per period to 10 % of the linear vane; 2 ms steps add damping of
    their own.
    """
    first, second = side_moment_by_hand()
    omega = math.sqrt(0.5 * RHO * 2.0 * WIND**2 * first / 5e-3)
    zeta = 0.5 * RHO * 2.0 * WIND * second / (2 * 5e-3 * omega)
    assert VANE.frequency(WIND) == pytest.approx(omega)
    assert VANE.damping_ratio(WIND) == pytest.approx(zeta)
    times, angles = swing(VANE, 0.05, 4.0, time_step)
    crossings = times[1:][(angles[:-1] < 0.0) & (angles[1:] >= 0.0)]
    period = np.mean(np.diff(crossings))
    assert 2 * math.pi / period == pytest.approx(omega * math.sqrt(1 - zeta**2), rel=0.02)
    first_peak, second_peak = (
        np.abs(angles[(times > i * period) & (times <= (i + 1) * period)]).max() for i in (1, 2)
    )
    assert math.log(first_peak / second_peak) == pytest.approx(zeta * omega * period, rel=0.1)


def test_bearing_damping_slows_the_vane():
    loose, stiff = (swing(replace(VANE, damping=damping), 0.2, 1.5)[1] for damping in (0.0, 3e-2))
    assert np.abs(stiff[-40:]).max() < 0.2 * np.abs(loose[-40:]).max()


AXIS, NORMAL = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


def section_force(law, v, area=0.02, n=NORMAL):
    return np.array(law.section_force(tuple(v), AXIS, n, area, RHO))


def test_facing_drag_points_where_the_air_goes_and_leaves_the_spanwise_part_out():
    law = facing_law(NormalForceLaw(2.0))
    v = np.array([3.0, -4.0, 12.0])
    expected = 0.5 * RHO * 0.02 * 2.0 * 5.0 * np.array([3.0, -4.0, 0.0])
    assert_allclose(section_force(law, v), expected)
    turned = (math.sin(0.7), math.cos(0.7), 0.0)
    assert_allclose(section_force(law, v, n=turned), expected)  # the normal does not matter
    locked = section_force(NormalForceLaw(2.0), v)
    assert_allclose(locked, expected * [0.0, 1.0, 0.0])  # the part of it along the normal


def test_a_facing_half_cylinder_shows_its_hollow_side():
    law = facing_law(TwoSidedLaw(2.3, 1.2))
    for v in ((0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (5.0, 0.0, 0.0)):
        assert np.linalg.norm(section_force(law, v)) == pytest.approx(0.5 * RHO * 0.02 * 2.3 * 25.0)


@pytest.mark.parametrize("direction", [0.0, 0.4, -2.0, 3.0])
def test_wind_direction_is_the_angle_to_which_a_free_sail_turns(direction):
    """`TailForce.wind_direction` on a sail welded at angle 0 is where the free one comes to rest in
    the same wind.
    """
    wind = WindModel(mean=(WIND * math.sin(direction), -WIND * math.cos(direction), 1.0))
    builder = DiagramBuilder()
    plant = add_plant(builder, 0.0)
    body, joint = add_vane(plant, LIGHT)
    fixed, _ = add_vane(plant, VANE, name="fixed")
    plant.Finalize()
    port = add_wind(builder, wind)
    add_air(builder, plant, LIGHT.sail, body, wind=port)
    welded = add_tail_force(
        builder, plant, fixed, LIGHT.sail.shell_layout, 0.0, wind=port
    )  # no force: it stays at 0
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(4.0)
    context = simulator.get_context()
    angle = joint.get_angle(plant.GetMyContextFromRoot(context))
    told = welded.GetOutputPort("wind_direction").Eval(welded.GetMyContextFromRoot(context))[0]
    assert told == pytest.approx(direction)
    assert math.remainder(angle - told, 2 * math.pi) == pytest.approx(0.0, abs=1e-3)


def test_crossed_plates_add_up():
    sail = FreeSail(**SAIL, side_coefficient=1.4)
    v = (3.0, -4.0, 1.0)
    force = section_force(sail.shell_law, v, n=(0.0, -1.0, 0.0))
    half = 0.5 * RHO * 0.02 * 5.0
    assert_allclose(force, half * np.array([0.5 * 1.4 * 3.0, 2.0 * -4.0, 0.0]))
    assert dot(force, v) > 0.0
