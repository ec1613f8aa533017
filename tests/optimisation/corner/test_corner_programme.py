"""Steering and tail as one programme: its slopes, that it climbs to a turn within all limits, and its swing file."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from aerodima.optimisation.corner.corner_programme import FEASIBLE, CornerProgramme
from aerodima.optimisation.corner.corner_search import (
    CarTurn,
    CornerOptions,
    find_turn,
    shooting_of,
    steering_of,
    swing_of,
)
from aerodima.optimisation.corner.turn_shooting import TurnShooting
from aerodima.optimisation.corner.turn_variables import TurnVariables
from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.sweep.study_engine import SerialRunEngine
from aerodima.workbench import load_scenario
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.swing_file import read_swing, swing_at, write_swing
from aerodima.workbench.errors import SwingError

FEW = CornerOptions(starts=1, knots=6, length=0.6, iterations=5, step=0.002)


def variables(**changes: Any) -> TurnVariables:
    data = {"members": 2, "rates": 4, "interval": 0.12, "start": -1.5, "most_roll": 1.5, "most_rate": 20.0}
    return TurnVariables(**{**data, "steering": (0.04, 0.5), **changes})


@pytest.fixture(scope="module")
def shooting() -> TurnShooting:
    turns = [load_scenario("turn_designed", (f"car.tyre_friction={friction}",)) for friction in (1.1, 0.9)]
    return shooting_of(turns, FEW)


@pytest.fixture(scope="module")
def start(shooting: TurnShooting) -> np.ndarray:
    return shooting.random_start(np.random.default_rng([1, 0]))


def test_the_knots_are_the_integral_of_the_rates() -> None:
    chosen = variables()
    x = chosen.random_start(np.random.default_rng(3))
    time, roll, rate = chosen.motion(x[chosen.own(1)])
    fine = np.linspace(time[1], time[-1], 2001)
    travelled = np.trapezoid(np.interp(fine, time, rate), fine)
    assert roll[-1] - roll[0] == pytest.approx(travelled, abs=1e-5)
    assert roll[0] == roll[1] == -1.5
    rows = chosen.roll_rows @ (x * chosen.units)[1 : chosen.tail]
    assert roll[2:] - roll[0] == pytest.approx(rows[: chosen.rates + 1])


def test_a_car_shares_the_tail_and_has_its_own_steering() -> None:
    chosen = variables()
    x = np.arange(float(chosen.size))
    first, second = (x[chosen.own(member)] for member in (0, 1))
    assert np.array_equal(first[: chosen.tail], second[: chosen.tail])
    assert not set(first[chosen.tail :]) & set(second[chosen.tail :])
    rounded = chosen.on_ticks(np.full(chosen.size, 0.7123))
    assert chosen.steered(rounded[chosen.own(1)]).first_hold == pytest.approx(0.14)


def test_slopes_are_those_of_differences(shooting: TurnShooting, start: np.ndarray) -> None:
    """Of course and rows of both cars along a random direction; another car's steering changes nothing."""
    programme = CornerProgramme(shooting)
    turn, h = np.random.default_rng(2).normal(size=start.size), 1e-6
    found = shooting.at(start)
    ahead, behind = ((programme.cost(x, at), programme.constraint(at)) for x, at in
                     ((x, shooting.at(x)) for x in (start + h * turn, start - h * turn)))  # fmt: skip
    expected = (ahead[0][0] - behind[0][0]) / (2 * h)
    assert programme.cost(start, found)[1] @ turn == pytest.approx(expected, rel=1e-6, abs=1e-7)
    differences = (ahead[1][0] - behind[1][0]) / (2 * h)
    assert programme.constraint(found)[1] @ turn == pytest.approx(differences, rel=1e-5, abs=1e-6)
    tail = shooting.variables.tail
    assert not found.course_slopes[0, tail + 3 :].any()
    assert found.course_slopes[0, tail : tail + 3].any()


def test_a_few_iterations_turn_the_car_further_within_its_limits(shooting: TurnShooting, tmp_path: Path) -> None:
    """What the programme says is what the reduced car does with the file that is written."""
    turn = load_scenario("turn_designed", ("car.tyre_friction=1.1",))
    alone = shooting_of([turn], FEW)
    programme = CornerProgramme(alone)
    start = alone.random_start(np.random.default_rng([1, 0]))
    before = alone.at(start).course[0]
    solution = programme.solve(start, FEW.iterations)
    assert solution.violation <= FEASIBLE
    assert solution.course[0] > before + math.radians(3.0)
    cars = [CarTurn("car", (), turn.varied(manoeuvre={"duration": 3.5}))]
    path = write_swing(swing_of("found", "turn_designed", cars, alone, [solution], FEW), tmp_path / "found.yaml")
    swing, steering = read_swing(path), steering_of(alone, solution.x, 0)
    assert f"manoeuvre.first_hold={steering['first_hold']!r}" in swing.provenance.settings
    driven = turn.varied(manoeuvre=steering)
    again = drive_turns(alone.cars, TurnPlans.of([driven], [swing]), duration=1.3, length=alone.length)
    assert again.course[0] == pytest.approx(solution.course[0], abs=1e-4)
    facts = swing.provenance.found
    assert facts["car_full_car_course_rad"] == pytest.approx(solution.course[0], rel=0.1)
    assert abs(swing_at(swing, 5.0).roll_velocity) == 0.0


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("floor: 9", {"floor": 9.0}),
        ("knots: 3", {"knots": 3}),
        ("length: 3", {"length": 3.0}),
        ("starts: 0", {"starts": 0}),
    ],
)
def test_options_out_of_range_are_refused(words: str, change: dict[str, Any]) -> None:
    with pytest.raises(SwingError, match=words):
        CornerOptions(**change)


def test_cars_without_tail_are_refused() -> None:
    with pytest.raises(SwingError, match=r"tail\.mode: none"):
        shooting_of([load_scenario("turn_none")], FEW)


def test_the_command_refuses_before_it_drives(tmp_path: Path) -> None:
    out = tmp_path / "x.yaml"
    for flags, words in (
        (["--floor", "9"], "floor: 9"),
        (["--members", "9999"], "--members 9999"),
        (["--set", "tail.mode=none"], "tail.mode: none"),
    ):
        result = CliRunner().invoke(build_app(), ["optimise", "corner", "--out", str(out), *flags])
        assert words in result.output + str(result.exception), flags
        assert not out.exists()


@pytest.mark.slow
def test_a_swing_is_found_from_the_floor_on(tmp_path: Path) -> None:
    """Whole way: floor from the full car, programme, full car as the judge."""
    found = find_turn("whole", "turn_designed", [("car", ())], FEW, SerialRunEngine()).provenance.found
    assert found["car_friction"] == pytest.approx(1.3 * 0.85, rel=0.05)  # swing/README.md
    assert found["car_full_car_course_rad"] == pytest.approx(found["car_course_rad"], rel=0.1)
