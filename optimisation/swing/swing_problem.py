"""What a swing is to be found for: cars with their turns, limits, objective; and where each variable stands.

The variables, all scaled: angle, rate and acceleration of each tail joint at the knots, shared by all members of an
ensemble; per member the car's roll and roll rate and the motor torques; one parameter (tyre friction, entry speed or
peak roll). The acceleration is linear between knots, so the tail's angle is the cubic that a swing file plays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.reduced_model import motion
from aerodima.optimisation.swing.turn_profile import TurnProfile
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import SwingError
from aerodima.workbench.plants.clearance import RangeOfMotion

Objective = Literal["friction", "speed", "roll", "effort"]
OBJECTIVES: tuple[Objective, ...] = ("friction", "speed", "roll", "effort")

ANGLE, RATE, ACCELERATION, ROLL, ROLL_RATE, TORQUE = 1.0, 8.0, 80.0, 0.1, 0.5, 5.0
"""Scales of the variables: what is one unit for the solver, in rad, rad/s, rad/s2 and N m."""

Index = NDArray[np.int64]


@dataclass(frozen=True)
class ReducedMember:
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
        roll: largest roll of the car outwards, and `roll_inwards` inwards, where the reduced model ends at the latest:
            its outer wheels stay on the ground, so it holds up to the roll that unloads them (`lift_roll`).
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


class TailVariables(NamedTuple):
    """Places of a joint's variables at the knots, each (knots,)."""

    angle: Index
    rate: Index
    acceleration: Index


class CarVariables(NamedTuple):
    """Places of a member's variables at the knots: (knots,), of the torques (joints, knots)."""

    roll: Index
    rate: Index
    torque: Index


@dataclass(frozen=True)
class Layout:
    """Places of the variables: tail by joint, then members, then the parameter."""

    tail: tuple[TailVariables, ...]
    cars: tuple[CarVariables, ...]
    size: int

    @classmethod
    def of(cls, knots: int, joints: int, members: int) -> Layout:
        """For so many knots, tail joints and members."""
        size = 3 * joints * knots + members * (2 + joints) * knots + 1
        tail, cars = np.split(np.arange(size - 1), [3 * joints * knots])
        return cls(
            tuple(TailVariables(*rows) for rows in tail.reshape(joints, 3, knots)),
            tuple(CarVariables(rows[0], rows[1], rows[2:]) for rows in cars.reshape(members, 2 + joints, knots)),
            size,
        )


@dataclass(frozen=True)
class SwingProblem:
    """A swing to be found.

    Attributes:
        members: cars with their turns; the swing is shared.
        knots: times since the release, s, increasing, the first 0.
        start: angle of each joint at the release, rad: roll, or roll and pitch.
        limits: of motors, joints and car.
        objective: `friction`, `speed`: the highest that is survived; `roll`: lowest peak roll; `effort`: least torque.
        parameter_range: lowest and highest friction (1) or speed (m/s) looked at.
        wait: the tail stays at the start for this long after the release, s (a fixed trigger time); 0 leaves it free.
        smoothness: weight of the mean square of the scaled accelerations beside the objective.
        margin: weight of the mean square of the scaled car roll: of swings that survive as much, the one that leaves
            more in hand, and a motion that does not balance on two wheels, where every error grows.
        free_of: range of motion of a tail that also pitches; None does not look at the car.
    """

    members: tuple[ReducedMember, ...]
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
        return Layout.of(len(self.knots), self.joints, len(self.members))

    @property
    def parameter_scale(self) -> float:
        """Scale of the parameter."""
        return {"friction": 1.0, "speed": 5.0}.get(self.objective, ROLL)

    @cached_property
    def units(self) -> FloatArray:
        """Scale of every variable, (size,): times this, a variable is in SI units."""
        tail = [ANGLE, RATE, ACCELERATION] * self.joints
        cars = ([ROLL, ROLL_RATE] + [TORQUE] * self.joints) * len(self.members)
        return np.append(np.repeat(tail + cars, len(self.knots)), self.parameter_scale)

    def tail_motion(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle (rad), rate and acceleration of the joints at the knots, each (joints, knots)."""
        angle, rate, acceleration = np.moveaxis((x * self.units)[np.array(self.layout.tail)], 1, 0)
        return angle, rate, acceleration

    def turn(self, member: ReducedMember, curve: FloatArray, parameter: Any) -> FloatArray:
        """Inputs (..., 6) of a member's turn for a parameter in its own unit."""
        return member.profile.scaled(
            curve,
            friction=parameter * member.profile.friction if self.objective == "friction" else None,
            speed=parameter if self.objective == "speed" else None,
        )


def random_start(problem: SwingProblem, generator: np.random.Generator) -> FloatArray:
    """A swing over the top: begins, ends and stops somewhere; the pitch joint makes an arc."""
    length = float(problem.knots[-1])
    begin = generator.uniform(problem.wait, problem.wait + 0.25 * (length - problem.wait))
    duration = generator.uniform(0.3, 0.8) * (length - begin)
    phase = np.clip((problem.knots - begin) / duration, 0.0, 1.0)
    # Quintic step: rate and acceleration vanish at both ends.
    shape = phase**3 * (10 - 15 * phase + 6 * phase**2)
    slope = 30 * phase**2 * (1 - phase) ** 2 / duration
    curve = 60 * phase * (1 - phase) * (1 - 2 * phase) / duration**2
    motions = []
    for joint, start in enumerate(problem.start):
        if joint == 0:
            end = -np.sign(start or 1.0) * generator.uniform(0.3, 1.0) * problem.limits.angles[0]
        else:
            end = generator.uniform(-0.5, 0.5)
        motions.append((start + (end - start) * shape, (end - start) * slope, (end - start) * curve))
    return _start_from(problem, motions, generator.uniform(0.8, 1.1))


def _start_from(
    problem: SwingProblem, motions: list[tuple[FloatArray, FloatArray, FloatArray]], factor: float
) -> FloatArray:
    """Scaled variables for tail motions (angle, rate, acceleration by joint) with the roll of the profiles.

    `factor` is the friction or speed over that of the profile.
    """
    layout, limits = problem.layout, problem.limits
    x = np.zeros(layout.size)
    for tail, values in zip(layout.tail, motions, strict=True):
        for place, value in zip(tail, values, strict=True):
            x[place] = value
    tail_motion: Any = np.moveaxis(np.array(motions), 0, -1)
    for car, member in zip(layout.cars, problem.members, strict=True):
        roll = np.clip(np.interp(problem.knots, member.profile.time, member.profile.roll), -0.05, 0.5 * limits.roll)
        x[car.roll], x[car.rate] = roll, np.gradient(roll, problem.knots)
        _, torque = motion(roll, np.zeros_like(roll), tail_motion, member.profile.at(problem.knots), member.car)
        x[car.torque] = np.clip(torque.T, -limits.torque, limits.torque)
    own = {"friction": factor, "speed": factor * problem.members[0].profile.speed, "roll": 0.5 * limits.roll}
    x[-1] = own.get(problem.objective, 0.0)
    return x / problem.units
