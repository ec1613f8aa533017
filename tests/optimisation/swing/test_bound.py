"""The bound as a nonlinear program: its slopes, its limits, a user's aim, and its swing file."""

import numpy as np
import pytest

from aerodima.optimisation import AIMS, LIMITS, BoundEffort, find_bound
from aerodima.optimisation.swerve.aims import score
from aerodima.optimisation.swerve.reduced_swerves import ReducedSwerve
from aerodima.optimisation.swerve.steering import TRIMS, steering_settings
from aerodima.optimisation.swerve.suite import BOUND, ensemble_cases
from aerodima.optimisation.swing.full_runs import FullRun, full_swerve
from aerodima.optimisation.swing.solution import solution_swing
from aerodima.optimisation.swing.swerve_nlp import FEASIBILITY_TOL, SwerveNlp
from aerodima.optimisation.swing.swerve_shooting import (
    KNOTS,
    SwerveShooting,
    knot_rates,
    tail_at_knots,
    within_reach,
)
from aerodima.workbench.car.swerve import aside, energy, start_deviation
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import (
    hermite,
    read_swing,
    swing_from_dict,
    write_swing,
)
from tests.refusals import assert_refused

FEW = BoundEffort(members=24, generations=1, starts=1, iterations=4)
LYING = np.append(-1.05, np.zeros(len(KNOTS) - 1))
STILL = (LYING, np.array([0.06, 0.04, 0.02, 0.2, 0.4]))


@pytest.fixture(scope="module")
def settings():
    (case,) = ensemble_cases("physical", "test", 1, "built", [1.2])
    return (*case.settings(), *BOUND.settings, "manoeuvre.speed=6.0")


@pytest.fixture(scope="module")
def scenario(settings):
    return load_scenario("swerve", settings)


def test_a_curve_that_goes_beyond_its_range_between_knots_is_made_smaller():
    times = np.array(KNOTS)
    rolls = np.random.default_rng(3).normal(size=(2, len(KNOTS) - 1))
    rolls[1] *= 1e-3
    kept = within_reach(rolls, 0.5)
    assert kept[1] == pytest.approx(rolls[1])
    whole = np.append(0.0, kept[0])
    curve, _ = hermite(np.linspace(0.0, times[-1], 2000), times, whole, knot_rates() @ whole)
    assert np.max(np.abs(curve)) == pytest.approx(0.5, abs=0.005)
    assert np.corrcoef(kept[0], rolls[0])[0, 1] == pytest.approx(1.0)


def test_slopes_are_those_of_differences(scenario):
    """Of aim and limits by all variables, with another step than the program's own."""
    shooting = SwerveShooting.from_scenarios([scenario], AIMS["aside-0.5"])
    generator = np.random.default_rng(4)
    rolls = 0.1 * generator.standard_normal(len(KNOTS) - 1)
    x = np.concatenate([LYING[:1], rolls, STILL[1]]) / shooting.variables.units
    evaluation = shooting.at(x)
    direction = generator.standard_normal(x.size)
    step = 1e-6
    ahead, behind = (shooting.at(x + sign * step * direction) for sign in (1.0, -1.0))
    for slopes, values in (("aim_slopes", "aims"), ("row_slopes", "rows")):
        expected = (getattr(ahead, values) - getattr(behind, values)) / (2.0 * step)
        found = getattr(evaluation, slopes) @ direction
        assert found == pytest.approx(expected, rel=1e-4, abs=1e-4)
    assert (np.abs(evaluation.aim_slopes[0, -2:]) > 1e-3).all()  # by the times of the steering


def test_slopes_of_two_cars_that_know_of_the_turn_are_those_of_differences(scenario):
    """Each car has a trim of its own; both have one tail, which waits at one roll."""
    shooting = SwerveShooting.from_scenarios([scenario] * 2, AIMS["aside-0.5"], announced=True)
    generator = np.random.default_rng(4)
    rolls = 0.1 * generator.standard_normal(len(KNOTS))
    drivers = [*STILL[1], -0.002, *STILL[1], -0.004]
    x = np.concatenate([LYING[:1], rolls, drivers]) / shooting.variables.units
    evaluation = shooting.at(x)
    assert evaluation.row_slopes.shape[-1] == 11 + 2 * 6
    step = 1e-6
    for index in (1, 16, 22):  # waiting roll, trims
        direction = step * np.eye(x.size)[index]
        ahead, behind = (shooting.at(x + sign * direction) for sign in (1.0, -1.0))
        expected = (ahead.rows - behind.rows) / (2.0 * step)
        found = evaluation.row_slopes[:, :, index]
        assert found == pytest.approx(expected, rel=1e-4, abs=1e-4)
        moved = np.abs(found).max(axis=1) > 1e-3
        assert list(moved) == [index != 22, index != 16]


def test_the_bound_is_not_below_a_candidate_and_plays_what_it_claims(settings, scenario, tmp_path):
    """The reduced car reaches the value with the file that is written, and a tail that does not
    roll does not.
    """
    aim = AIMS["aside-0.5"]
    lines = []
    bound = find_bound([scenario], aim, effort=FEW, candidates=[STILL], progress=lines.append)
    assert [line.split("] ")[1][:3] for line in lines] == ["1/3", "2/3", "3/3"]
    assert all("s to go" in line for line in lines)
    solution = bound.solution
    assert solution.violation <= FEASIBILITY_TOL
    path = tmp_path / "found.yaml"
    write_swing(solution_swing("found", settings, bound, aim.name), path)
    played = load_scenario("swerve", (*settings, f"controller.swing_file={path}"))
    steering = bound.steering()[:, None]
    values = score(ReducedSwerve(played).drive(steering), aim)
    assert values == pytest.approx(solution.aims, abs=1e-6)
    shooting = bound.program.shooting
    start = np.concatenate(STILL) / shooting.variables.units
    assert solution.aims[0] > shooting.at(start).aims[0] + 0.01
    assert list(bound.table["wall_time_s"]) == [bound.wall_time]
    assert bound.wall_time > 0.0
    assert list(bound.table["level_1"]) == pytest.approx([steering[0, 0]])


def test_the_motion_of_a_candidate_is_one_that_the_program_can_play(settings, scenario):
    """The tail that goes to the inside and stays there, from its knots, to 5 mm."""
    file = (*settings, "controller.swing_file=inside_8_rad_per_s")
    steering = np.array([0.03, 0.02, 0.01, 0.2, 0.4])
    swerve = ReducedSwerve(load_scenario("swerve", file)).drive(steering[:, None])
    tail = tail_at_knots(swerve)
    assert tail[0] == pytest.approx(0.0, abs=0.02)
    assert tail[-1] == pytest.approx(-np.pi / 2, abs=0.05)
    shooting = SwerveShooting.from_scenarios([scenario], AIMS["aside-0.5"])
    x = np.concatenate([tail, steering]) / shooting.variables.units
    assert shooting.at(x).aims == pytest.approx(aside(swerve), abs=5e-3)


def test_a_tail_that_waits_at_a_side_needs_a_trim(settings, scenario, tmp_path):
    """At the left it drags the car to the left; the full car agrees with the reduced one."""
    shooting = SwerveShooting.from_scenarios([scenario], AIMS["aside-0.5"], announced=True)
    variables = shooting.variables
    trims = np.array([0.0, -0.008])
    point = np.concatenate([[0.0, -0.8], np.zeros(len(KNOTS) - 1), STILL[1]])
    columns = np.repeat(np.append(point, 0.0)[:, None], 2, axis=1)
    columns[-1] = trims
    swerve = shooting.drive(columns / variables.units[:, None], np.zeros(2, int))
    _, yaw_rate = start_deviation(swerve)
    assert swerve.time[0] == pytest.approx(-0.298)
    assert yaw_rate[0] > 1.0
    assert yaw_rate[1] < yaw_rate[0] - 1.0
    assert swerve.steering[0] == pytest.approx(trims)
    waiting = swing_from_dict(
        read_swing(model_path("swings/inside_8_rad_per_s.yaml"))
        .model_copy(update={"name": "waiting"})
        .model_dump(mode="json", by_alias=True, exclude_none=True)
        | {"knots": still_knots(-0.8)}
    )
    path = tmp_path / "waiting.yaml"
    write_swing(waiting, path)
    for trim, reduced in zip(trims, yaw_rate, strict=True):
        steering = steering_settings(np.append(STILL[1], trim))
        file = f"controller.swing_file={path}"
        full = full_swerve(FullRun((*settings, file, *steering), "aside-0.5"))
        assert start_deviation(full)[1] == pytest.approx(reduced, rel=0.1, abs=0.1)


def still_knots(roll):
    """Knots of a tail that stays at a roll, rad."""
    return {
        "time_s": [0.0, 1.0],
        "roll_position_rad": [roll] * 2,
        "roll_velocity_rad_per_s": [0.0] * 2,
        "pitch_position_rad": [0.0] * 2,
        "pitch_velocity_rad_per_s": [0.0] * 2,
    }


def test_an_announced_bound_is_straight_at_the_start_and_not_below_its_candidate(
    settings, scenario, tmp_path
):
    aim = AIMS["aside-0.5"]
    lines = []
    bound = find_bound(
        [scenario], aim, effort=FEW, candidates=[STILL], progress=lines.append, announced=True
    )
    assert lines[-1].split("] ")[1].startswith("6/6")
    shooting = bound.program.shooting
    start = np.concatenate([STILL[0][:1], [0.0], STILL[0][1:], STILL[1], [0.0]])
    start = start / shooting.variables.units
    assert bound.solution.aims[0] > shooting.at(start).aims[0] + 0.01
    steering = bound.steering()
    assert steering.shape == (6,)
    assert TRIMS[0] <= steering[-1] <= TRIMS[1]
    assert list(bound.table["trim_angle"]) == [steering[-1]]
    path = tmp_path / "found.yaml"
    swing = solution_swing("found", settings, bound, aim.name)
    assert swing.provenance.settings[-1] == f"manoeuvre.trim_angle={steering[-1]:.9g}"
    write_swing(swing, path)
    played = load_scenario("swerve", (*settings, f"controller.swing_file={path}"))
    swerve = ReducedSwerve(played).drive(steering[:, None])
    assert score(swerve, aim) == pytest.approx(bound.solution.aims, abs=1e-6)
    assert np.abs(start_deviation(swerve)).max() <= 0.51
    assert swerve.tail[0, 1, 0] == pytest.approx(swing.knots.roll_position_rad[0], abs=0.02)


def test_an_aim_and_limits_of_the_user_are_kept(scenario):
    """Metres aside less 0.02 m a joule, with a roll and a steering of the user's choice."""

    def aside_for_energy(swerve):
        return aside(swerve) - 0.02 * energy(swerve)

    limits = [LIMITS["energy"](1.5), LIMITS["roll"](0.2)]

    def steer_little(program: SwerveNlp) -> None:
        program.prog.AddBoundingBoxConstraint(0.0, 0.5, program.x[len(KNOTS)])

    bound = find_bound(
        [scenario], aside_for_energy, limits, FEW, candidates=[STILL], extend=steer_little
    )
    shooting = bound.program.shooting
    x = bound.solution.x
    assert x[len(KNOTS)] <= 0.5 + FEASIBILITY_TOL
    swerve = shooting.drive(x[:, None], np.zeros(1, int))
    assert energy(swerve)[0] <= 1.5 + FEASIBILITY_TOL
    assert np.abs(swerve.roll).max() <= 0.2 + 0.1 * FEASIBILITY_TOL
    assert bound.solution.aims == pytest.approx(aside_for_energy(swerve))


def test_a_car_without_tail_has_no_bound():
    assert_refused(lambda: find_bound([load_scenario("swerve")]), SwingError, "tail.mode", "none")
