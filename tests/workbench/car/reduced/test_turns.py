"""Turns of reduced cars: the law that swings their tails, and what the full car of the same
scenario survives.
"""

import numpy as np
import pytest

from aerodima.optimisation.studies.limit_search import LimitSearch
from aerodima.optimisation.studies.rollover_threshold import FRICTION
from aerodima.workbench import Observation, UserError, load_scenario, metrics_of, simulate
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.rollout import STEP
from aerodima.workbench.car.reduced.states import STATES
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import TurnRollout, drive_turns
from aerodima.workbench.car.turn_course import turn_course
from aerodima.workbench.control.manoeuvre import make_schedule, pulse_angle, wheel_angle
from aerodima.workbench.control.swing_law import SwingSettings
from aerodima.workbench.control.swing_machine import SwingLaw
from tests.certain_cars import HIGH_BODY
from tests.optimisation.screening_gate import screened_friction
from tests.refusals import assert_refused


@pytest.mark.parametrize(
    "changes", [(), ("controller.delay=0.03",), ("controller.travel=3.1",), ("tail.mode=held",)]
)
def test_the_law_commands_what_the_one_on_the_car_does(changes):
    """Over a made-up path of yaw rate and tail: released, swung over the top, or given up where the
    tail is stopped.
    """
    scenario = load_scenario("turn_designed", changes)
    own = SwingLaw(SwingSettings.from_scenario(scenario))
    cars = VehicleParams.from_scenarios([scenario])
    state = np.zeros((len(STATES), 1))
    batch = TurnRollout(cars, TurnPlans.from_scenarios([scenario]), state, STEP)
    memory = own.start()
    seen = 0.0
    for tick in range(200):
        time = 0.01 * tick
        yaw_rate = 3.0 * max(0.0, time - 0.2)
        angle = min(-1.57 + 7.0 * max(0.0, time - 0.6), 1.45)
        state[STATES.index("tail_roll")] = angle
        state[STATES.index("w_z")] = yaw_rate
        batch.tick(time)
        memory, pitch, roll, _ = own.step(memory, Observation(time, seen, angle, 0.0, 1.0, True))
        seen = yaw_rate  # of the IMU, one tick late
        assert batch._tail[:, :, 0] == pytest.approx(np.array([pitch[:4], roll[:4]])), time


def test_critical_friction_is_that_of_the_full_car():
    """Figures of a full car, 4.5 m/s, on the same grid."""
    full = {"none": 0.5375, "held": 0.4875, "swing": 0.8875}
    scenarios = [load_scenario("turn_designed", (*HIGH_BODY, f"tail.mode={mode}")) for mode in full]
    found = screened_friction(scenarios, LimitSearch(FRICTION, 0.4, 1.0, 0.1, 0.0125))
    assert all(scenario.simulation.step == STEP for scenario in scenarios)
    assert found == pytest.approx(list(full.values()), rel=0.05)


@pytest.mark.slow
def test_course_of_a_turn_is_that_of_the_full_car():
    """The reduced car in one go, and from the end of its straight on, against a log of the full
    one, both at 2 ms.
    """
    settings = (
        "manoeuvre.steer_angle=0.06",
        f"{FRICTION}=0.9",
        "tail.mode=held",
        "manoeuvre.duration=3.0",
    )
    scenario = load_scenario("turn_designed", settings)
    full = turn_course(simulate(scenario, record="outcome"))
    cars = VehicleParams.from_scenarios([scenario])
    plans = TurnPlans.from_scenarios([scenario])
    whole = drive_turns(cars, plans, duration=0.7, history=True)
    again = drive_turns(cars, plans, duration=0.7, begun=whole.history[999])
    assert np.degrees(whole.course[0]) == pytest.approx(np.degrees(full.course_change_rad), abs=1.0)
    assert whole.exit_time[0] == pytest.approx(full.exit_time_s, abs=0.03)
    assert whole.sideslip[0] == pytest.approx(full.exit_sideslip_rad, abs=0.02)
    for name in ("course", "exit_time", "sideslip", "peak_roll", "lowest_tail", "heading"):
        assert getattr(again, name)[0] == pytest.approx(getattr(whole, name)[0], abs=1e-9), name


@pytest.mark.slow
def test_heading_is_that_of_the_full_car_once_it_has_settled():
    """The designed tail, held to the outside, turns the car back by another 2 degrees until the end
    of the run.
    """
    scenario = load_scenario("turn_designed", ("car.tyre_friction=0.5",))
    full = np.degrees(metrics_of(simulate(scenario, record="outcome")).heading_change_rad)
    turns = drive_turns(
        VehicleParams.from_scenarios([scenario]), TurnPlans.from_scenarios([scenario]), history=True
    )
    yaw = np.degrees(turns.history[:, STATES.index("yaw"), 0])
    assert np.degrees(turns.heading[0]) == pytest.approx(full, abs=0.5)
    assert yaw[-1] - yaw[999] < full - 1.0


def of_cars(name, *settings):
    return VehicleParams.from_scenarios([load_scenario(name, settings)])


def of_plans(name, *settings):
    return TurnPlans.from_scenarios([load_scenario(name), load_scenario(name, settings)])


@pytest.mark.parametrize(
    ("make", "words", "named"),
    [
        (of_cars, ("turn_swing_free_sail",), ("tail.sail", "free")),
        (of_cars, ("turn_none", "manoeuvre.direction=right"), ("direction left",)),
        (of_cars, ("turn_none", "wind.speed=3"), ("wind",)),
        (of_cars, ("turn_swing", "tail.added_mass=0.01"), ("tail.added_mass", "0.01")),
        (of_cars, ("entry_turn",), ("rolling_start",)),
        (of_cars, ("entry_twice",), ("turns",)),
        (of_plans, ("turn_none", "manoeuvre.kind=slalom"), ("manoeuvre.kind", "slalom", "turn")),
        (of_plans, ("turn_none", "manoeuvre.turn_start=3"), ("manoeuvre.turn_start", "2", "3")),
        (
            of_plans,
            ("turn_swing", "controller.swing_file=thesis_8_rad_per_s"),
            ("swing_file", "thesis_8_rad_per_s"),
        ),
        (
            of_plans,
            ("turn_designed", "controller.trigger=lateral_acceleration"),
            ("controller.trigger", "lateral_acceleration"),
        ),
    ],
)
def test_what_it_does_not_know_is_refused(make, words, named):
    assert_refused(lambda: make(*words), UserError, *named)


@pytest.mark.slow
def test_two_levels_take_the_car_where_the_full_car_goes():
    levels = ("manoeuvre.steer_angle=0.05", "manoeuvre.first_angle=0.08")
    levels += ("manoeuvre.first_hold=0.15", "manoeuvre.duration=3.2")
    scenario = load_scenario("turn_designed", (*levels, "tail.mode=none", "car.tyre_friction=0.6"))
    plans = TurnPlans.from_scenarios([scenario])
    reduced = drive_turns(VehicleParams.from_scenarios([scenario]), plans, duration=1.2)
    run = simulate(scenario, record="outcome")
    full = turn_course(run)
    assert reduced.course[0] == pytest.approx(
        full.course_change_rad, rel=0.04
    )  # runs differ by 2 %
    assert reduced.exit_time[0] == pytest.approx(full.exit_time_s, abs=0.02)
    assert reduced.peak_roll[0] == pytest.approx(metrics_of(run).peak_roll_rad, abs=0.02)


def test_the_wheels_follow_two_levels_at_the_rate_of_the_servo():
    words = (
        "manoeuvre.steer_angle=0.1",
        "manoeuvre.first_angle=0.4",
        "manoeuvre.first_hold=0.2",
        "servo.rate=2.0",
    )
    schedule = make_schedule(load_scenario("turn_none", words))
    times = (-0.1, 0.1, 0.2, 0.25, 0.4, 0.52, 0.6)
    angles = [0, 0.2, 0.4, 0.3, 0.1, 0.06, 0]
    assert [wheel_angle(schedule, 2.0, time) for time in times] == pytest.approx(angles)
    assert wheel_angle(schedule, 2.0, np.array(times)) == pytest.approx(angles)
    assert list(pulse_angle(schedule, np.array([-0.01, 0.0, 0.2, 0.5]))) == [0.0, 0.4, 0.1, 0.0]
