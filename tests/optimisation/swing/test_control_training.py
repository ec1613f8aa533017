"""Training of the rollover control: what numbers are worth, reduced against full cars, and the
search itself on one car.
"""

from typing import get_args, get_type_hints

import numpy as np
import pytest

from aerodima.optimisation import LawSearch, train_law
from aerodima.optimisation.commands.swing_commands import train
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swerve.aims import AIMS
from aerodima.optimisation.swerve.candidate import NO_TAIL
from aerodima.optimisation.swerve.car_conditions import UNLIKE, Condition
from aerodima.optimisation.swerve.reduced_swerves import ReducedSwerve
from aerodima.optimisation.swerve.steering import constant_steering, steering_settings
from aerodima.optimisation.swerve.suite import FEEDBACK, ensemble_cases, select_candidates
from aerodima.optimisation.swing.control_training import (
    CONTROL_RANGES,
    CONTROL_START,
    ControlBatch,
    control_places,
    score_control_batch,
    train_rollover_control,
)
from aerodima.optimisation.swing.feedback_training import RANGES, law_settings
from aerodima.optimisation.swing.full_runs import FullRun, drive_full
from aerodima.optimisation.swing.swerve_study import TRAINABLE, TRAINING_AIMS
from aerodima.workbench.car.swerve import swerve_row
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

CASES = ensemble_cases("physical", "training", 1, "built", [1.2])
NONE = CONTROL_START | {"rollover_control.start": 0.25}
"""A control that comes too late for any car."""


def test_a_condition_changes_the_car_that_it_is_asked_of():
    heavy = Condition(delay=0.044, mass=1.1, com_height=1.05, friction=0.8, torque_error=-0.3)
    car = load_scenario("swerve", CASES[0].settings()).car
    changed = load_scenario("swerve", (*CASES[0].settings(), *heavy.settings(CASES[0])))
    assert changed.car.mass == pytest.approx(1.1 * car.mass, rel=1e-5)
    assert changed.car.com_height == pytest.approx(1.05 * car.com_height, rel=1e-5)
    assert changed.car.tyre_friction == pytest.approx(0.8 * car.tyre_friction, rel=1e-5)
    assert (changed.imu.delay, changed.tail_motor.torque_error) == (0.044, -0.3)


def test_numbers_are_worth_how_far_a_car_at_full_lock_goes_aside_if_it_stays_upright():
    (place,) = control_places(NO_TAIL, CASES, [6.0])
    assert len(place) == len(UNLIKE)
    batch = ControlBatch(place[:1], TRAINING_AIMS, (CONTROL_START, NONE))
    ((worth, tipped),) = score_control_batch(batch)
    ((soon, _),) = score_control_batch(batch._replace(aims=TRAINING_AIMS[:1]))
    scenario = load_scenario("swerve", (*place[0], *law_settings(CONTROL_START)))
    swerve = ReducedSwerve(scenario).drive(constant_steering(scenario.servo.limit, 1))
    shares = [float(AIMS[name](swerve)[0]) / AIMS[name].size for name in TRAINING_AIMS]
    assert worth == pytest.approx(np.mean(shares))
    assert soon == pytest.approx(shares[0])
    assert worth > 0.4
    assert tipped == 0.0


@pytest.mark.parametrize("base", [NO_TAIL, FEEDBACK], ids=lambda one: one.name)
def test_reduced_cars_swerve_as_full_ones_with_rollover_control(base):
    """Measured: 2 % after 0.5 s, 6 % after 1 s."""
    ((settings, *_),) = control_places(base, CASES, [6.0])
    settings = (*settings, *law_settings(CONTROL_START))
    scenario = load_scenario("swerve", settings)
    steering = constant_steering(scenario.servo.limit, 1)
    reduced = swerve_row(ReducedSwerve(scenario).drive(steering))
    full = drive_full(FullRun((*settings, *steering_settings(steering[:, 0])), "aside-0.5"))
    assert full["error"] == ""
    assert reduced["aside_soon_m"] == pytest.approx(full["aside_soon_m"], rel=0.03)
    assert reduced["aside_later_m"] == pytest.approx(full["aside_later_m"], rel=0.08)


@pytest.mark.parametrize("has_tail", [False, True])
def test_search_finds_a_control_that_a_file_of_candidates_brings_back(has_tail):
    search = LawSearch(laws=4, generations=2, rounds=1)
    found = train_rollover_control(has_tail, CASES, [6.0], TRAINING_AIMS, search, CachedRunner())
    keys = {setting.split("=")[0] for setting in found.settings}
    assert keys >= set(CONTROL_RANGES)
    assert (set(RANGES) <= keys) == has_tail


def test_a_trained_control_is_written_as_a_candidate(tmp_path):
    search = LawSearch(laws=4, generations=1, rounds=1)
    table = train_law(
        tmp_path, search, candidate="rollover-control", cars=1, speeds=[6.0], runs=CachedRunner()
    )
    assert set(CONTROL_RANGES) <= set(table["key"])
    _, candidate = select_candidates([str(tmp_path / "candidates.yaml")])
    assert candidate.settings[0] == "tail.mode=none"


def test_a_candidate_without_numbers_to_search_is_refused(tmp_path):
    assert_refused(
        lambda: train_law(tmp_path, candidate="rollover"), UserError, "rollover", "rollover-control"
    )


def test_a_training_for_an_unknown_aim_is_refused(tmp_path):
    assert_refused(
        lambda: train_law(tmp_path, aims=["aside-2"], cars=1), UserError, "aside-2", "aside-1.0"
    )


def test_the_command_takes_what_can_be_trained():
    assert get_args(get_type_hints(train)["candidate"]) == TRAINABLE
