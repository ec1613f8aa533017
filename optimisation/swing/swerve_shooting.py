"""Swerves of all cars and of all central differences in one batch, with slopes, for the nonlinear
program.

Variables, all scaled, are one tail for all cars and the steering of each car:

    tail:       its pitch (rad), its roll at the knots after the first (rad), which is the middle
    each car:   three angles (rad), the ends of the first two (s)

Where the turn is announced the tail may wait at a side: its roll at the first knot comes before the
others, and each car also has a trim (rad), which keeps it straight until the steering starts.
Numbers of the tail that are free (`FreeTail`) come after its motion; cars with such a tail are read
anew at each point.
Between knots the roll is the cubic that a swing file plays, at rest at the first and the last; the
rate at a knot is that of the line between its neighbours. The knots begin one tick after the
steering, when the controller sees it.

Aim and limits are functions of `Swerve`. Peaks are taken window by window (`WINDOW`), each in a row
of its own: the peak of one window is smooth in the variables where it stands alone, and two peaks
that compete stand in two rows. A wheel that lifts and a joint at its torque limit remain kinks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from aerodima.optimisation.swerve.steering import TICK, TRIMS, steering_ranges
from aerodima.optimisation.swing.free_tail import FreeTail
from aerodima.workbench.car.reduced.parameters import VehicleParams, take
from aerodima.workbench.car.reduced.swerves import LEVELS, STEERING, PlayedSwerve, drive_swerves
from aerodima.workbench.car.swerve import Measure, Swerve, end_yaw_rate, energy, start_deviation
from aerodima.workbench.car.turn_signals import STEERED
from aerodima.workbench.car.verdict import EXIT_YAW_RATE, TWO_WHEELS, side_lift
from aerodima.workbench.control.swing_player import RollTrajectory
from aerodima.workbench.core.array_types import ArrayPair, FloatArray, IntArray, Pair
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.swing_file import cubic

KNOTS = (0.0, 0.07, 0.14, 0.22, 0.31, 0.42, 0.56, 0.75, 1.0, 1.35)
"""Times of the knots since the release, s: closer where a swerve is decided."""
PITCHES = (-1.15, 0.3)
"""Range of the pitch of the tail, rad; further back it meets the car."""
WINDOW = 0.2
"""Length of the windows in which peaks are limited one by one, s."""
LIFT_MARGIN = 2e-5
"""Margin to the height of two wheels that counts as a lift, m: the tolerance of the solver."""
YAW_RATE_MARGIN = 0.02
"""Margin to the largest yaw rate at the end of a swerve that counts, for the reduced car's error,
rad/s."""
CLEARANCE = 0.02
"""Least height of the tail over the ground, m."""
BOARD_CLEARANCE = 5e-4
"""Least height of the anti-ramp board over the ground while the car is steered, m."""
MAX_LAG = 0.8
"""Largest distance of the tail from its knots, rad: the player of a swing gives up at 1 rad."""
PLACES = np.arange(1, 16) / 16.0
"""Places between two knots, as shares, at which the roll of the tail keeps its range: those at
which a swing file is checked."""
ROLL_MARGIN = 0.01
"""Margin of these rolls to the limit of the tail, rad: the curve goes further between them."""
FOLLOW_GAINS = {"kp": 60.0, "kd": 3.0}
"""Gains of both joints of the tail, N m/rad and N m s/rad."""
DIFFERENCE_STEP = 1e-7
"""Step of the scaled variables to either side for slopes."""
FREE_STEP = 1e-5
"""The same of a free number of the tail, since rounding of mass properties counts."""
ANGLE_SCALE = 0.1
"""Steering angle of one scaled unit, rad."""
TIME_SCALE = 0.2
"""End of a level of one scaled unit, s."""
TRIM_SCALE = 0.01
"""Trim of one scaled unit, rad."""


@dataclass(frozen=True)
class Limit:
    """Numbers of each car that must lie within limits.

    Attributes:
        name: name in messages.
        function: function of a `Swerve` that returns the values (rows, n).
        unit: unit of the values.
        size: value of one scaled unit for the solver.
        lower: least value that is allowed.
        upper: largest value that is allowed.
    """

    name: str
    function: Measure
    unit: str
    size: float
    lower: float = -np.inf
    upper: float = np.inf

    def is_kept(self, swerve: Swerve) -> bool:
        """Returns whether all cars of a swerve keep the limit."""
        values = self.function(swerve)
        return bool(np.all((self.lower <= values) & (values <= self.upper)))


def peaks(swerve: Swerve, values: FloatArray) -> FloatArray:
    """Returns the largest values (steps, n) in each window from the start of the steering on
    (windows, n).
    """
    inside = values[swerve.steered]
    step = swerve.time[-1] - swerve.time[-2]
    size = round(WINDOW / step)
    starts = range(0, len(inside), size)
    return np.stack([np.max(inside[first : first + size], axis=0) for first in starts])


def _board(swerve: Swerve) -> FloatArray:
    steered = swerve.steered & (np.abs(swerve.steering) > STEERED).any(axis=1)
    return np.min(swerve.heights[steered, 1], axis=0)[None]


STANDARD_LIMITS = (
    Limit(
        "side lift",
        lambda s: peaks(s, side_lift(np.moveaxis(s.lifts, 1, 0))),
        "m",
        0.01,
        upper=TWO_WHEELS - LIFT_MARGIN,
    ),
    Limit("tail", lambda s: peaks(s, -s.heights[:, 0]), "m", 0.1, upper=-CLEARANCE),
    Limit("board", _board, "m", 0.1, lower=BOARD_CLEARANCE),
    Limit("lag", lambda s: peaks(s, np.abs(s.lag)), "rad", 1.0, upper=MAX_LAG),
    Limit(
        "yaw rate at the end",
        lambda s: end_yaw_rate(s)[None],
        "rad/s",
        1.0,
        -EXIT_YAW_RATE + YAW_RATE_MARGIN,
        EXIT_YAW_RATE - YAW_RATE_MARGIN,
    ),
)
"""Limits of every swerve, so that it counts and the motion of its tail can be played."""
STRAIGHT = Limit("straight start", start_deviation, "of what counts", 10.0, -0.5, 0.5)
"""Limit of a swerve whose tail may wait at a side, with a margin for the reduced car's error."""
LIMITS: Mapping[str, Callable[[float], Limit]] = {
    "roll": lambda most: Limit("roll", lambda s: peaks(s, np.abs(s.roll)), "rad", 0.1, upper=most),
    "energy": lambda most: Limit("energy", lambda s: energy(s)[None], "J", 1.0, upper=most),
    "torque": lambda most: Limit(
        "torque", lambda s: peaks(s, np.max(np.abs(s.torques), axis=1)), "N m", 10.0, upper=most
    ),
    "speed": lambda least: Limit("speed", lambda s: s.speed[-1:], "m/s", 1.0, lower=least),
}
"""Makers of further limits by name, functions of the largest (roll of the body, rad; energy of the
motors, J; torque, N m) or the least value (speed at the end, m/s)."""


def read_limits(texts: Sequence[str]) -> list[Limit]:
    """Reads limits such as `roll=0.3`; raises SwingError for an unknown or malformed one."""
    limits = []
    for text in texts:
        name, _, number = text.partition("=")
        if name not in LIMITS:
            raise SwingError(f"limit {text}: {nearest(name, list(LIMITS))}")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise SwingError(f"limit {text}: must be {name}=NUMBER, above 0")
        limits.append(LIMITS[name](value))
    return limits


class SwerveVariables(NamedTuple):
    """Index, unit and bounds of each variable.

    Attributes:
        members: number of cars.
        max_roll: largest roll of the tail to either side, rad.
        pitches: least and largest pitch of the tail, rad.
        max_angle: largest steering angle, rad.
        announced: whether the turn is announced, so that the tail may wait at a side.
        free: least and largest value of each free number of the tail.
    """

    members: int
    max_roll: float
    pitches: Pair
    max_angle: float
    announced: bool = False
    free: tuple[Pair, ...] = ()

    @property
    def motion(self) -> int:
        """Number of variables of the tail's motion, which come first."""
        return len(KNOTS) + self.announced

    @property
    def tail(self) -> int:
        """Number of the tail's variables: its motion, then its free numbers."""
        return self.motion + len(self.free)

    @property
    def driver(self) -> int:
        """Number of variables of the steering of each car, including its trim."""
        return STEERING + self.announced

    @property
    def size(self) -> int:
        """Number of all variables."""
        return self.tail + self.driver * self.members

    def own(self, member: int) -> IntArray:
        """Returns the indices of the variables of one car: the tail's, then its steering's."""
        first = self.tail + self.driver * member
        return np.concatenate([np.arange(self.tail), np.arange(first, first + self.driver)])

    @property
    def units(self) -> FloatArray:
        """Value of one scaled unit of every variable (size,)."""
        steering = [ANGLE_SCALE] * LEVELS + [TIME_SCALE] * (LEVELS - 1)
        steering += [TRIM_SCALE] * self.announced
        free = [0.5 * (largest - least) for least, largest in self.free]
        return np.array([1.0] * self.motion + free + steering * self.members)

    @property
    def ranges(self) -> ArrayPair:
        """Least and largest value of every variable (size,), rad and s."""
        rolls = np.full(self.motion - 1, self.max_roll)
        smallest, greatest = np.reshape(self.free, (-1, 2)).T
        ends = np.column_stack([np.array(steering_ranges(self.max_angle)), TRIMS])
        least, largest = ends[:, : self.driver]
        low = [self.pitches[0], *-rolls, *smallest, *np.tile(least, self.members)]
        high = [self.pitches[1], *rolls, *greatest, *np.tile(largest, self.members)]
        return np.array(low), np.array(high)

    @property
    def bounds(self) -> ArrayPair:
        """Least and largest scaled value of every variable (size,)."""
        low, high = self.ranges
        return low / self.units, high / self.units


def knot_rates() -> FloatArray:
    """Returns the matrix (knots, knots) that maps the rolls at the knots to the rates there."""
    times = np.array(KNOTS)
    unit = np.eye(len(times))
    rates = np.zeros_like(unit)
    rates[1:-1] = (unit[2:] - unit[:-2]) / (times[2:] - times[:-2])[:, None]
    return rates


def between_knots() -> FloatArray:
    """Returns the matrix (places, knots) that maps the rolls at the knots to those at `PLACES` of
    all intervals, by the cubic of a swing file.
    """
    unit = np.eye(len(KNOTS))
    rates = knot_rates()
    spans = np.diff(KNOTS)[:, None]
    ends = (unit[:-1], unit[1:])
    rolls, _ = cubic(PLACES[:, None, None], spans, ends, (rates[:-1], rates[1:]))
    return np.asarray(rolls).reshape(-1, len(KNOTS))


def within_reach(rolls: FloatArray, max_roll: float) -> FloatArray:
    """Returns rolls at the knots after the first (members, knots - 1); those of a member are scaled
    down where its curve goes beyond `max_roll`, rad.
    """
    curves = np.concatenate([rolls, rolls @ between_knots()[:, 1:].T], axis=1)
    reach = np.max(np.abs(curves), axis=1, keepdims=True)
    return rolls * np.minimum(1.0, max_roll / np.maximum(reach, max_roll))


def tail_at_knots(swerve: Swerve) -> FloatArray:
    """Returns the pitch of a tail when the steering starts, and its roll at the knots after the
    first (`KNOTS`,), rad, in a swerve of one car whose tail waits in the middle.
    """
    pitch, roll = swerve.tail[:, 0, 0], swerve.tail[:, 1, 0]
    rolls = [swerve.at(roll, TICK + knot) for knot in KNOTS[1:]]
    return np.array([swerve.at(pitch, 0.0), *rolls], dtype=np.float64)


class Evaluation(NamedTuple):
    """Aims and limits with their slopes at one point.

    Attributes:
        aims: aim of each car (members,).
        aim_slopes: derivatives of the aims with respect to the scaled variables (members, size).
        rows: scaled values of the limits (members, rows).
        row_slopes: derivatives of these values (members, rows, size).
    """

    aims: FloatArray
    aim_slopes: FloatArray
    rows: FloatArray
    row_slopes: FloatArray


@dataclass(frozen=True)
class SwerveShooting:
    """Cars with a tail at their speeds on their floors.

    Attributes:
        scenarios: scenarios of the cars; servo, controller, IMU and manoeuvre of the first apply to
            all cars.
        cars: parameters of the cars, one set per scenario.
        variables: variables of the search.
        aim: function of a `Swerve` that is maximised; returns one value per car (n,).
        limits: limits that every car must keep.
        free: numbers of the tail that are also searched; None for none.
    """

    scenarios: tuple[Scenario, ...]
    cars: VehicleParams
    variables: SwerveVariables
    aim: Measure
    limits: tuple[Limit, ...]
    free: FreeTail | None = None

    @classmethod
    def from_scenarios(
        cls,
        scenarios: Sequence[Scenario],
        aim: Measure,
        limits: Sequence[Limit] = (),
        announced: bool = False,
        free: FreeTail | None = None,
    ) -> SwerveShooting:
        """Makes the shooting of scenarios of kind `levels`, with an announced turn if asked; their
        steering and law do not matter.

        Raises:
            UserError: a car without tail, or one that the reduced car does not know; as
                `FreeTail.check`.
        """
        if not all(one.has_tail for one in scenarios):
            raise SwingError("tail.mode: none; must be a tail that can swing")
        far = min(one.tail.pitch_limit for one in scenarios)
        variables = SwerveVariables(
            len(scenarios),
            max_roll=min(one.tail.roll_limit for one in scenarios) - ROLL_MARGIN,
            pitches=(max(PITCHES[0], -far), min(PITCHES[1], far)),
            max_angle=min(one.servo.limit for one in scenarios),
            announced=announced,
            free=() if free is None else free.bounds,
        )
        if announced:
            limits = [STRAIGHT, *limits]
        if free is not None:
            free.check(scenarios)
        cars = VehicleParams.from_scenarios(scenarios)
        limits = (*STANDARD_LIMITS, *limits)
        return cls(tuple(scenarios), cars, variables, aim, limits, free)

    def free_numbers(self, x: np.ndarray) -> dict[str, Any]:
        """Returns the free numbers of the tail, by name, at scaled variables (size,), which may be
        expressions.
        """
        if self.free is None:
            return {}
        variables = self.variables
        first = variables.motion
        units = variables.units
        return {name: x[i] * units[i] for i, name in enumerate(self.free.ranges, first)}

    def scenarios_at(self, x: FloatArray) -> tuple[Scenario, ...]:
        """Returns the scenarios of the cars with their tail at scaled variables (size,)."""
        numbers = [*self.free_numbers(x).values()]
        return tuple(self._with_tail(one, numbers) for one in self.scenarios)

    def _with_tail(self, scenario: Scenario, numbers: Iterable[float]) -> Scenario:
        return self.free.build(scenario, *map(float, numbers)) if self.free else scenario

    def _cars_of(self, members: IntArray, numbers: FloatArray) -> VehicleParams:
        """Returns cars of members (n), each with its own free numbers of the tail (free, n)."""
        if self.free is None:
            return take(self.cars, members)
        columns, places = np.unique(np.vstack([members, numbers]), axis=1, return_inverse=True)
        different = [
            self._with_tail(self.scenarios[int(column[0])], column[1:]) for column in columns.T
        ]
        return take(VehicleParams.from_scenarios(different), places)

    def drive(self, own: FloatArray, members: IntArray) -> Swerve:
        """Drives swerves of members (n), each with its own scaled variables (own, n)."""
        variables = self.variables
        count = len(members)
        values = own * variables.units[variables.own(0)][:, None]
        ends = [1, variables.motion, variables.tail]
        pitch, rolls, numbers, steering = np.split(values, ends)
        rolls = np.concatenate([np.zeros((len(KNOTS) - len(rolls), count)), rolls])
        one = np.ones(count)
        gains = [gain * one for gain in FOLLOW_GAINS.values()] * 2
        knots = RollTrajectory(np.outer(KNOTS, one), rolls, knot_rates() @ rolls, *gains)
        cars = self._cars_of(members, numbers)
        first = self.scenarios[0]
        return drive_swerves(PlayedSwerve(cars, first, steering, pitch[0], knots), first)

    def at(self, x: FloatArray) -> Evaluation:
        """Evaluates aims and limits of all cars with their slopes at scaled variables (size,)."""
        variables = self.variables
        count = variables.members
        own = [variables.own(member) for member in range(count)]
        width = len(own[0])
        steps = np.full(width, DIFFERENCE_STEP)
        steps[variables.motion : variables.tail] = FREE_STEP
        tried = np.hstack([np.diag(steps), -np.diag(steps), np.zeros((width, 1))])
        columns = np.concatenate([x[places][:, None] + tried for places in own], axis=1)
        swerve = self.drive(columns, np.repeat(np.arange(count), tried.shape[1]))
        values = np.concatenate([self.aim(swerve)[None], self.rows(swerve)])
        values = values.reshape(len(values), count, tried.shape[1])
        slopes = np.zeros((count, len(values), variables.size))
        for member, places in enumerate(own):
            ahead = values[:, member, :width]
            behind = values[:, member, width:-1]
            slopes[member][:, places] = (ahead - behind) / (2.0 * steps)
        here = values[:, :, -1].T
        return Evaluation(here[:, 0], slopes[:, 0], here[:, 1:], slopes[:, 1:])

    def rows(self, swerve: Swerve) -> FloatArray:
        """Returns the scaled values of the limits of swerves (rows, n)."""
        return np.concatenate([one.function(swerve) / one.size for one in self.limits])

    @cached_property
    def row_limits(self) -> list[Limit]:
        """Limit of each row."""
        swerve = self.drive(
            np.mean(self.variables.bounds, axis=0)[self.variables.own(0)][:, None], np.zeros(1, int)
        )
        return [limit for limit in self.limits for _ in limit.function(swerve)]
