"""Turns of all cars and of all complex steps in one batch: what the programme asks, with exact slopes.

A row of `ROWS` is a number per car. Peaks are taken by windows of `WINDOW`, each a row of its own: a peak of one window
is smooth in the variables where it stands alone, and two peaks that compete stand in two rows. The course is read at
the instant of the exit; what has none before the end of the run has that of its end. Nothing else is rounded: a wheel
that lifts and a joint at its torque limit remain kinks of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from aerodima.optimisation.screening.turn_plans import PlayedRoll, TurnPlans
from aerodima.optimisation.screening.turns import Turns, course, drive_turns, heights
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.swing.swing_construction import FOLLOW, HOLD, RELEASE_STEERING
from aerodima.optimisation.swing.task import MOST_ROLL, MOST_SIDESLIP, PULSE
from aerodima.optimisation.swing.turn_variables import TurnVariables
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.metrics.turn_signals import EXIT_YAW_RATE

HORIZON, WINDOW = 1.3, 0.1
"""s: how long turns are driven, and in which parts of it peaks are limited one by one."""
END_ROLL = 0.1
"""Largest roll of a car at the end, to either side, rad."""
ROLL_MARGIN = 0.05
"""Below the largest roll that counts, for the reduced car's error, rad."""
CLEARANCE, BOARD_CLEARANCE = 0.02, 0.003
"""Least height of the tail, and of the anti-ramp board behind the car, over the ground, m."""
DRAWS = 32
"""Of a random start, the best of which is taken."""
TORQUE_SHARE = 0.9
"""Of the roll motor's torque limit may be asked."""
COMPLEX_STEP = 1e-30
"""Length of the imaginary step with which slopes are taken; no digits cancel, so it may be this small."""


class Row(NamedTuple):
    """One number of each car: lower <= value <= upper, in units of `size` for the solver."""

    name: str
    unit: str
    size: float
    lower: float
    upper: float


class Found(NamedTuple):
    """At some variables.

    Attributes:
        course: of every car (members,), rad, and `course_slopes` with the scaled variables (members, size).
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
        torque: most that the roll motor may be asked for, N m.
        length: of a step, s.
    """

    cars: Vehicles
    plans: TurnPlans
    begun: FloatArray
    variables: TurnVariables
    torque: float
    length: float

    @classmethod
    def of(
        cls, scenarios: Sequence[Scenario], rates: int, interval: float, steering: tuple[float, float], length: float
    ) -> TurnShooting:
        """Of turns with a tail.

        Args:
            scenarios: cars on their floors; their steering and law do not matter.
            rates, interval, steering: as `TurnVariables`.
            length: of a step, s.

        Raises:
            UserError: what the screening model does not know.
        """
        cars = Vehicles.of(scenarios)
        first = scenarios[0]
        limit = TORQUE_SHARE * first.tail_motor.torque_limit
        most_rate = float(np.min(cars.no_load_speed * (1.0 - limit / cars.stall_torque)))
        hold = first.controller.hold_angle
        variables = TurnVariables(
            len(scenarios), rates, interval, -hold, min(s.tail.roll_limit for s in scenarios), most_rate, steering,
            1.0 / first.controller.rate,
        )  # fmt: skip
        swinging = [s.varied(tail={"mode": "swing"}, controller={"swing_file": "none"}) for s in scenarios]
        count = len(scenarios)
        chosen = {"hold_kp": HOLD["kp"], "hold_kd": HOLD["kd"], "delay": 0.0, "hold": PULSE}
        chosen |= {"trigger_yaw_rate": np.inf, "trigger_steering": RELEASE_STEERING}
        numbers: dict[str, Any] = {name: np.full(count, value) for name, value in chosen.items()}
        plans = replace(TurnPlans.of(swinging), **numbers)
        begun = drive_turns(cars, plans, duration=0.0, length=length).last
        return cls(cars, plans, begun, variables, limit, length)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """What is limited, for every car."""
        windows = range(round(HORIZON / WINDOW))
        most = MOST_ROLL - ROLL_MARGIN
        when = [f" from {WINDOW * k:.1f} s on" for k in windows]
        return (
            *(Row(f"roll{words}", "rad", 0.1, -most, most) for words in when),
            *(Row(f"height of the tail{words}", "m", 0.1, CLEARANCE, np.inf) for words in when),
            *(Row(f"torque asked for{words}", "N m", 10.0, -self.torque, self.torque) for words in when),
            Row("height of the board", "m", 0.1, BOARD_CLEARANCE, np.inf),
            Row("sideslip at the exit", "rad", 0.1, -MOST_SIDESLIP, MOST_SIDESLIP),
            Row("roll at the end", "rad", 0.1, -END_ROLL, END_ROLL),
            Row("yaw rate at the end", "rad/s", 1.0, -EXIT_YAW_RATE, EXIT_YAW_RATE),
        )

    def drive(self, own: FloatArray, members: np.ndarray) -> Turns:
        """Turns of members (n), each with its own scaled variables (own, n), with their history."""
        plans = self.plans.take(members)
        time, roll, rate = self.variables.motion(own)
        one = np.ones(len(members))
        gains = [gain * one for gain in (FOLLOW["kp"], FOLLOW["kd"]) * 2]
        angle, first_angle, first_hold = self.variables.steered(own)
        played = PlayedRoll(one, time, roll, rate, *gains)
        plans = replace(plans, steer_angle=angle, first_angle=first_angle, first_hold=first_hold, played=played)
        return drive_turns(
            self.cars.take(members), plans, duration=HORIZON, length=self.length, history=True,
            begun=self.begun[:, members].astype(own.dtype),
        )  # fmt: skip

    def random_start(self, generator: np.random.Generator) -> FloatArray:
        """Scaled variables (size,): of some draws that whose turns count and lead furthest, else the most upright."""
        draws = np.array([self.variables.random_start(generator) for _ in range(DRAWS)])
        count = self.variables.members
        own = np.concatenate([draws[:, self.variables.own(member)].T for member in range(count)], axis=1)
        turns = self.drive(own, np.repeat(np.arange(count), DRAWS))
        good = turns.clean & (turns.peak_roll <= MOST_ROLL) & (np.abs(turns.sideslip) <= MOST_SIDESLIP)
        worth = np.where(good, turns.course, -turns.peak_roll).reshape(count, DRAWS)
        return np.asarray(draws[int(np.argmax(np.mean(worth, axis=0)))])

    def at(self, x: FloatArray) -> Found:
        """Courses and rows of all cars with their slopes.

        Args:
            x: scaled variables (size,).
        """
        variables = self.variables
        count, own = variables.members, [variables.own(member) for member in range(variables.members)]
        width = len(own[0])
        steps = 1j * COMPLEX_STEP * np.eye(width)
        columns = np.concatenate([x[places][:, None] + steps for places in own], axis=1)
        members = np.repeat(np.arange(count), width)
        turned, rows = self._read(self.drive(columns, members), members)
        values = np.concatenate([turned[None], rows]).reshape(-1, count, width)
        slopes = np.zeros((count, len(values), variables.size))
        for member, places in enumerate(own):
            slopes[member][:, places] = values[:, member].imag / COMPLEX_STEP
        real = values[:, :, 0].real.T
        return Found(real[:, 0], slopes[:, 0], real[:, 1:], slopes[:, 1:])

    def _read(self, turns: Turns, members: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Courses (n,) and rows (rows, n) of turns."""
        assert turns.history is not None
        assert turns.asked is not None
        cars, last = self.cars.take(members), turns.last
        states = np.moveaxis(turns.history, 0, 1)  # (24, steps, n)
        count = states.shape[1]
        tail, board = heights(states.reshape(len(states), -1), self.cars.take(np.tile(members, count)))
        end = course(last, cars)
        without = np.isnan(turns.course)
        turned = np.where(without, end - course(self.begun, self.cars)[members], turns.course)
        sideslip = np.where(without, last[3] - end, turns.sideslip)
        rows = [
            *self._peaks(states[5]),
            *self._peaks(tail.reshape(count, -1), lowest=True),
            *self._peaks(turns.asked),
            -_peak(-board.reshape(count, -1)),
            sideslip,
            last[5],
            last[14],
        ]
        return turned, np.array(rows)

    def _peaks(self, values: FloatArray, lowest: bool = False) -> FloatArray:
        """Of values (steps, n): per window the one of the largest magnitude, or the least one, (windows, n)."""
        windows = np.split(values, round(HORIZON / WINDOW))
        return np.array([-_peak(-window) if lowest else _peak(window, np.abs(window.real)) for window in windows])


def _peak(values: FloatArray, size: FloatArray | None = None) -> FloatArray:
    """Of values (steps, n) those of the largest size, by default of the largest real part, (n,)."""
    places = np.argmax(values.real if size is None else size, axis=0)
    return np.take_along_axis(values, places[None], axis=0)[0]
