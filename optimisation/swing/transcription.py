"""The swing as a nonlinear programme: Hermite-Simpson collocation of the car's roll under a told tail motion.

Decision variables, all scaled: angle, rate and acceleration of each tail joint at the knots, shared by all members of
an ensemble; per member the car's roll and roll rate and the motor torques; one parameter (tyre friction, entry speed or
peak roll). The acceleration is linear between knots, so the tail's part is exact and linear, and its angle is the cubic
that a swing file plays. The car's roll is collocated with Hermite-Simpson; its model is evaluated for all knots, all
midpoints and all complex steps of the Jacobian at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.turn_profile import TurnProfile
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import SwingError
from aerodima.workbench.plants.clearance import RangeOfMotion

Objective = Literal["friction", "speed", "roll", "effort"]
OBJECTIVES: tuple[Objective, ...] = ("friction", "speed", "roll", "effort")

COMPLEX_STEP = 1e-30
CAR_PARTS = ("cage", "deck", "wheels")
"""What of the car the tail must not touch."""
ANGLE, RATE, ACCELERATION, ROLL, ROLL_RATE, TORQUE = 1.0, 8.0, 80.0, 0.1, 0.5, 5.0
"""Scales of the variables: what is one unit for the solver, in rad, rad/s, rad/s2 and N m."""


class ReducedModel(Protocol):
    """A reduced model: `planar_model`, `spatial_model`."""

    def motion(
        self, roll: Any, roll_rate: Any, tail: tuple[Any, Any, Any], inputs: Any, car: ReducedCar
    ) -> tuple[Any, Any]:
        """Roll acceleration (...) and motor torques (..., joints)."""

    def tip_height(self, roll: Any, angles: Any, car: ReducedCar) -> Any:
        """Height of the tail's lowest point (...), m."""


@dataclass(frozen=True)
class Member:
    """One car of the programme with the turn that it drives."""

    car: ReducedCar
    profile: TurnProfile


@dataclass(frozen=True)
class SwingLimits:
    """What the swing must keep to; angles rad, rates rad/s, torques N m, lengths m.

    Attributes:
        torque: of each motor.
        torque_rate: change of the torque, N m/s.
        tail_rate: joint rate at which a motor still gives its full torque.
        angles: range of each joint to either side.
        clearance: of the tail above the ground; `car_clearance` of it from the car.
        roll: largest roll of the car outwards, and `roll_inwards` inwards.
        end_roll, end_roll_rate: at the last knot.
    """

    torque: float
    tail_rate: float
    angles: tuple[float, ...]
    torque_rate: float = 1500.0
    clearance: float = 0.05
    car_clearance: float = 0.01
    roll: float = 0.25
    roll_inwards: float = 0.25
    end_roll: float = 0.06
    end_roll_rate: float = 0.6

    @classmethod
    def of(cls, car: ReducedCar, joints: int, torque: float | None = None, **changes: Any) -> SwingLimits:
        """Limits of a car's motors and joints; a smaller torque may be asked for.

        Raises:
            SwingError: torque not above zero or above the motor's.
        """
        most = car.torque_limit if torque is None else torque
        if not 0.0 < most <= car.torque_limit:
            raise SwingError(
                f"torque limit: {most:g} N m; allowed: above 0, up to the motor's {car.torque_limit:g} N m"
            )
        rate = car.no_load_speed * (1.0 - most / car.stall_torque)
        return cls(most, rate, (car.roll_limit, car.pitch_limit)[:joints], **changes)


@dataclass(frozen=True)
class Problem:
    """A swing to be found.

    Attributes:
        model: reduced model.
        members: cars with their turns; the swing is shared.
        knots: times since the release, s, increasing, the first 0.
        start: angle of each joint at the release, rad.
        limits: of motors, joints and car.
        objective: `friction`, `speed`: the highest that is survived; `roll`: lowest peak roll; `effort`: least torque.
        parameter_range: lowest and highest friction (1) or speed (m/s) looked at.
        wait: the tail stays at the start for this long after the release, s (a fixed trigger time); 0 leaves it free.
        smoothness: weight of the mean square of the scaled accelerations beside the objective.
        margin: weight of the mean square of the scaled car roll: of swings that survive as much, the one that leaves
            more in hand, and a motion that does not balance on two wheels, where every error grows.
        free_of: range of motion of a tail that also pitches; None does not look at the car.
    """

    model: ReducedModel
    members: tuple[Member, ...]
    knots: FloatArray
    start: tuple[float, ...]
    limits: SwingLimits
    objective: Objective = "friction"
    parameter_range: tuple[float, float] = (0.2, 1.6)
    wait: float = 0.0
    smoothness: float = 0.02
    margin: float = 0.05
    free_of: RangeOfMotion | None = None

    @property
    def joints(self) -> int:
        """Tail joints that move."""
        return len(self.start)

    @cached_property
    def layout(self) -> Layout:
        """Where each variable stands."""
        return Layout(len(self.knots), self.joints, len(self.members))

    @property
    def parameter_scale(self) -> float:
        """Scale of the parameter."""
        return {"friction": 1.0, "speed": 5.0}.get(self.objective, ROLL)


class Layout(NamedTuple):
    """Order of the scaled variables: tail by joint, then members, then the parameter."""

    knots: int
    joints: int
    members: int

    @property
    def size(self) -> int:
        """Number of variables."""
        return 3 * self.joints * self.knots + self.members * (2 + self.joints) * self.knots + 1

    def tail(self, joint: int, order: int) -> slice:
        """Angle (0), rate (1) or acceleration (2) of a joint."""
        begin = (3 * joint + order) * self.knots
        return slice(begin, begin + self.knots)

    def member(self, number: int, part: int) -> slice:
        """Roll (0), roll rate (1), torque of joint j (2 + j) of a member."""
        begin = (3 * self.joints + number * (2 + self.joints) + part) * self.knots
        return slice(begin, begin + self.knots)

    @property
    def scale(self) -> FloatArray:
        """Units of the variables without the parameter (its scale depends on the objective)."""
        tail = np.repeat([ANGLE, RATE, ACCELERATION] * self.joints, self.knots)
        own = np.repeat(([ROLL, ROLL_RATE] + [TORQUE] * self.joints) * self.members, self.knots)
        return np.concatenate([tail, own, [1.0]])

    def arguments(self, number: int) -> NDArray[np.int64]:
        """Indices (knots, 2 + 3 joints) of what the model of a member depends on at each knot, without parameter."""
        every = np.arange(self.size)
        columns = [every[self.member(number, 0)], every[self.member(number, 1)]]
        columns += [every[self.tail(joint, order)] for order in range(3) for joint in range(self.joints)]
        return np.column_stack(columns)


class Block(NamedTuple):
    """Rows of constraints of one kind: lower <= function(x) <= upper.

    Args:
        name, unit: what a violation is called, and `size` what one scaled unit is.
        function: scaled variables (n,) to values (m,) and Jacobian (m, n), of the scaled variables.
        lower, upper: (m,).
        pattern: non-zero entries (row, column) of the Jacobian.
        labels: (name, unit, size) of each row.
    """

    function: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    lower: FloatArray
    upper: FloatArray
    pattern: list[tuple[int, int]]
    labels: list[tuple[str, str, float]]


@dataclass(frozen=True)
class Collocation:
    """Evaluates one member's constraints: roll defects, roll-rate defects, torque equations, clearance."""

    problem: Problem
    number: int
    step: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "step", np.diff(self.problem.knots))

    @cached_property
    def _member(self) -> Member:
        return self.problem.members[self.number]

    @cached_property
    def _curves(self) -> tuple[FloatArray, FloatArray]:
        knots = self.problem.knots
        profile = self._member.profile
        return profile.curve(knots), profile.curve(0.5 * (knots[1:] + knots[:-1]))

    @cached_property
    def _scale(self) -> FloatArray:
        return np.concatenate(
            [[ROLL, ROLL_RATE], *([value] * self.problem.joints for value in (ANGLE, RATE, ACCELERATION))]
        )

    def _evaluate(self, arguments: FloatArray, parameter: float, curve: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Roll acceleration and torques (points, 1 + joints) and their slopes (points, 1 + joints, arguments + 1)."""
        width = arguments.shape[1]
        moved = np.tile(arguments.astype(complex), (width + 1, 1, 1))
        for column in range(width):
            moved[column, :, column] += 1j * COMPLEX_STEP
        parameters = np.full(width + 1, parameter, dtype=complex)
        parameters[width] += 1j * COMPLEX_STEP
        values = self._model(moved, parameters[:, None], curve)
        return values[0].real, np.moveaxis(values.imag / COMPLEX_STEP, 0, -1)

    def _model(self, arguments: Any, parameter: Any, curve: FloatArray) -> Any:
        problem, member, joints = self.problem, self._member, self.problem.joints
        inputs = member.profile.scaled(
            curve,
            friction=parameter * member.profile.friction if problem.objective == "friction" else None,
            speed=parameter if problem.objective == "speed" else None,
        )
        tail = tuple(arguments[..., 2 + k * joints : 2 + (k + 1) * joints] for k in range(3))
        acceleration, torque = problem.model.motion(arguments[..., 0], arguments[..., 1], tail, inputs, member.car)
        return np.concatenate([acceleration[..., None], torque], axis=-1)

    def dynamics(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scaled residuals (2 intervals + joints knots,) and Jacobian: roll, roll rate, then torques by joint."""
        layout, joints = self.problem.layout, self.problem.joints
        index, unit = layout.arguments(self.number), self._scale
        z = x[index] * unit
        parameter = float(x[-1] * self.problem.parameter_scale)
        at_knots, slopes = self._evaluate(z, parameter, self._curves[0])
        g, G = at_knots[:, 0], slopes[:, 0]
        h = self.step
        g0, g1, z0, z1 = g[:-1], g[1:], z[:-1], z[1:]
        middle, T0, T1 = self._midpoint(z0, z1, g0, g1)
        at_middle, middle_slopes = self._evaluate(middle, parameter, self._curves[1])
        gm, Gm = at_middle[:, 0], middle_slopes[:, 0]
        width = z.shape[1]
        # Total slopes of the midpoint's roll rate and acceleration with the two knots and the parameter.
        lean = h[:, None] / 8
        rate0, rate1 = T0[:, 1] + lean * G[:-1, :width], T1[:, 1] - lean * G[1:, :width]
        rate_p = lean[:, 0] * (G[:-1, width] - G[1:, width])
        through = Gm[:, 1, None]
        gm0 = np.einsum("ik,ikl->il", Gm[:, :width], T0) + through * (rate0 - T0[:, 1])
        gm1 = np.einsum("ik,ikl->il", Gm[:, :width], T1) + through * (rate1 - T1[:, 1])
        gm_p = Gm[:, width] + Gm[:, 1] * rate_p
        unit_roll, unit_rate = np.eye(width)[0], np.eye(width)[1]
        sixth = h[:, None] / 6
        roll = z1[:, 0] - z0[:, 0] - h / 6 * (z0[:, 1] + 4 * middle[:, 1] + z1[:, 1])
        rate = z1[:, 1] - z0[:, 1] - h / 6 * (g0 + 4 * gm + g1)
        d_roll0 = -unit_roll - sixth * (unit_rate + 4 * rate0)
        d_roll1 = unit_roll - sixth * (unit_rate + 4 * rate1)
        d_rate0 = -unit_rate - sixth * (G[:-1, :width] + 4 * gm0)
        d_rate1 = unit_rate - sixth * (G[1:, :width] + 4 * gm1)
        d_roll_p, d_rate_p = -h / 6 * 4 * rate_p, -h / 6 * (G[:-1, width] + 4 * gm_p + G[1:, width])

        n, knots = len(h), len(z)
        residual = np.empty(2 * n + joints * knots)
        jacobian = np.zeros((len(residual), layout.size))
        pieces = ((roll, d_roll0, d_roll1, d_roll_p, ROLL), (rate, d_rate0, d_rate1, d_rate_p, ROLL_RATE))
        for piece, (value, left, right, by_parameter, size) in enumerate(pieces):
            rows = np.arange(piece * n, (piece + 1) * n)
            residual[rows] = value / size
            jacobian[rows[:, None], index[:-1]] += left * unit / size
            jacobian[rows[:, None], index[1:]] += right * unit / size
            jacobian[rows, -1] = by_parameter * self.problem.parameter_scale / size
        for joint in range(joints):
            rows = np.arange(2 * n + joint * knots, 2 * n + (joint + 1) * knots)
            held = np.arange(layout.size)[layout.member(self.number, 2 + joint)]
            residual[rows] = x[held] - at_knots[:, 1 + joint] / TORQUE
            jacobian[rows[:, None], index] = -slopes[:, 1 + joint, :width] * unit / TORQUE
            jacobian[rows, -1] = -slopes[:, 1 + joint, width] * self.problem.parameter_scale / TORQUE
            jacobian[rows, held] = 1.0
        return residual, jacobian

    def _midpoint(
        self, z0: FloatArray, z1: FloatArray, g0: FloatArray, g1: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Hermite midpoint (intervals, arguments) and its explicit slopes with both knots."""
        joints, width, h = self.problem.joints, z0.shape[1], self.step
        half = np.tile(0.5 * np.eye(width), (len(h), 1, 1))
        T0, T1 = half.copy(), half.copy()
        pairs = [(0, 1)] + [(2 + k, 2 + joints + k) for k in range(2 * joints)]
        for value, slope in pairs:
            T0[:, value, slope] += h / 8
            T1[:, value, slope] -= h / 8
        middle = np.einsum("ikl,il->ik", T0, z0) + np.einsum("ikl,il->ik", T1, z1)
        middle[:, 1] += h / 8 * (g0 - g1)
        return middle, T0, T1

    def clearance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height of the tail at the knots over its limit, in units of 0.1 m, and its Jacobian."""
        layout, joints = self.problem.layout, self.problem.joints
        index = layout.arguments(self.number)[:, [0, *range(2, 2 + joints)]]
        unit = self._scale[[0, *range(2, 2 + joints)]]
        z = (x[index] * unit).astype(complex)
        moved = np.tile(z, (z.shape[1], 1, 1))
        for column in range(z.shape[1]):
            moved[column, :, column] += 1j * COMPLEX_STEP
        heights = self.problem.model.tip_height(moved[..., 0], moved[..., 1:], self._member.car)
        jacobian = np.zeros((len(z), layout.size))
        jacobian[np.arange(len(z))[:, None], index] = heights.imag.T / COMPLEX_STEP * unit / 0.1
        return heights[0].real / 0.1, jacobian

    def car_clearance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance of the tail from the car at the knots, in units of 0.1 m, and its Jacobian."""
        free_of, layout = self.problem.free_of, self.problem.layout
        assert free_of is not None
        every = np.arange(layout.size)
        index = np.column_stack([every[layout.tail(joint, 0)] for joint in (0, 1)])
        moved = np.tile((x[index] * ANGLE).astype(complex), (2, 1, 1))
        for joint in range(2):
            moved[joint, :, joint] += 1j * COMPLEX_STEP
        distance = free_of.clearance(moved[..., 1], moved[..., 0], CAR_PARTS)
        jacobian = np.zeros((layout.knots, layout.size))
        jacobian[np.arange(layout.knots)[:, None], index] = distance.imag.T / COMPLEX_STEP * ANGLE / 0.1
        return distance[0].real / 0.1, jacobian

    def blocks(self) -> list[Block]:
        """The member's nonlinear constraints."""
        problem, layout = self.problem, self.problem.layout
        n, knots, joints = len(self.step), layout.knots, problem.joints
        index = layout.arguments(self.number)
        pattern: list[tuple[int, int]] = []
        for row in range(2 * n):
            columns = np.union1d(index[row % n], index[row % n + 1])
            pattern += [(row, int(column)) for column in (*columns, layout.size - 1)]
        for joint in range(joints):
            held = np.arange(layout.size)[layout.member(self.number, 2 + joint)]
            for knot in range(knots):
                row = 2 * n + joint * knots + knot
                pattern += [(row, int(column)) for column in (*index[knot], held[knot], layout.size - 1)]
        labels = [("car roll defect", "rad", ROLL)] * n + [("car roll-rate defect", "rad/s", ROLL_RATE)] * n
        names = ("tail roll torque", "tail pitch torque")
        labels += [(names[joint], "N m", TORQUE) for joint in range(joints) for _ in range(knots)]
        zero = np.zeros(2 * n + joints * knots)
        ground = [(k, int(c)) for k in range(knots) for c in index[k, [0, *range(2, 2 + joints)]]]
        low = np.full(knots, problem.limits.clearance / 0.1)
        # The first knot is the rest position, which no choice of the swing can change.
        low[0] = -np.inf
        blocks = [
            Block(self.dynamics, zero, zero, pattern, labels),
            Block(
                self.clearance, low, np.full(knots, np.inf), ground, [("height of the tail's tip", "m", 0.1)] * knots
            ),
        ]
        if problem.free_of is not None and self.number == 0:
            near = np.full(knots, problem.limits.car_clearance / 0.1)
            near[0] = -np.inf
            path = [(k, int(layout.tail(joint, 0).start) + k) for k in range(knots) for joint in (0, 1)]
            said = [("distance of the tail from the car", "m", 0.1)] * knots
            blocks.append(Block(self.car_clearance, near, np.full(knots, np.inf), path, said))
        return blocks


def gradient_error(block: Block, x: FloatArray, step: float = 1e-6) -> float:
    """Largest difference between a block's Jacobian and central differences, relative to its largest entry.

    Also counts entries outside the block's pattern.
    """
    _, jacobian = block.function(x)
    measured = np.empty_like(jacobian)
    for column in range(len(x)):
        moved = np.zeros(len(x))
        moved[column] = step
        measured[:, column] = (block.function(x + moved)[0] - block.function(x - moved)[0]) / (2 * step)
    outside = jacobian.copy()
    rows, columns = zip(*block.pattern, strict=True)
    outside[list(rows), list(columns)] = 0.0
    return float(max(np.abs(measured - jacobian).max(), np.abs(outside).max()) / max(1.0, np.abs(jacobian).max()))


def uniform_knots(length: float, number: int) -> FloatArray:
    """Times of `number` evenly spaced knots from 0 to `length`, s."""
    return np.linspace(0.0, length, number)


def members_of(cars: Sequence[ReducedCar], profiles: Sequence[TurnProfile]) -> tuple[Member, ...]:
    """Members of a programme."""
    return tuple(Member(car, profile) for car, profile in zip(cars, profiles, strict=True))
