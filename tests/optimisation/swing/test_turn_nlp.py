"""Steering and tail as one programme: its slopes, that it climbs to a turn within all limits, and
its swing file.
"""

import math

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from typer.testing import CliRunner

from aerodima.optimisation import make_turn_nlp, turn_programme
from aerodima.optimisation.studies.limit_search import LimitSearch
from aerodima.optimisation.studies.rollover_threshold import FRICTION
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swing.motion_search import (
    SCENARIO_CAR,
    MotionSearch,
    search_motion,
    steered_swing,
    steering_of,
    swing_of,
)
from aerodima.optimisation.swing.task import Task, TaskSurface
from aerodima.optimisation.swing.turn_nlp import FEASIBILITY_TOL
from aerodima.optimisation.swing.turn_shooting import TurnVariables
from aerodima.workbench import load_scenario
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.reduced.turns import drive_turns
from aerodima.workbench.car.turn_course import turn_course
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.control.swing_player import SwingPlayer
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.scenario.swing_file import read_swing, swing_at, write_swing
from tests.certain_cars import HIGH_BODY
from tests.optimisation.screening_gate import screened_friction
from tests.refusals import assert_named, assert_refused
from tests.workbench.car.reduced.test_turns import plans_of

FEW = MotionSearch(starts=1, knots=6, length=0.6, iterations=5)
TURN = load_scenario("turn_designed", (*HIGH_BODY, "car.tyre_friction=1.1"))
TASK = Task(scenario="turn_designed", training=0, floors=[1.3])


def variables(**changes):
    data = {
        "members": 2,
        "rates": 4,
        "interval": 0.12,
        "start": -1.5,
        "max_roll": 1.5,
        "max_rate": 20.0,
    }
    return TurnVariables(**{**data, "steering": (0.04, 0.5), **changes})


def start_of(programme):
    return programme.shooting.random_start(np.random.default_rng([1, 0]))


@pytest.fixture(scope="module")
def programme():
    turns = [
        load_scenario("turn_designed", (f"car.tyre_friction={friction}",))
        for friction in (1.1, 0.9)
    ]
    with pytest.warns(DeprecationWarning, match="make_turn_nlp"):
        return turn_programme(turns, FEW)


@pytest.fixture(scope="module")
def start(programme):
    return start_of(programme)


def test_the_knots_are_the_integral_of_the_rates():
    chosen = variables()
    x = chosen.random_start(np.random.default_rng(3))
    time, roll, rate = chosen.motion(x[chosen.own(1)])
    fine = np.linspace(time[1], time[-1], 2001)
    travelled = np.trapezoid(np.interp(fine, time, rate), fine)
    assert roll[-1] - roll[0] == pytest.approx(travelled, abs=1e-5)
    assert roll[0] == roll[1] == -1.5
    rows = chosen.roll_rows @ (x * chosen.units)[1 : chosen.tail]
    assert roll[2:] - roll[0] == pytest.approx(rows[: chosen.rates + 1])


def test_a_car_shares_the_tail_and_has_its_own_steering():
    chosen = variables()
    x = np.arange(float(chosen.size))
    first, second = (x[chosen.own(member)] for member in (0, 1))
    assert np.array_equal(first[: chosen.tail], second[: chosen.tail])
    assert not set(first[chosen.tail :]) & set(second[chosen.tail :])
    rounded = chosen.on_ticks(np.full(chosen.size, 0.7123))
    assert chosen.steered(rounded[chosen.own(1)])[2] == pytest.approx(0.14)


def test_slopes_are_those_of_differences(programme, start):
    """Of all costs and rows as the solver sees them; another car's steering changes nothing."""
    prog = programme.prog
    h = 1e-6
    turn = np.random.default_rng(2).normal(size=start.size)
    bindings = [*prog.GetAllCosts(), *prog.generic_constraints()]
    assert len(bindings) == 3
    for binding in bindings:
        ahead, here, behind = (
            np.atleast_1d(prog.EvalBinding(binding, x))
            for x in (start + h * turn, start, start - h * turn)
        )
        slopes = (
            ExtractGradient(np.atleast_1d(binding.evaluator().Eval(InitializeAutoDiff(start))))
            @ turn
        )
        assert slopes == pytest.approx((ahead - behind) / (2 * h), rel=1e-5, abs=1e-6)
        assert np.all(np.isfinite(here))
    tail = programme.shooting.variables.tail
    found = programme.at(start)
    assert not found.course_slopes[0, tail + 3 :].any()
    assert found.course_slopes[0, tail : tail + 3].any()


def test_a_few_iterations_turn_the_car_further_within_its_limits(tmp_path):
    """What the programme says is what the reduced car does with the file that is written."""
    alone = make_turn_nlp([TURN], FEW)
    start = start_of(alone)
    start[alone.shooting.variables.tail :][:2] *= 0.8  # less steering: within the limits
    assert alone.prog.CheckSatisfied(alone.prog.GetAllConstraints(), start, FEASIBILITY_TOL)
    solution = alone.solve(start, 4)
    assert solution.violation <= FEASIBILITY_TOL
    assert solution.course[0] > alone.at(start).course[0] + math.radians(3.0)
    floor = TaskSurface(SCENARIO_CAR, 4.5, 1.3, 1.1 / 1.3)
    path = write_swing(
        swing_of("found", TASK, [(floor, TURN)], alone, [solution], FEW), tmp_path / "found.yaml"
    )
    swing = read_swing(path)
    steering = steering_of(alone.shooting, solution.x, 0)
    assert f"manoeuvre.first_hold={steering['first_hold']!r}" in swing.provenance.settings
    driven = TURN.varied(manoeuvre={**steering, "turn_hold": TASK.pulse})
    plans = plans_of(driven, swing)
    again = drive_turns(alone.shooting.cars, plans, duration=1.3, length=alone.shooting.length)
    assert again.course[0] == pytest.approx(solution.course[0], abs=1e-4)
    assert abs(swing_at(swing, 5.0).roll_velocity) == 0.0


def test_a_constraint_of_the_user_is_kept():
    """A tail that may swing at 4 rad/s only; without it the programme swings faster."""
    rates = slice(1, 1 + FEW.knots - 2)
    free = make_turn_nlp([TURN], FEW)
    slow = make_turn_nlp([TURN], FEW)
    start = start_of(free)
    unit = slow.shooting.variables.units[1]
    slow.prog.AddBoundingBoxConstraint(-4.0 / unit, 4.0 / unit, slow.x[rates])
    fastest = [np.max(np.abs(unit * one.solve(start, 4).x[rates])) for one in (free, slow)]
    assert fastest[0] > 5.0
    assert fastest[1] <= 4.0 + 1e-6


def test_a_constraint_that_is_not_kept_is_named():
    late = make_turn_nlp([TURN], FEW)
    unit = late.shooting.variables.units[0]
    (_, high) = late.shooting.variables.bounds
    added = late.prog.AddBoundingBoxConstraint(high[0] + 0.5, high[0] + 1.0, late.x[0])
    added.evaluator().set_description("release in time")
    solution = late.solve(start_of(late), 1)
    assert solution.x[0] * unit <= 0.5 + 1e-6
    assert solution.violation >= 0.5 - 1e-3
    assert "release in time" in solution.worst


def test_pulse_and_limits_are_those_of_the_task():
    long = make_turn_nlp(
        [TURN], FEW, Task(scenario="turn_designed", pulse=1.0, most_roll=0.2, most_sideslip=0.3)
    )
    shooting = long.shooting
    assert shooting.plans.pulse.hold == pytest.approx([1.0])
    _, first, time = shooting.variables.steered(
        shooting.variables.bounds[1][shooting.variables.own(0)]
    )
    assert first <= TURN.servo.limit
    assert time == pytest.approx(0.99)
    rows = {row.name: row for row in shooting.rows}
    assert "roll from 1.7 s on" in rows
    assert "roll from 1.8 s on" not in rows
    assert rows["roll from 0.0 s on"].upper == pytest.approx(0.15)
    assert rows["sideslip at the exit"].upper == 0.3
    torque = rows["torque asked for from 0.0 s on"]
    assert -torque.lower == torque.upper
    # A motor that is asked for less than it has still follows its knots.
    assert 0.8 < torque.upper / TURN.tail_motor.torque_limit < 1.0


def test_a_turn_that_breaks_a_limit_has_not_converged_whatever_the_solver_says(
    programme, start, monkeypatch
):
    beyond = start.copy()
    beyond[1 : programme.shooting.variables.tail] = programme.shooting.variables.bounds[1][1]
    monkeypatch.setattr(programme, "_solve", lambda x, _: (beyond, True))
    broken = programme.solve(start, 1)
    assert broken.violation > FEASIBILITY_TOL
    assert not broken.converged


def test_the_tail_travels_within_its_limits_from_where_it_waits():
    """From -1.5 rad it may go 3 rad to the right, and not at all to the left."""
    prog = make_turn_nlp([TURN], FEW).prog
    (travel,) = prog.linear_constraints()
    row = travel.evaluator()
    limit = TURN.tail.roll_limit
    start = -TURN.controller.hold_angle
    assert row.upper_bound() == pytest.approx(np.full(row.num_constraints(), limit - start))
    assert row.lower_bound() == pytest.approx(np.full(row.num_constraints(), -limit - start))


@pytest.mark.parametrize("direction", ["left", "right"])
def test_a_swing_of_a_turn_to_the_right_is_the_mirror_image(direction):
    turn = load_scenario("turn_designed", (f"manoeuvre.direction={direction}",))
    time = np.linspace(0.0, 0.6, 4)
    roll = np.array([-1.5, -0.5, 0.5, 1.0])
    rate = np.array([0.0, 3.0, 3.0, 0.0])
    swing = steered_swing("made", turn, time, roll, rate, provenance={"source": ""})
    side = 1.0 if direction == "left" else -1.0
    assert swing.direction == direction
    knots = swing.knots
    assert np.array(knots.roll_position_rad) == pytest.approx(side * roll, abs=1e-8)
    assert np.array(knots.roll_velocity_rad_per_s) == pytest.approx(side * rate, abs=1e-8)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: MotionSearch(knots=3), ("knots", "3")),
        (lambda: MotionSearch(length=3.0), ("length", "3")),
        (lambda: MotionSearch(starts=0), ("starts", "0")),
        (lambda: make_turn_nlp([load_scenario("turn_none")], FEW), ("tail.mode", "none")),
    ],
)
def test_impossible_searches_are_refused(make, named):
    assert_refused(make, SwingError, *named)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--set", "floors=[9]"], ("floor", "9")),
        (["--set", "training=9999"], ("training", "9999")),
    ],
)
def test_the_command_refuses_before_it_drives(tmp_path, flags, named):
    words = ["swing", "search", "short_turn", "--out", str(tmp_path), *flags]
    result = CliRunner().invoke(build_app(), words)
    told = result.output + str(result.exception)
    assert_named(told, named)
    assert not list(tmp_path.glob("*.yaml"))


@pytest.mark.slow
def test_a_swing_is_found_from_the_floor_on():
    """Whole way: floor from the full car, programme, and the full car drives what was found as
    far.
    """
    swing = search_motion(
        "whole", TASK, MotionSearch(1, knots=6, length=0.6, iterations=6), CachedRunner()
    )
    found = swing.provenance.found
    settings = swing.provenance.settings
    search = LimitSearch(FRICTION, 0.4, 1.2, 0.1, 0.0125)
    (critical,) = screened_friction([load_scenario("turn_designed")], search)
    assert found["car_4.5_1.3_friction"] == pytest.approx(1.3 * critical.survived, rel=0.06)
    turn = load_scenario("turn_designed", (*settings, "tail.mode=swing"))
    run = simulate(
        turn, record="outcome", law=SwingPlayer.from_scenario(swing, turn), stop_when_certain=True
    )
    assert turn_course(run).course_change_rad == pytest.approx(
        found["car_4.5_1.3_course_rad"], rel=0.1
    )
