"""A run that begins rolling goes on as the one whose state it takes, and a car that tips over first has none."""

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.law_of_scenario import find_swing
from aerodima.workbench.controllers.swing_tracker_law import SwingTracker
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


def test_swings_that_wait_alike_share_a_start_bit_for_bit():
    scenario = turn("swing")
    swing = find_swing("thesis_8_rad_per_s")
    later = swing.model_copy(update={"trigger": swing.trigger.model_copy(update={"threshold_rad_per_s": 1.1})})
    one, other = (SwingTracker.from_scenario(file, scenario) for file in (swing, later))
    start = rolling_start(scenario, one)
    assert start is not None
    rest, rolling = (simulate(scenario, record="outcome", law=other, start=begin) for begin in (None, start))
    np.testing.assert_array_equal(rolling.table.to_numpy(), rest.table.to_numpy())


def test_swing_released_on_the_straight_or_waiting_elsewhere_has_its_own_start():
    scenario = turn("swing")
    swing = find_swing("thesis_8_rad_per_s")
    start = rolling_start(scenario, SwingTracker.from_scenario(swing, scenario))
    early = {"trigger": swing.trigger.model_copy(update={"threshold_rad_per_s": 0.5 * start.yaw_rate})}
    firm = {"gains": swing.gains.model_copy(update={"hold": swing.gains.hold.model_copy(update={"kp": 30.0})})}
    for change in (early, firm):
        law = SwingTracker.from_scenario(swing.model_copy(update=change), scenario)
        with pytest.raises(UserError, match=r"differ in car\.tyre_friction and what the tail does after its release"):
            simulate(scenario, record="outcome", law=law, start=start)


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
    with pytest.raises(UserError, match=r"differ in car\.tyre_friction and"):
        simulate(turn("none", "car.com_height=0.1"), record="outcome", start=start)
    with pytest.raises(UserError, match="record='outcome'"):
        simulate(turn("none"), start=start)
