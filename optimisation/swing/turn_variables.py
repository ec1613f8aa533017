"""Variables of a turn that is searched: one roll of the tail for all cars, and the steering of each car.

    tail:       release after the start of the steering (s), rates of the tail's roll at knots after it (rad/s)
    each car:   angle (rad), first angle (rad) and its time (s) of the steering

The rate is linear between knots, zero at the first and the last, so the roll is exactly the cubic that a swing file
plays; after the last knot the tail is held. All variables are scaled; turns are to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from aerodima.optimisation.swing.task import PULSE
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.controllers.manoeuvre import TICK_TOLERANCE

RELEASE, RATE, ANGLE, TIME = 0.2, 8.0, 0.1, 0.2
"""One unit of a release (s), a rate (rad/s), a steering angle (rad), the time of a first level (s)."""
EARLIEST, LATEST = 0.02, 0.5
"""Of the release, s after the start of the steering."""
STEERING = 3
"""Variables of one car's steering."""


class Steered(NamedTuple):
    """Steering of cars: angle and first angle, rad, and the time of the first one, s; arrays of one shape."""

    angle: FloatArray
    first_angle: FloatArray
    first_hold: FloatArray


@dataclass(frozen=True)
class TurnVariables:
    """Where each variable stands, and what it may be.

    Attributes:
        members: number of cars.
        rates: number of knots at which the tail's rate is free.
        interval: between two knots, s.
        start: roll of the tail that waits, rad.
        most_roll, most_rate: of the tail, to either side, rad and rad/s.
        steering: least and largest angle, rad.
        tick: of the driver, s; a first level lasts whole ticks in the end.
    """

    members: int
    rates: int
    interval: float
    start: float
    most_roll: float
    most_rate: float
    steering: tuple[float, float]
    tick: float = 0.01

    @property
    def tail(self) -> int:
        """Number of the tail's variables, which come first."""
        return 1 + self.rates

    @property
    def size(self) -> int:
        """Number of all."""
        return self.tail + STEERING * self.members

    def own(self, member: int) -> FloatArray:
        """Places of the variables that one car's turn depends on: the tail's, then its steering's."""
        first = self.tail + STEERING * member
        return np.concatenate([np.arange(self.tail), np.arange(first, first + STEERING)])

    @cached_property
    def units(self) -> FloatArray:
        """One unit of every variable (size,)."""
        return np.concatenate([[RELEASE], [RATE] * self.rates, [ANGLE, ANGLE, TIME] * self.members])

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest scaled values (size,)."""
        low, high = self.steering
        ends = []
        for side, angle, release, hold in ((-1.0, low, EARLIEST, self.tick), (1.0, high, LATEST, PULSE - self.tick)):
            ends.append(
                np.concatenate([[release], [side * self.most_rate] * self.rates, [angle, angle, hold] * self.members])
            )
        return ends[0] / self.units, ends[1] / self.units

    @cached_property
    def roll_rows(self) -> FloatArray:
        """Matrix (rows, rates) that gives the tail's travel (rad) from its rates (rad/s): at knots and midway."""
        count, h = self.rates + 2, self.interval
        at_knots = np.zeros((count, count))
        for knot in range(1, count):
            at_knots[knot] = at_knots[knot - 1]
            at_knots[knot, [knot - 1, knot]] += 0.5 * h
        midway = at_knots[:-1] + h / 8.0 * (3.0 * np.eye(count)[:-1] + np.eye(count)[1:])
        return np.concatenate([at_knots[1:], midway])[:, 1:-1]

    def motion(self, own: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Knots of the tail: times since the start of the steering, rolls and rates, (knots, ...) each.

        Args:
            own: scaled variables of one car's turn (`own`), more axes behind; complex steps pass through.
        """
        own = own[: self.tail + STEERING]
        release, inner = RELEASE * own[0], RATE * own[1 : self.tail]
        still = 0.0 * inner[:1]
        rate = np.concatenate([still, inner, still])
        travelled = np.concatenate([still, np.cumsum(0.5 * self.interval * (rate[1:] + rate[:-1]), axis=0)])
        after = np.arange(len(rate)).reshape(-1, *[1] * (own.ndim - 1)) * self.interval
        time = np.concatenate([still, release + after])
        return time, self.start + np.concatenate([still, travelled]), np.concatenate([still, rate])

    def steered(self, own: FloatArray) -> Steered:
        """Steering of one car's turn, from its scaled variables."""
        return Steered(ANGLE * own[self.tail], ANGLE * own[self.tail + 1], TIME * own[self.tail + 2])

    def on_ticks(self, x: FloatArray) -> FloatArray:
        """All variables with first levels that last whole ticks of the driver."""
        rounded = x.copy()
        places = self.tail + STEERING * np.arange(self.members) + 2
        ticks = np.floor(TIME * x[places] / self.tick + 0.5 + TICK_TOLERANCE)
        rounded[places] = self.tick * ticks / TIME
        return rounded

    def random_start(self, generator: np.random.Generator) -> FloatArray:
        """A swing over the top of random length and travel, and some steering."""
        knots = self.interval * np.arange(1, self.rates + 1)
        length = self.interval * (self.rates + 1)
        duration = generator.uniform(0.5, 1.0) * length
        travel = generator.uniform(0.2, 0.9) * 2.0 * abs(self.start)
        phase = np.clip(knots / duration, 0.0, 1.0)
        rates = np.clip(6.0 * phase * (1.0 - phase) * travel / duration, -self.most_rate, self.most_rate)
        release = generator.uniform(EARLIEST, 0.7 * LATEST)
        low, high = self.steering
        size = (self.members, 1)
        then, first = (low * (most / low) ** generator.uniform(size=size) for most in (high, min(high, 3.0 * low)))
        cars = np.hstack([then, first, generator.uniform(0.1, 0.45, size)])
        return np.concatenate([[release], -np.sign(self.start) * rates, cars.ravel()]) / self.units
