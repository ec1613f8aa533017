"""Turns of all cars and of all central differences in one batch, with slopes, for the nonlinear
program.

A row of `ROWS` is a number per car. Peaks are taken by windows of `WINDOW`, each a row of its own:
a peak of one window is smooth in the variables where it stands alone, and two peaks that compete
stand in two rows. The course is read at the instant of the exit; a turn without exit before the end
of the run has the course of its end. Nothing else is rounded: a wheel that lifts and a joint at its
torque limit remain kinks of the model.

Variables are one roll of the tail for all cars, and the steering of each car:

    tail:       release after the start of the steering (s), rates of the tail's roll at knots after
    it (rad/s) each car:   angle (rad), first angle (rad) and its time (s) of the steering

The rate is linear between knots, zero at the first and the last, so the roll is exactly the cubic
that a swing file plays; after the last knot the tail is held. All variables are scaled; turns are
to the left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from aerodima.optimisation.swing.task import Task
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.rollout import heights, over_ground
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import Turns, drive_turns
from aerodima.workbench.car.verdict import EXIT_YAW_RATE
from aerodima.workbench.control.manoeuvre import TICK_TOLERANCE
from aerodima.workbench.control.swing_player import RollTrajectory
from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.scenario.scenario import Scenario

DRIVE_ON_TIME = 0.8
"""How long turns are driven after the steering at least, s."""
WINDOW = 0.1
"""Windows in which peaks are limited one by one, s."""
END_ROLL = 0.1
"""Largest roll of a car at the end, to either side, rad."""
ROLL_MARGIN = 0.05
"""Below the largest roll that counts, for the reduced car's error, rad."""
CLEARANCE = 0.02
"""Least height of the tail over the ground, m."""
BOARD_CLEARANCE = 0.003
"""Least height of the anti-ramp board behind the car over the ground, m."""
DRAWS = 32
"""Random starts that are drawn; the best one is taken."""
TORQUE_SHARE = 0.9
"""Share of the roll motor's torque limit that may be asked for."""
DIFFERENCE_STEP = 1e-7
"""Step of the scaled variables to either side for slopes: right to 1e-5, at 1/40 of the time of
complex steps."""
HOLD_GAINS = {"kp": 17.0, "kd": 5.0}
"""Gains of the wait: those of the thesis' hold (Table 6.4)."""
FOLLOW_GAINS = {"kp": 60.0, "kd": 3.0}
"""Gains along the knots: the tail of 0.05 kg m2 follows within 0.05 rad at 100 Hz."""
RELEASE_STEERING = 0.01
"""Steering command that releases a swing which goes by the steering, rad: less than any turn's."""
RELEASE_SCALE = 0.2
"""One unit of a release, s."""
RATE_SCALE = 8.0
"""One unit of a rate, rad/s."""
ANGLE_SCALE = 0.1
"""One unit of a steering angle, rad."""
TIME_SCALE = 0.2
"""One unit of the time of a first level, s."""
MIN_RELEASE = 0.02
"""Earliest release after the start of the steering, s."""
MAX_RELEASE = 0.5
"""Latest release after the start of the steering, s."""
STEERING_SIZE = 3
"""Variables of one car's steering."""


@dataclass(frozen=True)
class TurnVariables:
    """Index, unit and bounds of each variable.

    Attributes:
        members: number of cars.
        rates: number of knots at which the tail's rate is free.
        interval: between two knots, s.
        start: roll of the tail that waits, rad.
        max_roll, max_rate: of the tail, to either side, rad and rad/s.
        steering: least and largest angle, rad.
        pulse: length of the steering, s.
        tick: of the driver, s; a first level lasts whole ticks in the end.
    """

    members: int
    rates: int
    interval: float
    start: float
    max_roll: float
    max_rate: float
    steering: tuple[float, float]
    pulse: float = 0.5
    tick: float = 0.01

    @property
    def tail(self) -> int:
        """Number of the tail's variables, which come first."""
        return 1 + self.rates

    @property
    def size(self) -> int:
        """Number of all."""
        return self.tail + STEERING_SIZE * self.members

    def own(self, member: int) -> FloatArray:
        """Returns the indices of the variables of one car's turn: the tail's, then its
        steering's.
        """
        first = self.tail + STEERING_SIZE * member
        return np.concatenate([np.arange(self.tail), np.arange(first, first + STEERING_SIZE)])

    @cached_property
    def units(self) -> FloatArray:
        """One unit of every variable (size,)."""
        return np.concatenate(
            [
                [RELEASE_SCALE],
                [RATE_SCALE] * self.rates,
                [ANGLE_SCALE, ANGLE_SCALE, TIME_SCALE] * self.members,
            ]
        )

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest scaled values (size,)."""
        low, high = self.steering
        members = self.members
        tail = [self.max_rate] * self.rates
        least = [MIN_RELEASE, *(-rate for rate in tail), *[low, low, self.tick] * members]
        longest = self.pulse - self.tick
        largest = [MAX_RELEASE, *tail, *[high, high, longest] * members]
        return np.array(least) / self.units, np.array(largest) / self.units

    @cached_property
    def roll_rows(self) -> FloatArray:
        """Matrix (rows, rates) that gives the tail's travel (rad) from its rates (rad/s): at knots
        and midway.
        """
        count = self.rates + 2
        h = self.interval
        at_knots = np.zeros((count, count))
        for knot in range(1, count):
            at_knots[knot] = at_knots[knot - 1]
            at_knots[knot, [knot - 1, knot]] += 0.5 * h
        midway = at_knots[:-1] + h / 8.0 * (3.0 * np.eye(count)[:-1] + np.eye(count)[1:])
        return np.concatenate([at_knots[1:], midway])[:, 1:-1]

    def motion(self, own: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns the knots of the tail: times since the start of the steering, rolls and rates,
        (knots, ...) each.

        Args:
            own: scaled variables of one car's turn (`own`), more axes behind.
        """
        own = own[: self.tail + STEERING_SIZE]
        release = RELEASE_SCALE * own[0]
        inner = RATE_SCALE * own[1 : self.tail]
        still = 0.0 * inner[:1]
        rate = np.concatenate([still, inner, still])
        travelled = np.concatenate(
            [still, np.cumsum(0.5 * self.interval * (rate[1:] + rate[:-1]), axis=0)]
        )
        after = np.arange(len(rate)).reshape(-1, *[1] * (own.ndim - 1)) * self.interval
        time = np.concatenate([still, release + after])
        return time, self.start + np.concatenate([still, travelled]), np.concatenate([still, rate])

    def steered(self, own: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns angle, first angle (rad) and its time (s) of a car's turn, from its scaled
        variables.
        """
        return (
            ANGLE_SCALE * own[self.tail],
            ANGLE_SCALE * own[self.tail + 1],
            TIME_SCALE * own[self.tail + 2],
        )

    def on_ticks(self, x: FloatArray) -> FloatArray:
        """Returns all variables with first levels that last whole ticks of the driver."""
        rounded = x.copy()
        places = self.tail + STEERING_SIZE * np.arange(self.members) + 2
        ticks = np.floor(TIME_SCALE * x[places] / self.tick + 0.5 + TICK_TOLERANCE)
        rounded[places] = self.tick * ticks / TIME_SCALE
        return rounded

    def random_start(self, generator: np.random.Generator) -> FloatArray:
        """Draws a swing over the top of random length and travel, and some steering."""
        knots = self.interval * np.arange(1, self.rates + 1)
        length = self.interval * (self.rates + 1)
        uniform = generator.uniform
        duration = uniform(0.5, 1.0) * length
        travel = uniform(0.2, 0.9) * 2.0 * abs(self.start)
        phase = np.clip(knots / duration, 0.0, 1.0)
        parabola = 6.0 * phase * (1.0 - phase) * travel / duration
        rates = np.clip(parabola, -self.max_rate, self.max_rate)
        release = uniform(MIN_RELEASE, 0.7 * MAX_RELEASE)
        low, high = self.steering
        size = (self.members, 1)
        then = low * (high / low) ** uniform(size=size)
        first = low * (min(high, 3.0 * low) / low) ** uniform(size=size)
        time = uniform(0.2 * self.pulse, 0.9 * self.pulse, size)
        cars = np.hstack([then, first, time])
        return np.concatenate([[release], -np.sign(self.start) * rates, cars.ravel()]) / self.units


class Row(NamedTuple):
    """One number of each car: lower <= value <= upper, in units of `size` for the solver."""

    name: str
    unit: str
    size: float
    lower: float
    upper: float


class Evaluation(NamedTuple):
    """Evaluation at some variables.

    Attributes:
        course: of every car (members,), rad, and `course_slopes` with the scaled variables
            (members, size).
        rows: (members, rows) in their units, and `row_slopes` (members, rows, size).
    """

    course: FloatArray
    course_slopes: FloatArray
    rows: FloatArray
    row_slopes: FloatArray


@dataclass(frozen=True)
class TurnShooting:
    """Cars on their floors, driven from the start of their turns on.

    Attributes:
        cars, plans: one of each member.
        begun: states at the start of the turns (24, members).
        variables: of the search.
        torque: largest that the roll motor may be asked for, N m.
        max_roll, max_sideslip: of a turn that counts, rad: to either side, and at the exit.
        length: of a step, s.
    """

    cars: VehicleParams
    plans: TurnPlans
    begun: FloatArray
    variables: TurnVariables
    torque: float
    max_roll: float
    max_sideslip: float
    length: float

    @classmethod
    def from_scenarios(
        cls, scenarios: Sequence[Scenario], rates: int, interval: float, task: Task, length: float
    ) -> TurnShooting:
        """Makes the shooting of turns with a tail.

        Args:
            scenarios: cars on their floors; their steering and law do not matter.
            rates, interval: as `TurnVariables`.
            task: its pulse, range of the steering, and limits of a turn that counts.
            length: of a step, s.

        Raises:
            UserError: what the reduced car does not know.
        """
        cars = VehicleParams.from_scenarios(scenarios)
        first = scenarios[0]
        limit = TORQUE_SHARE * first.tail_motor.torque_limit
        low, high = map(math.radians, task.steering)
        count = len(scenarios)
        variables = TurnVariables(
            count,
            rates,
            interval,
            start=-first.controller.hold_angle,
            max_roll=min(s.tail.roll_limit for s in scenarios),
            max_rate=float(np.min(cars.no_load_speed * (1.0 - limit / cars.stall_torque))),
            steering=(low, min(high, *(s.servo.limit for s in scenarios))),
            pulse=task.pulse,
            tick=1.0 / first.controller.rate,
        )
        swinging = [
            s.varied(tail={"mode": "swing"}, controller={"swing_file": "none"}) for s in scenarios
        ]
        law = {"hold_kp": HOLD_GAINS["kp"], "hold_kd": HOLD_GAINS["kd"], "delay": 0.0}
        law |= {"by_steering": 1.0, "threshold": RELEASE_STEERING}
        plans = TurnPlans.from_scenarios(swinging).varied(
            law={name: np.full(count, value) for name, value in law.items()},
            pulse={"hold": np.full(count, task.pulse)},
        )
        begun = drive_turns(cars, plans, duration=0.0, length=length).last
        return cls(cars, plans, begun, variables, limit, task.most_roll, task.most_sideslip, length)

    @cached_property
    def windows(self) -> int:
        """Number of windows of a turn, which fill the time that it is driven."""
        return math.ceil((self.variables.pulse + DRIVE_ON_TIME) / WINDOW - TICK_TOLERANCE)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """Limits of every car."""
        roll = self.max_roll - ROLL_MARGIN
        torque = self.torque
        slip = self.max_sideslip
        rows = []
        for name, unit, size, lower, upper in (
            ("roll", "rad", 0.1, -roll, roll),
            ("height of the tail", "m", 0.1, CLEARANCE, np.inf),
            ("torque asked for", "N m", 10.0, -torque, torque),
        ):
            for window in range(self.windows):
                when = f"{name} from {WINDOW * window:.1f} s on"
                rows.append(Row(when, unit, size, lower, upper))
        return (
            *rows,
            Row("height of the board", "m", 0.1, BOARD_CLEARANCE, np.inf),
            Row("sideslip at the exit", "rad", 0.1, -slip, slip),
            Row("roll at the end", "rad", 0.1, -END_ROLL, END_ROLL),
            Row("yaw rate at the end", "rad/s", 1.0, -EXIT_YAW_RATE, EXIT_YAW_RATE),
        )

    def drive(self, own: FloatArray, members: IntArray) -> Turns:
        """Drives turns of members (n), each with its own scaled variables (own, n), with their
        history.
        """
        time, roll, rate = self.variables.motion(own)
        angle, first_angle, first_hold = self.variables.steered(own)
        one = np.ones(len(members))
        kp = FOLLOW_GAINS["kp"] * one
        kd = FOLLOW_GAINS["kd"] * one
        steering = {"steer_angle": angle, "first_angle": first_angle, "first_hold": first_hold}
        plans = self.plans.take(members).varied(pulse=steering)
        plans = replace(plans, knots=RollTrajectory(one, time, roll, rate, kp, kd, kp, kd))
        return drive_turns(
            self.cars.take(members),
            plans,
            duration=WINDOW * self.windows,
            length=self.length,
            history=True,
            begun=self.begun[:, members],
        )

    def random_start(self, generator: np.random.Generator) -> FloatArray:
        """Draws scaled variables (size,): of some draws that whose turns count and lead furthest,
        else the most upright one.
        """
        draws = np.array([self.variables.random_start(generator) for _ in range(DRAWS)])
        members = range(self.variables.members)
        own = [draws[:, self.variables.own(member)].T for member in members]
        turns = self.drive(np.concatenate(own, axis=1), np.repeat(members, DRAWS))
        good = turns.clean & (turns.peak_roll <= self.max_roll)
        good = good & (np.abs(turns.sideslip) <= self.max_sideslip)
        worth = np.where(good, turns.course, -turns.peak_roll)
        mean = np.mean(worth.reshape(len(members), DRAWS), axis=0)
        return np.asarray(draws[int(np.argmax(mean))])

    def at(self, x: FloatArray) -> Evaluation:
        """Evaluates courses and rows of all cars with their slopes.

        Args:
            x: scaled variables (size,).
        """
        variables = self.variables
        count = variables.members
        own = [variables.own(member) for member in range(variables.members)]
        width = len(own[0])
        steps = DIFFERENCE_STEP * np.eye(width)
        tried = np.hstack([steps, -steps, np.zeros((width, 1))])
        columns = np.concatenate([x[places][:, None] + tried for places in own], axis=1)
        members = np.repeat(np.arange(count), tried.shape[1])
        turned, rows = self._read(self.drive(columns, members), members)
        values = np.concatenate([turned[None], rows]).reshape(-1, count, tried.shape[1])
        slopes = np.zeros((count, len(values), variables.size))
        for member, places in enumerate(own):
            ahead = values[:, member, :width]
            behind = values[:, member, width:-1]
            slopes[member][:, places] = (ahead - behind) / (2.0 * DIFFERENCE_STEP)
        here = values[:, :, -1].T
        return Evaluation(here[:, 0], slopes[:, 0], here[:, 1:], slopes[:, 1:])

    def _read(self, turns: Turns, members: IntArray) -> tuple[FloatArray, FloatArray]:
        """Reads courses (n,) and rows (rows, n) of turns."""
        assert turns.history is not None
        assert turns.asked is not None
        cars = self.cars.take(members)
        last = turns.last
        states = np.moveaxis(turns.history, 0, 1)  # (24, steps, n)
        roll = states[5]
        every = self.cars.take(np.tile(members, len(roll)))
        tail, board = heights(states.reshape(len(states), -1), every)
        tail = tail.reshape(roll.shape)
        board = board.reshape(roll.shape)
        end, _ = over_ground(last, cars.com_x)
        began, _ = over_ground(self.begun, self.cars.com_x)
        without = np.isnan(turns.course)
        turned = np.where(without, end - began[members], turns.course)
        sideslip = np.where(without, last[3] - end, turns.sideslip)
        windows = self.windows
        rows = [
            *_peaks(roll, np.abs(roll), windows),
            *_peaks(tail, -tail, windows),
            *_peaks(turns.asked, np.abs(turns.asked), windows),
            *_peaks(board, -board, 1),
            sideslip,
            last[5],
            last[14],
        ]
        return turned, np.array(rows)


def _peaks(values: FloatArray, size: FloatArray, windows: int) -> FloatArray:
    """Returns the values (steps, n) of the largest size in each window: (windows, n)."""
    shape = (windows, -1, values.shape[1])
    index = np.argmax(size.reshape(shape), axis=1)[:, None]
    return np.take_along_axis(values.reshape(shape), index, axis=1)[:, 0]
