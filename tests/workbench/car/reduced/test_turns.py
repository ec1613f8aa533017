"""Turns of reduced cars: the law that swings their tails, and what the full car of the same
scenario survives.
"""

import numpy as np
import pytest

from aerodima.optimisation.calibrate.calibration_plan import FRICTION
from aerodima.optimisation.studies.limit_search import LimitSearch
from aerodima.workbench import Observation, UserError, load_scenario, metrics_of, simulate
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.rollout import STEP, over_ground
from aerodima.workbench.car.reduced.states import STATES
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import TurnRollout, drive_turns
from aerodima.workbench.car.turn_course import ground_velocity
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
    found = screened_friction(scenarios, LimitSearch(0.4, 1.0, 0.1, 0.0125))
    assert all(scenario.simulation.step == STEP for scenario in scenarios)
    assert found == pytest.approx(list(full.values()), rel=0.05)


def courses(run, turns, after):
    """Change of course and sideslip of the full and of the reduced car, rad, so many seconds after
    the start of the steering at 2 s.
    """
    rows = np.searchsorted(run.time, [2.0 - 1e-6, 2.0 + after - 1e-6])
    states = turns.history[[999, -1], :, 0].T
    full = ground_velocity(run)[1][rows]
    reduced, _ = over_ground(states, run.number("car", "com_x"))
    headings = run.signal("yaw_truth_rad")[rows], states[STATES.index("yaw")]
    return [
        (course[1] - course[0], heading[1] - course[1])
        for course, heading in zip((full, reduced), headings, strict=True)
    ]


@pytest.mark.slow
def test_course_of_a_turn_is_that_of_the_full_car():
    """The reduced car in one go against a log of the full one, 0.7 s after the start of the
    steering; from the end of its straight on it ends where it does in one go.
    """
    settings = (
        "manoeuvre.steer_angle=0.06",
        f"{FRICTION}=0.9",
        "tail.mode=held",
        "manoeuvre.duration=3.0",
    )
    scenario = load_scenario("turn_designed", settings)
    cars = VehicleParams.from_scenarios([scenario])
    plans = TurnPlans.from_scenarios([scenario])
    whole = drive_turns(cars, plans, duration=0.7, history=True)
    again = drive_turns(cars, plans, duration=0.7, begun=whole.history[999])
    full, reduced = courses(simulate(scenario, record="outcome"), whole, 0.7)
    assert reduced[0] == pytest.approx(full[0], abs=np.radians(1.0))
    assert reduced[1] == pytest.approx(full[1], abs=0.02)
    assert again.last == pytest.approx(whole.last, abs=1e-9)
    assert again.heading == pytest.approx(whole.heading, abs=1e-9)


@pytest.mark.slow
def test_heading_is_that_of_the_full_car_once_it_has_settled():
    """The designed tail, held to the outside, turns the car back by another 2 degrees until the end
    of the run.
    """
    scenario = load_scenario("turn_designed", (*HIGH_BODY, "car.tyre_friction=0.5"))
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
    cars = VehicleParams.from_scenarios([scenario])
    reduced = drive_turns(cars, plans, duration=0.9, history=True)
    run = simulate(scenario, record="outcome")
    (full, _), (course, _) = courses(run, reduced, 0.9)
    assert course == pytest.approx(full, rel=0.04)  # runs differ by 2 %
    peak_roll = np.max(reduced.history[:, STATES.index("roll")])
    assert peak_roll == pytest.approx(metrics_of(run).peak_roll_rad, abs=0.02)
