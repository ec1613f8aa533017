"""Cars in the conditions of a real car: the table *What a real car adds* in docs/swerves.md.

`python -m tests.optimisation.swing.condition_runs` prints for each condition how many cars stay
upright, and how far they go aside after 0.5 s (median), with the feedback law and a share of the
angles of its best steering. A `--candidate` with a rollover control has a driver at full lock.
`--car` names other cars than the four of the page, `--set` other numbers.
"""

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from multiprocessing import Pool
from typing import Any
from unittest.mock import patch

import numpy as np
from pydrake.multibody.plant import DiscreteContactApproximation

from aerodima.optimisation.swerve.steering import constant_steering, steering_settings
from aerodima.optimisation.swerve.suite import NAMED_CANDIDATES
from aerodima.workbench import simulate
from aerodima.workbench.car import car_plant
from aerodima.workbench.car.swerve import LATER, aside, is_upright, swerve_of
from aerodima.workbench.control import driver_law
from aerodima.workbench.control.driver_law import DriverView, LimitedDriver
from aerodima.workbench.control.feedback_law import ROLL
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.manoeuvre import DriverInput, make_schedule
from aerodima.workbench.control.tail_law import NO_COMMAND
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from tests.hardware.emulator.swerve_runs import best_steering

CARS = ("car035", "car016", "car011", "car033")
"""Test cars of `physical.yaml`."""
CANDIDATES = (
    "feedback",
    "rollover-control",
    "feedback-rollover-control",
    "careful-control",
    "feedback-careful-control",
)
"""Candidates that the table has a column of."""
LATE = {"imu.delay": 0.024}
"""Delay of the IMU unless the condition has another, s."""
BREAKS = 0.2
"""Time of a fault, s after the start of the steering."""
ACTS = 0.1
"""Time that the drive takes to see a fault of the IMU, about the longest of these faults, s
(hardware/emulator/fault_table.csv)."""
BANK = math.radians(3.0)
"""Slope of a banked road, rad."""


@dataclass(frozen=True)
class Condition:
    """A condition of a real car.

    Attributes:
        settings: numbers in place of those of the car.
        factors: factors on numbers of the car.
        roll_zero: error of the IMU's roll, rad.
        bank: slope of the road, which falls to the outside of the turn, rad.
        breaks: which of the law's inputs or commands fails from the fault on; empty for none.
        acts: how long the drive takes to see the fault, s: it then straightens the wheels, takes
            the throttle away, and holds the pitch and the middle of the roll with the motors that
            are left.
        contact: Drake's approximation of the contact.
    """

    settings: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    roll_zero: float = 0.0
    bank: float = 0.0
    breaks: str = ""
    acts: float = math.inf
    contact: str = "kLagged"


CONDITIONS = {
    "as modelled, IMU 24 ms late": Condition(),
    "IMU 4 ms late": Condition({"imu.delay": 0.004}),
    "IMU 44 ms late": Condition({"imu.delay": 0.044}),
    **{
        f"zero error of roll of {angle} degrees": Condition(roll_zero=math.radians(angle))
        for angle in (1, 2, 3, -3)
    },
    "bank of 3 degrees to the outside": Condition(bank=BANK, roll_zero=BANK),
    "bank of 3 degrees to the inside": Condition(bank=-BANK, roll_zero=-BANK),
    "wind of 5 m/s to the left": Condition({"wind.mean_y": 5.0}),
    "wind of 5 m/s to the right": Condition({"wind.mean_y": -5.0}),
    "both motors limp": Condition(breaks="motors"),
    "roll motor limp, pitch held": Condition(breaks="roll motor"),
    "IMU invalid": Condition(breaks="IMU invalid"),
    "IMU frozen": Condition(breaks="IMU frozen"),
    "roll motor limp, and the drive acts": Condition(breaks="roll motor", acts=ACTS),
    "IMU invalid, and the drive acts": Condition(breaks="IMU invalid", acts=ACTS),
    "IMU frozen, and the drive acts": Condition(breaks="IMU frozen", acts=ACTS),
    "friction x 0.8": Condition(factors={"car.tyre_friction": 0.8}),
    "torque limit of 30 %": Condition(factors={"tail_motor.torque_limit": 0.3}),
    "torque 30 % low": Condition({"tail_motor.torque_error": -0.3}),
    "sail 20 % narrower": Condition(factors={"tail.sail_width": 0.8}),
    "noise of the IMU x 4": Condition(
        factors=dict.fromkeys(("imu.attitude_noise", "imu.gyro_noise", "imu.gyro_bias"), 4.0)
    ),
    "10 % more mass, centre of mass 5 % higher": Condition(
        factors={"car.mass": 1.1, "car.com_height": 1.05}
    ),
    "contact approximation similar": Condition(contact="kSimilar"),
    "contact approximation SAP": Condition(contact="kSap"),
}


class BentLaw:
    """The law of a scenario with an error of the roll, and a fault in mid-swerve; for one run."""

    def __init__(self, scenario: Scenario, condition: Condition) -> None:
        self._law = law_of_scenario(scenario)
        self._condition = condition
        self._fault_time = scenario.manoeuvre.turn_start + BREAKS
        self._hold = [0.0, scenario.controller.hold_kp, scenario.controller.hold_kd, 0.0]
        self._pitch = math.nan
        self._imu: tuple[float, ...] = ()
        self.rate = self._law.rate
        self.memory_size = self._law.memory_size
        self.start = self._law.start

    def step(self, memory: Any, seen: Any) -> Any:
        """Ticks the law with what is left of sensors and motors, or holds the tail."""
        breaks = self._condition.breaks if seen.time >= self._fault_time else ""
        imu = np.array(seen.imu)
        imu[ROLL] += self._condition.roll_zero
        if breaks != "IMU frozen":
            self._imu = tuple(imu.tolist())
        valid = seen.imu_valid and breaks != "IMU invalid"
        bent = replace(seen, imu=self._imu, imu_valid=valid)
        memory, pitch, roll, state = self._law.step(memory, bent)
        if seen.time < self._fault_time:
            self._pitch = seen.pitch_angle
        if seen.time >= self._fault_time + self._condition.acts:
            pitch = np.array([self._pitch, *self._hold])
            roll = np.array([0.0, *self._hold])
        if breaks == "motors":
            pitch = NO_COMMAND
        if breaks in {"motors", "roll motor"}:
            roll = NO_COMMAND
        return memory, pitch, roll, state


class BentDriver:
    """A driver with rollover control whose roll has an error, and whose IMU fails in mid-swerve;
    for one run.
    """

    def __init__(self, driver: LimitedDriver, scenario: Scenario, condition: Condition) -> None:
        self._driver = driver
        self._condition = condition
        self._fault_time = scenario.manoeuvre.turn_start + BREAKS
        self._seen = (math.nan, math.nan)
        self.sources = driver.sources
        self.start = driver.start

    def step(self, memory: Any, view: DriverView) -> Any:
        """Ticks driver and control with what is left of the IMU."""
        breaks = self._condition.breaks if view.time >= self._fault_time else ""
        if breaks == "IMU invalid":
            self._seen = (math.nan, math.nan)
        elif breaks != "IMU frozen":
            self._seen = (view.roll + self._condition.roll_zero, view.roll_rate)
        roll, roll_rate = self._seen
        return self._driver.step(memory, view._replace(roll=roll, roll_rate=roll_rate))


class StoppedSchedule:
    """A schedule whose steering and throttle the drive takes away at a time, s."""

    def __init__(self, schedule: Any, stop: float) -> None:
        self._schedule = schedule
        self._stop = stop

    def at(self, time: float) -> DriverInput:
        """Inputs at a time, s."""
        if time >= self._stop:
            return DriverInput(0.0, 0.0, 0.0)
        inputs: DriverInput = self._schedule.at(time)
        return inputs


@dataclass(frozen=True)
class Asked:
    """What the user asks for.

    Attributes:
        candidate: name of the candidate; one with a rollover control has a driver at full lock.
        share: share of the angles of the law's best steering, for the others.
        settings: numbers in place of those of the candidate.
    """

    candidate: str
    share: float
    settings: tuple[str, ...]


def scenario_of(car: str, condition: Condition, asked: Asked) -> Scenario:
    """The swerve of a car in a condition, at a step of 1 ms."""
    member = next(one for one in load_ensemble("physical").members if one.name == car)
    candidate = NAMED_CANDIDATES[asked.candidate]
    settings = [*member.settings_on("swerve"), *candidate.settings]
    if candidate.is_at_full_lock:
        stop = load_scenario("swerve", settings).servo.limit
        settings += steering_settings(constant_steering(stop, 1)[:, 0])
    else:
        settings += best_steering(car, asked.share)
    settings += ["manoeuvre.speed=6", "simulation.step=0.001", *asked.settings]
    plain = load_scenario("swerve", settings)
    numbers = dict(LATE) | dict(condition.settings)
    for key, factor in condition.factors.items():
        part, name = key.split(".")
        numbers[key] = factor * getattr(getattr(plain, part), name)
    changes: dict[str, dict[str, float]] = {}
    for key, value in numbers.items():
        part, name = key.split(".")
        changes.setdefault(part, {})[name] = value
    return plain.varied(**changes)


def banked(ground: Callable[..., Any], bank: float) -> Callable[..., Any]:
    """A ground that falls to the right."""

    def add(plant: Any, friction: float) -> None:
        down = np.linalg.norm(plant.gravity_field().gravity_vector())
        across = [0.0, -math.sin(bank), -math.cos(bank)]
        plant.mutable_gravity_field().set_gravity_vector(down * np.array(across))
        ground(plant, friction)

    return add


class OneContact:
    """Stands in for Drake's enumeration: its usual name gives another approximation."""

    def __init__(self, name: str) -> None:
        self.kLagged = getattr(DiscreteContactApproximation, name)


def drive(item: tuple[str, Condition, Asked]) -> tuple[bool, float, float]:
    """Whether a car in a condition stays upright, and how far it goes aside in half a second and in
    a whole one, m.
    """
    car, condition, asked = item
    scenario = scenario_of(car, condition, asked)
    stop = scenario.manoeuvre.turn_start + BREAKS + condition.acts
    law = BentLaw(scenario, condition) if scenario.tail.mode == "swing" else None

    def schedule(scenario: Scenario) -> StoppedSchedule:
        return StoppedSchedule(make_schedule(scenario), stop)

    def control(*numbers: Any) -> BentDriver:
        return BentDriver(LimitedDriver(*numbers), scenario, condition)

    with (
        patch.object(car_plant, "_add_ground", banked(car_plant._add_ground, condition.bank)),
        patch.object(car_plant, "DiscreteContactApproximation", OneContact(condition.contact)),
        patch.object(driver_law, "make_schedule", schedule),
        patch.object(driver_law, "LimitedDriver", control),
    ):
        swerve = swerve_of(simulate(scenario, record="outcome", law=law))
    return bool(is_upright(swerve)[0]), float(aside(swerve)[0]), float(aside(swerve, LATER)[0])


def main() -> None:
    names = [one.name for one in load_ensemble("physical").members]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidate", default="feedback", choices=CANDIDATES)
    parser.add_argument("--share", type=float, default=0.8, help="of the best steering's angles")
    parser.add_argument("--car", action="append", choices=names, help="of `physical.yaml`")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    cars = given.car or CARS
    asked = Asked(given.candidate, given.share, tuple(given.set))
    try:
        for car in cars:
            scenario_of(car, Condition(), asked)
    except UserError as error:
        parser.error(str(error))
    items = [(car, condition, asked) for condition, car in product(CONDITIONS.values(), cars)]
    print("| condition | upright | aside |\n|---|---|---|")
    with Pool(2) as workers:
        runs = iter(workers.imap(drive, items))
        for name in CONDITIONS:
            upright, metres, _ = zip(*(next(runs) for _ in cars), strict=True)
            tipped = ", ".join(c for c, stays in zip(cars, upright, strict=True) if not stays)
            median = f"{np.median(metres):.3f} m"
            print(f"| {name} | {sum(upright)} of {len(cars)} | {median} | {tipped}", flush=True)


if __name__ == "__main__":
    main()
