"""Directions of the conditions of `condition_runs`: which way the road falls, and what law and
driver see of the roll, and of an IMU that fails.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from aerodima.optimisation.swerve.suite import NAMED_CANDIDATES
from aerodima.workbench.control.driver_law import DriverView
from aerodima.workbench.control.feedback_law import ROLL
from aerodima.workbench.control.manoeuvre import DriverInput
from aerodima.workbench.control.tail_law import NO_COMMAND, Observation
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import IMU
from tests.optimisation.swing.condition_runs import (
    ACTS,
    BANK,
    CONDITIONS,
    Asked,
    BentDriver,
    BentLaw,
    StoppedSchedule,
    banked,
    drive,
)
from tests.optimisation.swing.condition_training import CARS as TRAINED
from tests.optimisation.swing.condition_training import HEAVIER, WORST, heavier, worth_of

SWERVE = load_scenario("swerve", ["controller.law=feedback", "tail.mode=swing"])
FAULT_TIME = SWERVE.manoeuvre.turn_start + 0.2


class Repeats:
    """A law and a driver in one that returns what it sees."""

    sources = ()
    rate = 100.0
    memory_size = 1

    def start(self):
        return np.zeros(1)

    def step(self, memory, seen):
        return memory, seen, seen, 0


def test_a_road_that_falls_to_the_outside_of_a_left_turn_pulls_and_seems_to_roll_to_the_right():
    plant = MultibodyPlant(0.001)
    banked(lambda plant, friction: None, BANK)(plant, 1.0)
    pull = plant.gravity_field().gravity_vector()
    assert math.atan2(pull[1], -pull[2]) == pytest.approx(-math.radians(3.0))
    outside = CONDITIONS["bank of 3 degrees to the outside"]
    assert outside.bank == outside.roll_zero == BANK > 0.0
    assert CONDITIONS["bank of 3 degrees to the inside"].bank == -BANK


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("zero error of roll of 2 degrees", 0.1 + math.radians(2.0), 0.3 + math.radians(2.0)),
        ("IMU frozen", 0.1, 0.1),
        ("IMU invalid", 0.1, math.nan),
    ],
)
def test_law_and_driver_see_the_same_wrong_roll(name, before, after):
    law = BentLaw(SWERVE, CONDITIONS[name])
    law._law = Repeats()
    driver = BentDriver(Repeats(), SWERVE, CONDITIONS[name])
    found = []
    for time, roll in ((FAULT_TIME - 0.1, 0.1), (FAULT_TIME + 0.1, 0.3)):
        imu = np.zeros(IMU.size)
        imu[ROLL] = roll
        _, seen, _, _ = law.step(law.start(), Observation(time, 0, 0, 0, 0, True, imu=tuple(imu)))
        _, view, _, _ = driver.step(driver.start(), DriverView(time, roll=roll, roll_rate=0.0))
        assert seen.imu_valid == math.isfinite(view.roll)
        found.append(view.roll)
        if seen.imu_valid:
            assert seen.imu[ROLL] == pytest.approx(view.roll)
    assert found == pytest.approx([before, after], nan_ok=True)


def test_broken_motors_get_no_command_from_the_fault_on():
    for name, limp in (("both motors limp", (0, 1)), ("roll motor limp, pitch held", (1,))):
        law = BentLaw(SWERVE, CONDITIONS[name])
        for time in (FAULT_TIME - 0.1, FAULT_TIME + 0.1):
            seen = Observation(time, 0.0, 0.0, 0.0, 0.0, True, imu=(0.0,) * IMU.size)
            _, *commands, _ = law.step(law.start(), seen)
            silent = [n for n, one in enumerate(commands) if np.array_equal(one, NO_COMMAND)]
            assert silent == (list(limp) if time > FAULT_TIME else [])


def test_once_the_drive_acts_wheels_and_throttle_are_free_and_the_motors_that_are_left_hold():
    schedule = StoppedSchedule(SimpleNamespace(at=lambda time: DriverInput(0.3, 0.5, 0.0)), 1.0)
    assert schedule.at(0.9) == (0.3, 0.5, 0.0)
    assert schedule.at(1.0) == (0.0, 0.0, 0.0)
    held = [0.0, SWERVE.controller.hold_kp, SWERVE.controller.hold_kd, 0.0]
    law = BentLaw(SWERVE, CONDITIONS["IMU frozen, and the drive acts"])
    limp = BentLaw(SWERVE, CONDITIONS["roll motor limp, and the drive acts"])
    for one in (law, limp):
        for time, angle in ((FAULT_TIME - 0.1, -0.9), (FAULT_TIME + ACTS, -0.5)):
            seen = Observation(time, 0.0, 0.4, angle, 0.0, True, imu=(0.0,) * IMU.size)
            _, pitch, roll, _ = one.step(one.start(), seen)
        assert pitch.tolist() == [-0.9, *held], "the pitch before the fault"
        assert roll.tolist() == ([0.0, *held] if one is law else NO_COMMAND.tolist())


@pytest.mark.slow
def test_bank_contact_and_a_driver_that_stops_reach_the_run():
    """A name that the product no longer uses would leave a car as modelled."""
    asked = Asked("feedback-careful-control", 1.0, ("simulation.step=0.002",))
    names = (
        "as modelled, IMU 24 ms late",
        "bank of 3 degrees to the inside",
        "contact approximation SAP",
        "IMU frozen, and the drive acts",
        "noise of the IMU x 4",
    )
    metres = [drive(("car025", CONDITIONS[name], asked))[2] for name in names]
    assert len(set(metres)) == len(names)
    assert metres[1] > metres[0] > metres[3]


def test_a_run_that_tips_is_worth_nothing_and_a_heavier_car_keeps_the_factors_of_its_condition():
    runs = np.array([[1.0, 0.3, 1.5], [0.0, 0.3, math.nan]])
    assert worth_of(runs).tolist() == [1.0, 0.0]
    loaded = heavier(CONDITIONS["10 % more mass, centre of mass 5 % higher"])
    assert loaded.factors["car.mass"] == pytest.approx(1.1 * HEAVIER["car.mass"])
    assert heavier(CONDITIONS[WORST[0]]).factors == HEAVIER
    names = {one.name for one in load_ensemble("physical").split(1).training}
    assert names.issuperset(TRAINED)


@pytest.mark.parametrize(
    ("careful", "trained", "number"),
    [
        ("feedback-careful-control", "feedback-rollover-control", "rollover_control.start"),
        ("careful-control", "rollover-control", "rollover_control.acceleration"),
    ],
)
def test_a_careful_control_differs_from_the_trained_one_in_one_number(careful, trained, number):
    found, base = (
        dict(one.split("=") for one in NAMED_CANDIDATES[name].settings)
        for name in (careful, trained)
    )
    assert float(found.pop(number)) < float(base.pop(number))
    assert found == base
