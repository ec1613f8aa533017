"""A run that begins rolling goes on as the one whose state it takes, and a car that tips over first has none."""

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.simulate.car_run import ROLLED, rolling_start
from aerodima.workbench.simulate.simulation import simulate

SHORT = ["manoeuvre.speed_ramp=0.8", "manoeuvre.turn_start=1.2", "manoeuvre.duration=3.0"]


def turn(mode, *settings):
    return load_scenario(f"turn_{mode}", [*SHORT, "manoeuvre.speed=2.5", *settings])


@pytest.mark.parametrize("settings", [("none",), ("swing", "tail.sail=free", "wind.turbulence=0.3")])
def test_run_from_its_own_rolling_start_is_the_run_from_rest_bit_for_bit(settings):
    scenario = turn(*settings)
    start = rolling_start(scenario)
    rest, rolling = simulate(scenario, record="outcome"), simulate(scenario, record="outcome", start=start)
    np.testing.assert_array_equal(rolling.table.to_numpy(), rest.table.to_numpy())
    assert rolling.extra == rest.extra | {ROLLED: scenario.car.tyre_friction}


def test_run_at_another_friction_turns_as_the_run_from_rest():
    start = rolling_start(turn("swing"))
    scenario = turn("swing", "car.tyre_friction=0.6")
    rest, rolling = (metrics_of(simulate(scenario, record="outcome", start=begin)) for begin in (None, start))
    assert rolling.peak_roll_rad == pytest.approx(rest.peak_roll_rad, rel=0.01)
    assert rolling.heading_change_rad == pytest.approx(rest.heading_change_rad, rel=0.01)


def test_car_that_is_not_calm_at_its_turn_has_no_rolling_start():
    assert rolling_start(load_scenario("turn_swing", ["manoeuvre.speed=5.5"])) is None
    assert rolling_start(load_scenario("straight")) is None


def test_anything_but_the_friction_changed_is_refused():
    start = rolling_start(turn("none"))
    with pytest.raises(UserError, match=r"differ in car\.tyre_friction alone"):
        simulate(turn("none", "car.com_height=0.1"), record="outcome", start=start)
    with pytest.raises(UserError, match="record='outcome'"):
        simulate(turn("none"), start=start)
