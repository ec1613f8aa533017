"""The swing as a nonlinear programme: Hermite-Simpson collocation of the car's roll under a prescribed tail motion.

The tail's part is exact and linear. The car's roll is collocated with Hermite-Simpson; its model is evaluated for all
knots, all midpoints and all complex steps of the Jacobian at once. `bounds`, `constraints` and `cost` are the whole
problem; each constraint is a `Block` that knows which variables it takes and what a violation is called.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from aerodima.optimisation.swing.reduced_car import lift_roll
from aerodima.optimisation.swing.reduced_model import COMPLEX_STEP, motion, tip_height
from aerodima.optimisation.swing.swing_problem import (
    ACCELERATION,
    ANGLE,
    RATE,
    ROLL,
    ROLL_RATE,
    TORQUE,
    CarVariables,
    Index,
    ReducedMember,
    SwingProblem,
)
from aerodima.workbench.config.array_types import FloatArray

CAR_PARTS = ("cage", "deck", "wheels")
"""What of the car the tail must not touch."""
JOINTS = ("roll", "pitch")
HEIGHT = 0.1
"""Scale of clearances, m."""
Slopes = tuple[FloatArray, FloatArray]
"""Values (rows,) and their slopes (rows, k) with the k variables that each row takes."""


class Rows(NamedTuple):
    """Rows of one kind: lower <= value <= upper.

    Args:
        name, unit: what a violation is called; `size` of one scaled unit.
        columns: variables that each row takes, (rows, k); lower, upper: (rows,), in the unit.
    """

    name: str
    unit: str
    size: float
    columns: Index
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True)
class Block:
    """Constraints that are evaluated together.

    Args:
        rows: what they are.
        values: of the variables in SI units (n,), one entry for each of `rows`.
        units: of the variables, (n,).
        linear: the slopes are the same everywhere.
    """

    rows: tuple[Rows, ...]
    values: Callable[[FloatArray], Sequence[Slopes]]
    units: FloatArray
    linear: bool = False

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Scaled, (m,) each."""
        lower, upper = (np.concatenate([getattr(r, end) / r.size for r in self.rows]) for end in ("lower", "upper"))
        return lower, upper

    @property
    def pattern(self) -> tuple[Index, Index]:
        """Rows and columns of the entries of the Jacobian that may differ from zero."""
        places = [np.indices(r.columns.shape)[0] for r in self.rows]
        begins = np.cumsum([0, *(len(r.columns) for r in self.rows[:-1])])
        row = [(place + begin).ravel() for place, begin in zip(places, begins, strict=True)]
        return np.concatenate(row), np.concatenate([r.columns.ravel() for r in self.rows])

    def at(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scaled values (m,) and their slopes with the scaled variables, in the order of `pattern`."""
        values, entries = [], []
        for rows, (value, slopes) in zip(self.rows, self.values(x * self.units), strict=True):
            values.append(value / rows.size)
            entries.append((slopes * self.units[rows.columns] / rows.size).ravel())
        return np.concatenate(values), np.concatenate(entries)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Of the scaled values with all scaled variables, (m, n)."""
        found = np.zeros((len(self.bounds[0]), len(x)))
        found[self.pattern] = self.at(x)[1]
        return found


def constraints(problem: SwingProblem) -> list[Block]:
    """The whole problem beside its bounds and its cost."""
    layout, limits, h = problem.layout, problem.limits, np.diff(problem.knots)
    found = []
    for joint, (name, (angle, rate, acceleration)) in enumerate(zip(JOINTS, layout.tail, strict=False)):
        found += [
            _linear(
                problem, f"tail {name} rate defect", "rad/s", RATE, 0.0, 0.0,
                (1.0, rate[1:]), (-1.0, rate[:-1]), (-h / 2, acceleration[1:]), (-h / 2, acceleration[:-1]),
            ),
            _linear(
                problem, f"tail {name} angle defect", "rad", ANGLE, 0.0, 0.0, (1.0, angle[1:]), (-1.0, angle[:-1]),
                (-h, rate[:-1]), (-(h**2) / 3, acceleration[:-1]), (-(h**2) / 6, acceleration[1:]),
            ),
            # The cubic between two knots on a stop may bulge beyond it: the middle keeps to the range too.
            _linear(
                problem, f"tail {name} angle between knots", "rad", ANGLE, -limits.angles[joint], limits.angles[joint],
                (0.5, angle[1:]), (0.5, angle[:-1]), (h / 8, rate[:-1]), (-h / 8, rate[1:]),
            ),
        ]  # fmt: skip
        for car in layout.cars:
            most, torque = limits.torque_rate * h, car.torque[joint]
            words = f"change of the tail {name} torque"
            found.append(_linear(problem, words, "N m", TORQUE, -most, most, (1.0, torque[1:]), (-1.0, torque[:-1])))
    if problem.objective == "roll":
        peak = np.full(len(problem.knots), layout.size - 1)
        for car in layout.cars:
            words = "car roll below its peak"
            found.append(_linear(problem, words, "rad", ROLL, -np.inf, 0.0, (1.0, car.roll), (-1.0, peak)))
    for member, car in zip(problem.members, layout.cars, strict=True):
        found += [_Dynamics(problem, member, car).block(), _above_ground(problem, member, car)]
        if problem.free_of is not None and car is layout.cars[0]:
            found.append(_free_of_car(problem))
    return found


def bounds(problem: SwingProblem) -> list[Rows]:
    """Bounds of every variable: in rows of one column."""
    layout, limits, knots = problem.layout, problem.limits, len(problem.knots)
    waiting, last = problem.knots <= problem.wait + 1e-12, np.arange(knots) == knots - 1
    resting = last | (waiting & np.append(waiting[1:], False))  # the acceleration may jump when the wait ends
    found: list[Rows] = []

    def bound(
        name: str, unit: str, size: float, index: Index, low: float, high: float, *fixed: tuple[Any, float, float]
    ) -> None:
        lower, upper = np.full(len(index), low), np.full(len(index), high)
        for places, least, most in fixed:
            lower[places], upper[places] = least, most
        found.append(Rows(name, unit, size, index[:, None], lower, upper))

    for joint, (name, tail) in enumerate(zip(JOINTS, layout.tail, strict=False)):
        most, start = limits.angles[joint], problem.start[joint]
        bound(f"tail {name} angle", "rad", ANGLE, tail.angle, -most, most, (waiting, start, start))
        most = limits.tail_rate
        bound(f"tail {name} rate", "rad/s", RATE, tail.rate, -most, most, (waiting | last, 0.0, 0.0))
        words = f"tail {name} acceleration"
        bound(words, "rad/s2", ACCELERATION, tail.acceleration, -np.inf, np.inf, (resting, 0.0, 0.0))
    for member, car in zip(problem.members, layout.cars, strict=True):
        roll, rate = member.profile.state_at(0.0)
        inwards = -min(limits.roll_inwards, lift_roll(member.car))  # beyond it the outer wheels have left the ground
        end = (inwards, min(limits.roll, limits.end_roll))
        bound("car roll", "rad", ROLL, car.roll, inwards, limits.roll, (0, roll, roll), (-1, *end))
        end = (-limits.end_roll_rate, limits.end_roll_rate)
        bound("car roll rate", "rad/s", ROLL_RATE, car.rate, -10.0, 10.0, (0, rate, rate), (-1, *end))
        for name, torque in zip(JOINTS, car.torque, strict=False):
            bound(f"tail {name} torque", "N m", TORQUE, torque, -limits.torque, limits.torque)
    unit = {"friction": "1", "speed": "m/s"}.get(problem.objective, "rad")
    free = {"roll": (0.0, limits.roll), "effort": (0.0, 0.0)}.get(problem.objective, problem.parameter_range)
    bound(problem.objective, unit, problem.parameter_scale, np.array([layout.size - 1]), *free)
    return found


def cost(problem: SwingProblem) -> tuple[FloatArray, FloatArray]:
    """Weights of every scaled variable and of its square, (n,) each."""
    layout, knots = problem.layout, len(problem.knots)
    linear, squares = np.zeros(layout.size), np.zeros(layout.size)
    linear[-1] = {"friction": -1.0, "speed": -1.0, "roll": 1.0}.get(problem.objective, 0.0)
    for tail in layout.tail:
        squares[tail.acceleration] = problem.smoothness / knots
    for car in layout.cars:
        squares[car.roll] = problem.margin / (len(layout.cars) * knots)
        if problem.objective == "effort":
            squares[car.torque] = 1.0 / (len(layout.cars) * knots)
    return linear, squares


def _linear(
    problem: SwingProblem, name: str, unit: str, size: float, lower: Any, upper: Any, *terms: tuple[Any, Index]
) -> Block:
    """Rows of lower <= sum of coefficient x variable <= upper."""
    index = np.column_stack([place for _, place in terms])
    coefficients = np.column_stack([np.broadcast_to(coefficient, len(index)) for coefficient, _ in terms])
    low, high = (np.broadcast_to(end, len(index)).astype(float) for end in (lower, upper))
    rows = Rows(name, unit, size, index, low, high)
    return Block(
        (rows,), lambda z: [(np.sum(coefficients * z[index], axis=1), coefficients)], problem.units, linear=True
    )


class _Dynamics:
    """Defects of a car's roll and roll rate over every interval, and the torques that the tail motion asks for.

    What the model takes at each knot are its arguments: roll, roll rate, angles, rates and accelerations of the tail,
    parameter. It is asked twice, for all knots and for all midpoints; the rest of the slopes is the chain rule.
    """

    def __init__(self, problem: SwingProblem, member: ReducedMember, car: CarVariables) -> None:
        self._problem, self._member, self._car = problem, member, car
        knots, joints = problem.knots, problem.joints
        tail = np.moveaxis(np.array(problem.layout.tail), 1, 0).reshape(3 * joints, -1)
        self._columns = np.column_stack([car.roll, car.rate, *tail, np.full(len(knots), problem.layout.size - 1)])
        self._curves = [member.profile.curve(time) for time in (knots, 0.5 * (knots[1:] + knots[:-1]))]
        width = self._columns.shape[1]
        self._rates = np.eye(width, k=joints)  # time derivative of an argument that has one among the others
        self._rates[0], self._rates[1], self._rates[2 + 2 * joints :] = np.eye(width)[1], 0.0, 0.0

    def block(self) -> Block:
        """The constraint."""
        both = np.column_stack([self._columns[:-1, :-1], self._columns[1:]])
        zero, still = np.zeros(len(both)), np.zeros(len(self._columns))
        rows = [Rows("car roll defect", "rad", ROLL, both, zero, zero)]
        rows.append(Rows("car roll-rate defect", "rad/s", ROLL_RATE, both, zero, zero))
        for name, places in zip(JOINTS, self._car.torque, strict=False):
            columns = np.column_stack([places, self._columns])
            rows.append(Rows(f"tail {name} torque", "N m", TORQUE, columns, still, still))
        return Block(tuple(rows), self._values, self._problem.units)

    def _values(self, z: FloatArray) -> list[Slopes]:
        knots, h = z[self._columns], np.diff(self._problem.knots)[:, None]
        (g, *asked), (dg, *dasked) = self._model(knots, self._curves[0])
        rates = knots @ self._rates.T
        rates[:, 1] = g
        middle = 0.5 * (knots[1:] + knots[:-1]) - h / 8 * np.diff(rates, axis=0)
        (gm, *_), (dgm, *_) = self._model(middle, self._curves[1])
        between = np.column_stack([middle[:, 1], gm])
        defects = np.diff(knots[:, :2], axis=0) - h / 6 * (rates[:-1, :2] + 4 * between + rates[1:, :2])
        # Slopes of gm with both ends of its interval: those of the midpoint are 0.5 +- h/8 of the rates' slopes.
        along, by_rate = dgm @ self._rates, dgm[:, 1:2]
        first = 0.5 * dgm + h / 8 * (along + by_rate * dg[:-1])
        last = 0.5 * dgm - h / 8 * (along + by_rate * dg[1:])
        roll, rate = np.eye(knots.shape[1])[:2]
        slopes_of = [
            _ends(-roll - h / 2 * rate - h**2 / 12 * dg[:-1], roll - h / 2 * rate + h**2 / 12 * dg[1:]),
            _ends(-rate - h / 6 * (dg[:-1] + 4 * first), rate - h / 6 * (dg[1:] + 4 * last)),
        ]
        pieces = list(zip(defects.T, slopes_of, strict=True))
        for places, value, slopes in zip(self._car.torque, asked, dasked, strict=True):
            pieces.append((z[places] - value, np.column_stack([np.ones(len(value)), -slopes])))
        return pieces

    def _model(self, arguments: FloatArray, curve: FloatArray) -> Slopes:
        """Roll acceleration and torques (1 + joints, points), and their slopes (1 + joints, points, arguments)."""
        joints = self._problem.joints

        def values(moved: Any) -> Any:
            tail: Any = tuple(moved[..., 2 + k * joints : 2 + (k + 1) * joints] for k in range(3))
            inputs = self._problem.turn(self._member, curve, moved[..., -1])
            acceleration, torques = motion(moved[..., 0], moved[..., 1], tail, inputs, self._member.car)
            return np.concatenate([acceleration[..., None], torques], axis=-1)

        value, slopes = _with_slopes(values, arguments)
        return value.T, np.moveaxis(slopes, 1, 0)


def _ends(first: FloatArray, last: FloatArray) -> FloatArray:
    """Slopes with the arguments of both ends of the intervals, which have the same parameter."""
    return np.column_stack([first[:, :-1], last[:, :-1], first[:, -1] + last[:, -1]])


def _above_ground(problem: SwingProblem, member: ReducedMember, car: CarVariables) -> Block:
    """Height of the tail's tip over the ground at the knots."""
    index = np.column_stack([car.roll, *(tail.angle for tail in problem.layout.tail)])
    return _clearance(
        problem, "height of the tail's tip", problem.limits.clearance, index,
        lambda moved: tip_height(moved[..., 0], moved[..., 1:], member.car),
    )  # fmt: skip


def _free_of_car(problem: SwingProblem) -> Block:
    """Distance of the tail from the car at the knots."""
    free_of, index = problem.free_of, np.column_stack([tail.angle for tail in problem.layout.tail])
    assert free_of is not None
    return _clearance(
        problem, "distance of the tail from the car", problem.limits.car_clearance, index,
        lambda moved: free_of.clearance(moved[..., 1], moved[..., 0], CAR_PARTS),
    )  # fmt: skip


def _clearance(problem: SwingProblem, name: str, least: float, index: Index, distance: Callable[[Any], Any]) -> Block:
    low = np.append(-np.inf, np.full(len(index) - 1, least))  # no choice of the swing can change the rest position
    rows = Rows(name, "m", HEIGHT, index, low, np.full(len(index), np.inf))
    return Block((rows,), lambda z: [_with_slopes(distance, z[index])], problem.units)


def _with_slopes(function: Callable[[Any], Any], z: FloatArray) -> Slopes:
    """Values (points, ...) of a function of (..., points, k), and slopes (points, ..., k) by complex steps."""
    found = function(z + 1j * COMPLEX_STEP * np.eye(z.shape[1])[:, None])
    return found[0].real, np.moveaxis(found.imag / COMPLEX_STEP, 0, -1)
