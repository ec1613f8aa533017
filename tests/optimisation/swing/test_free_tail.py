"""Free numbers of the tail: their slopes, the tail that is found, and numbers that are refused."""

import numpy as np
import pytest

from aerodima.optimisation import AIMS, BoundEffort, FreeTail, find_bound
from aerodima.optimisation.swing.solution import solution_swing
from aerodima.optimisation.swing.swerve_nlp import FEASIBILITY_TOL
from aerodima.optimisation.swing.swerve_shooting import KNOTS, SwerveShooting
from aerodima.workbench.core.errors import ScenarioError, SwingError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

FEW = BoundEffort(members=24, generations=1, starts=1, iterations=4)
MOTION = np.concatenate([[-1.05], np.linspace(0.0, 0.8, len(KNOTS) - 1)])
STEERING = np.array([0.06, 0.04, 0.02, 0.2, 0.4])
SETTINGS = ["tail.mode=swing", "manoeuvre.speed=6"]
RANGES = {"length": (0.7, 1.3), "width": (0.8, 1.6)}


def resized(car, length, width):
    """Returns a car whose tail is so many times as long and wide, its mass in proportion."""
    tail = car.tail
    return car.varied(
        tail={
            "length": length * tail.length,
            "mass": length * tail.mass,
            "sail_width": width * tail.sail_width,
        }
    )


@pytest.fixture(scope="module")
def cars():
    return [load_scenario("swerve", [*SETTINGS, f"car.mass={mass}"]) for mass in (4.5, 5.0)]


def test_slopes_of_a_number_are_differences_of_cars_with_other_tails(cars):
    """Aims and limits of both cars, against cars whose tail is fixed a little longer or wider."""
    aim = AIMS["aside-0.5"]
    shooting = SwerveShooting.from_scenarios(cars, aim, free=FreeTail(RANGES, resized))
    numbers = np.array([1.1, 1.3])
    x = np.concatenate([MOTION, numbers, STEERING, STEERING]) / shooting.variables.units
    evaluation = shooting.at(x)
    for place in range(2):
        step = 1e-5 * np.eye(2)[place]
        values = []
        for own in (numbers + step, numbers - step):
            fixed = SwerveShooting.from_scenarios([resized(car, *own) for car in cars], aim)
            here = np.concatenate([MOTION, STEERING, STEERING]) / fixed.variables.units
            values.append(fixed.at(here))
        ahead, behind = values
        index = len(KNOTS) + place
        unit = shooting.variables.units[index]
        assert unit == pytest.approx((0.3, 0.4)[place], rel=3e-3)
        for slopes, name in (("aim_slopes", "aims"), ("row_slopes", "rows")):
            expected = unit * (getattr(ahead, name) - getattr(behind, name)) / 2e-5
            found = getattr(evaluation, slopes)[..., index]
            assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)
        assert (np.abs(evaluation.aim_slopes[:, index]) > 1e-3).all()


def test_the_tail_that_is_found_reaches_the_value_and_a_charge_makes_it_small(cars):
    """A bound of a fixed tail with the numbers that are found drives the same swerve."""
    aim = AIMS["aside-0.5"]
    free = FreeTail(RANGES, resized)
    bound = find_bound(cars[:1], aim, effort=FEW, free=free)
    row = bound.table.iloc[0]
    built = resized(cars[0], row["length"], row["width"])
    assert bound.scenarios[0].tail == built.tail
    assert bound.solution.violation <= FEASIBILITY_TOL
    fixed = SwerveShooting.from_scenarios([built], aim)
    x = bound.solution.x
    alone = np.delete(x, [len(KNOTS), len(KNOTS) + 1])
    assert fixed.at(alone).aims == pytest.approx(bound.solution.aims, abs=1e-9)
    swing = solution_swing("found", SETTINGS, bound, aim.name)
    assert load_scenario("swerve", swing.provenance.settings).tail == built.tail
    assert swing.car["tail.length"] == pytest.approx(row["length"] * cars[0].tail.length)
    assert len(swing.knots.roll_position_rad) == len(KNOTS)

    def charge(program):
        program.prog.AddLinearCost(10.0 * program.numbers["length"])

    small = find_bound(cars[:1], aim, effort=FEW, free=free, extend=charge)
    assert small.table["length"][0] == pytest.approx(0.7, abs=1e-3)
    assert row["length"] > 0.75


def test_ranges_and_tails_that_there_cannot_be_are_refused(cars):
    for ends in ((1.0, 1.0), (1.2, 0.8), (0.5, np.nan), (0.5, np.inf)):
        free = FreeTail({"length": ends}, lambda car, length: resized(car, length, 1.0))
        assert_refused(
            lambda free=free: find_bound(cars, free=free), SwingError, "free number length", "to"
        )
    far = FreeTail({"length": (0.5, 20.0)}, lambda car, length: resized(car, length, 1.0))
    assert_refused(lambda: find_bound(cars, free=far), ScenarioError, "tail.length")


def test_a_mixed_corner_that_there_cannot_be_is_refused(cars):
    """Each number alone, and both at their ends, make a tail; a short one with a long sail does
    not.
    """
    length = cars[0].tail.length
    free = FreeTail(
        {"length": (0.6 * length, length), "sail_length": (0.1 * length, 0.9 * length)},
        lambda car, length, sail: car.varied(tail={"length": length, "sail_length": sail}),
    )
    assert_refused(lambda: find_bound(cars, free=free), ScenarioError, "sail_length")


def test_a_sail_may_be_as_long_as_its_tail(cars):
    """Differences and tolerance of the solver stay inside a range whose end is a limit."""
    tail = cars[0].tail
    free = FreeTail(
        {"sail_length": (0.5 * tail.sail_length, tail.length)},
        lambda car, sail: car.varied(tail={"sail_length": sail}),
    )

    def reward(program):
        program.prog.AddLinearCost(-20.0 * program.numbers["sail_length"])

    bound = find_bound(cars[:1], effort=FEW, free=free, extend=reward)
    assert bound.table["sail_length"][0] == pytest.approx(tail.length, rel=0.01)
    assert bound.table["sail_length"][0] <= tail.length


@pytest.mark.parametrize(
    "change", [{"tail": {"roll_limit": 1.6}}, {"tail_motor": {"torque_limit": 5.0}}]
)
def test_only_numbers_of_the_tail_are_free(cars, change):
    free = FreeTail({"length": (0.5, 1.0)}, lambda car, _: car.varied(**change))
    assert_refused(lambda: find_bound(cars, free=free), SwingError, "FreeTail.build", "roll_limit")


def test_a_free_tail_may_wait_at_a_side(cars):
    """Two cars, announced: slopes by waiting roll, both numbers and a trim, each of its own row."""
    shooting = SwerveShooting.from_scenarios(
        cars, AIMS["aside-0.5"], announced=True, free=FreeTail(RANGES, resized)
    )
    drivers = [*STEERING, -0.002, *STEERING, -0.004]
    x = np.concatenate([MOTION[:1], [-0.3], MOTION[1:], [1.1, 1.3], drivers])
    x = x / shooting.variables.units
    evaluation = shooting.at(x)
    assert evaluation.row_slopes.shape[-1] == 11 + 2 + 2 * 6
    step = 1e-5
    for index in (1, 11, 12, 18):
        direction = step * np.eye(x.size)[index]
        ahead, behind = (shooting.at(x + sign * direction) for sign in (1.0, -1.0))
        expected = (ahead.aims - behind.aims) / (2.0 * step)
        assert evaluation.aim_slopes[:, index] == pytest.approx(expected, rel=1e-3, abs=1e-4)
    assert (np.abs(evaluation.aim_slopes[:, 11:13]) > 1e-4).all()
    assert list(np.abs(evaluation.aim_slopes[:, 18]) > 1e-4) == [True, False]
