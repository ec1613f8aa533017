"""The free sail as a weather vane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.workbench.aero.plants import add_plant
from workbench.aero.coefficient_files import load_coefficients
from workbench.aero.laws import NormalForceLaw, TwoSidedLaw
from workbench.aero.sail import FreeSail
from workbench.aero.wind import WindModel, add_wind
from workbench.errors import ModelError

WIND = 6.0
VANE = {"length": 0.4, "width": 0.2, "centre_of_pressure": 0.03, "mass": 0.05, "inertia": 5e-4}


def vane(sail: FreeSail, angle: float, time_step: float = 0.0):
    """The sail on a mast in a wind that blows along -x."""
    builder = DiagramBuilder()
    plant = add_plant(builder, time_step)
    _, joint = sail.add_to_plant(plant, plant.world_body())
    plant.Finalize()
    sail.add_to_builder(builder, plant, wind=add_wind(builder, WindModel(mean=(-WIND, 0.0, 0.0))))
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    joint.set_angle(context, angle)
    return simulator, plant, joint


def swing(sail: FreeSail, angle: float, duration: float, time_step: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and angles, s and rad."""
    simulator, plant, joint = vane(sail, angle, time_step)
    times, angles = [], []
    for i in range(int(duration / 2e-3)):
        simulator.AdvanceTo(i * 2e-3)
        times.append(simulator.get_context().get_time())
        angles.append(joint.get_angle(plant.GetMyContextFromRoot(simulator.get_context())))
    return np.array(times), np.array(angles)


@pytest.mark.parametrize("time_step", [0.0, 2e-3])
def test_behind_the_axis_the_sail_is_a_weather_vane(time_step) -> None:
    """It swings with the small-angle frequency to 2 % (damping lowers it by zeta^2/2 = 0.3 %) and settles."""
    sail = FreeSail(**VANE)
    times, angles = swing(sail, 0.1, 6.0, time_step)
    crossings = times[1:][(angles[:-1] < 0.0) & (angles[1:] >= 0.0)]
    measured = 2 * math.pi / np.mean(np.diff(crossings))
    assert measured == pytest.approx(sail.vane_frequency(WIND, 2.0), rel=0.02)
    damping = 0.5 * 1.225 * 0.08 * 2.0 * WIND * 0.03**2 / (2 * 5e-4)
    assert np.abs(angles[-200:]).max() < 2 * 0.1 * math.exp(-damping * 5.6)


def test_ahead_of_the_axis_it_turns_away_and_ends_downwind() -> None:
    """The first sail of the thesis: it leaves the wind and rests half a turn round, centre of pressure downwind."""
    sail = FreeSail(**{**VANE, "centre_of_pressure": -0.03, "bearing_damping": 2e-3})
    _, angles = swing(sail, 0.02, 10.0)
    assert np.abs(angles).max() > math.pi / 2
    assert abs(math.cos(angles[-1]) + 1.0) < 1e-2


def test_bearing_damping_slows_the_vane() -> None:
    loose, stiff = (swing(FreeSail(**{**VANE, "bearing_damping": b}), 0.2, 1.5)[1] for b in (0.0, 3e-3))
    assert np.abs(stiff[-100:]).max() < 0.2 * np.abs(loose[-100:]).max()


def test_a_half_cylinder_is_pushed_more_on_its_hollow_side() -> None:
    """Table 2.1: 2.30 against 1.20. The normal leaves the round side: wind along +n meets the hollow one."""
    law = load_coefficients("half_cylinder").law()
    arguments = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 0.02, 1.225)
    hollow, round_side = (law.section_force((0.0, v, 0.0), *arguments)[1] for v in (5.0, -5.0))
    assert hollow == pytest.approx(0.5 * 1.225 * 0.02 * 2.30 * 25.0)
    assert hollow / -round_side == pytest.approx(2.30 / 1.20)
    even = TwoSidedLaw(2.0, 2.0).line_force(
        (1.0, 2.0, 3.0), (0.3, 0.1, 0.0), *arguments[:2], (0.1, 0.2), (0.01, 0.02), 1.2
    )
    assert even == pytest.approx(
        NormalForceLaw(2.0).line_force((1.0, 2.0, 3.0), (0.3, 0.1, 0.0), *arguments[:2], (0.1, 0.2), (0.01, 0.02), 1.2)
    )


def test_bad_sails_are_refused() -> None:
    for change, message in (
        ({"mass": -1.0}, "mass"),
        ({"inertia": 0.0}, "inertia"),
        ({"centre_of_pressure": 0.3}, "one width"),
    ):
        with pytest.raises(ModelError, match=message):
            FreeSail(**{**VANE, **change})
