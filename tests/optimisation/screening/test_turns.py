"""Turns of reduced cars: the law that swings their tails, and what the full car of the same scenario survives."""

import numpy as np
import pytest

from aerodima.optimisation.screening.grip_screening import screened_friction
from aerodima.optimisation.screening.turns import BatchLaw, TurnPlans, drive_turns
from aerodima.optimisation.screening.vehicle_motion import STATES
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Search
from aerodima.workbench import Observation, UserError, load_scenario, simulate
from aerodima.workbench.controllers.swing_law import SwingLaw, SwingSettings
from aerodima.workbench.metrics.turn_course import turn_course


@pytest.mark.parametrize("changes", [(), ("controller.delay=0.03",), ("controller.travel=3.1",), ("tail.mode=held",)])
def test_the_law_commands_what_the_one_on_the_car_does(changes: tuple[str, ...]) -> None:
    """Over a made-up path of yaw rate and tail: released, swung over the top, or given up where the tail is stopped."""
    scenario = load_scenario("turn_designed", changes)
    own = SwingLaw(SwingSettings.from_scenario(scenario))
    batch = BatchLaw(TurnPlans.of([scenario]), Vehicles.of([scenario]))
    memory, seen = own.start(), 0.0
    for tick in range(200):
        time = 0.01 * tick
        yaw_rate, angle = 3.0 * max(0.0, time - 0.2), min(-1.57 + 7.0 * max(0.0, time - 0.6), 1.45)
        state = np.zeros((len(STATES), 1))
        state[STATES.index("tail_roll")], state[STATES.index("w_z")] = angle, yaw_rate
        batch.tick(time, state)
        memory, pitch, roll, _ = own.step(memory, Observation(time, seen, angle, 0.0, 1.0, True))
        seen = yaw_rate  # of the IMU, one tick late
        assert batch.commands()[:, :, 0] == pytest.approx(np.array([pitch[:4], roll[:4]])), time


def test_critical_friction_is_that_of_the_full_car() -> None:
    """Figures of the full car, 4.5 m/s, on the same grid: optimisation/swing/README.md."""
    full = {"none": 0.525, "held": 0.4875, "swing": 0.85}
    scenarios = [load_scenario("turn_designed", (f"tail.mode={mode}",)) for mode in full]
    found = screened_friction(scenarios, Search(FRICTION, 0.4, 1.0, 0.1, 0.0125))
    assert [each.survived for each in found] == pytest.approx(list(full.values()), rel=0.05)  # screening/README.md


def test_course_of_a_turn_is_that_of_the_full_car() -> None:
    """The reduced car in one go, and from the end of its straight on, against a log of the full one, both at 2 ms."""
    settings = ("manoeuvre.steer_angle=0.06", f"{FRICTION}=0.9", "tail.mode=held", "manoeuvre.duration=3.0")
    scenario = load_scenario("turn_designed", settings)
    full = turn_course(simulate(scenario, record="outcome"))
    cars, plans = Vehicles.of([scenario]), TurnPlans.of([scenario])
    whole = drive_turns(cars, plans, duration=0.7, history=True)
    assert whole.history is not None
    again = drive_turns(cars, plans, duration=0.7, begun=whole.history[999])
    assert full.course_change_rad is not None
    assert full.exit_time_s is not None
    assert full.exit_sideslip_rad is not None
    assert np.degrees(whole.course[0]) == pytest.approx(np.degrees(full.course_change_rad), abs=1.0)
    assert whole.exit_time[0] == pytest.approx(full.exit_time_s, abs=0.03)
    assert whole.sideslip[0] == pytest.approx(full.exit_sideslip_rad, abs=0.02)
    for name in ("course", "exit_time", "sideslip", "peak_roll", "lowest_tail", "heading"):
        assert getattr(again, name)[0] == pytest.approx(getattr(whole, name)[0], abs=1e-9), name


def test_what_it_does_not_know_is_refused() -> None:
    with pytest.raises(UserError, match="facing, locked"):
        Vehicles.of([load_scenario("turn_swing_free_sail")])
    with pytest.raises(UserError, match="direction left"):
        Vehicles.of([load_scenario("turn_none", ("manoeuvre.direction=right",))])
    with pytest.raises(UserError, match=r"first_hold: 0\.2 s"):
        TurnPlans.of([load_scenario("turn_none", ("manoeuvre.first_hold=0.2",))])
    with pytest.raises(UserError, match="turn_start, s: 2 and 3"):
        TurnPlans.of([load_scenario("turn_none", (f"manoeuvre.turn_start={start}",)) for start in (2.0, 3.0)])
    with pytest.raises(UserError, match="trigger: steering"):
        TurnPlans.of([load_scenario("turn_designed", ("controller.trigger=steering",))])
    played = load_scenario("turn_designed").controller.model_copy(update={"swing_file": "my_swing"})
    with pytest.raises(UserError, match="swing_file: my_swing"):
        TurnPlans.of([load_scenario("turn_designed").model_copy(update={"controller": played})])
