"""A rig as a pendulum with one degree of freedom, fast enough to be rolled out hundreds of times in
a fit.

inertia x acceleration = weight + air + motor - friction, about the motor axis, positive downstream.
Inertia, weight and air are those of `aerodima.workbench.rig.rig_motion`; a test compares the
acceleration with the plant's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerodima.workbench.aero.laws import SectionLaw
from aerodima.workbench.car.tail_plant import smooth_friction
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.rig.rig_motion import RigMotion
from aerodima.workbench.scenario.rig_scenario import RigScenario

Torque = Callable[[float, float], float]
"""Angle (rad) and rate (rad/s) to torque about the motor axis, N m."""
_FASTEST = 1e3
"""A rollout that turns faster than this has come apart, rad/s."""


@dataclass(frozen=True)
class Pendulum:
    """What does not change in a fit.

    Attributes:
        inertia: about the motor axis without added mass, rotor included, kg m2.
        weight_sine, weight_cosine: weight torque = sine x sin(angle) + cosine x cos(angle), N m.
        part_distances: of the five equal parts of the tail from the motor axis, m; empty for the
            bare bar.
    """

    inertia: float
    weight_sine: float
    weight_cosine: float
    part_distances: tuple[float, ...]

    @classmethod
    def of(cls, scenario: RigScenario) -> Pendulum:
        """The pendulum of a scenario."""
        motion = RigMotion.of(scenario)
        along = sum(body.mass * body.radius * math.cos(body.phase) for body in motion.bodies)
        across = sum(body.mass * body.radius * math.sin(body.phase) for body in motion.bodies)
        inertia = replace(motion, added_mass=0.0).inertia
        return cls(
            inertia, -motion.gravity * along, -motion.gravity * across, motion.added_distances
        )

    @property
    def least_added_mass(self) -> float:
        """Added mass per part that takes away all inertia, kg; what there is lies above it."""
        return -self.inertia / sum(s * s for s in self.part_distances)

    def total_inertia(self, mass_per_part: float) -> float:
        """Inertia with added mass, kg m2.

        Raises:
            FitError: it is not above zero; names the least mass that is possible.
        """
        arms = sum(s * s for s in self.part_distances)
        total = self.inertia + mass_per_part * arms
        if total <= 0.0:
            raise FitError(
                f"an added mass of {mass_per_part:.4g} kg per part takes away more inertia than "
                "there is (M + M_added "
                f"is not positive definite); it must be above {self.least_added_mass:.4g} kg"
            )
        return total


def air_torque(scenario: RigScenario, law: SectionLaw | None = None) -> Torque | None:
    """Torque of the air on tail and bar; None for the bare bar.

    Args:
        law: of the tail; that of the scenario by default.
    """
    motion = RigMotion.of(scenario)
    if not motion.blades:
        return None
    if law is not None:
        motion = replace(motion, blades=(*motion.blades[:-1], replace(motion.blades[-1], law=law)))
    air = motion.air
    return lambda angle, rate: -air(angle, rate)[3]


def friction_torque(coulomb: float, viscous: float, tanh_gain: float) -> Torque:
    """`smooth_friction` as a torque of the motion."""
    friction = smooth_friction(coulomb, viscous, tanh_gain)
    return lambda angle, rate: friction(rate)


def known_friction(scenario: RigScenario) -> Torque:
    """The friction that the scenario states for its bar, or its robot's tail."""
    known = scenario.robot_friction if scenario.is_robot else scenario.friction
    return friction_torque(known.coulomb, known.viscous, known.tanh_gain)


def runge_kutta_step(
    acceleration: Callable[[Any, Any, float], Any],
    q: Any,
    w: Any,
    step: float,
    drives: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Any, Any]:
    """Angle and rate (numbers or arrays) one step (s) on, by the classical Runge-Kutta method.

    Args:
        acceleration: of angle, rate and a drive.
        drives: at the beginning, in the middle and at the end of the step.
    """
    early, middle, late = drives
    half = 0.5 * step
    a1 = acceleration(q, w, early)
    w2 = w + half * a1
    a2 = acceleration(q + half * w, w2, middle)
    w3 = w + half * a2
    a3 = acceleration(q + half * w2, w3, middle)
    w4 = w + step * a3
    a4 = acceleration(q + step * w3, w4, late)
    return q + step / 6.0 * (w + 2.0 * (w2 + w3) + w4), w + step / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)


def roll_out(
    pendulum: Pendulum,
    torques: Sequence[Torque],
    start: tuple[float, float],
    step: float,
    count: int,
    *,
    motor: Sequence[float] | None = None,
    ramp: Sequence[float] | None = None,
    added_mass: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Angles and rates (count each) at 0, step, 2 step, ... by the classical Runge-Kutta method.

    Args:
        torques: of air, friction and a motor that reacts to the state.
        start: angle and rate.
        motor: mean torque during each step (count - 1), N m.
        ramp: its change over the step (count - 1), N m.

    Raises:
        FitError: the inertia is not above zero, or the motion comes apart.
    """
    inverse = 1.0 / pendulum.total_inertia(added_mass)
    sine = pendulum.weight_sine
    cosine = pendulum.weight_cosine

    def acceleration(q: float, w: float, drive: float) -> float:
        total = sine * math.sin(q) + cosine * math.cos(q) + drive
        for torque in torques:
            total += torque(q, w)
        return total * inverse

    q, w = start
    angles = [q]
    rates = [w]
    for i in range(count - 1):
        drive = motor[i] if motor is not None else 0.0
        rise = 0.5 * ramp[i] if ramp is not None else 0.0
        q, w = runge_kutta_step(acceleration, q, w, step, (drive - rise, drive, drive + rise))
        if not abs(w) < _FASTEST:
            raise FitError(f"the rollout comes apart after {(i + 1) * step:.3g} s")
        angles.append(q)
        rates.append(w)
    return np.array(angles), np.array(rates)


def torque_response(
    pendulum: Pendulum,
    torques: Sequence[Torque],
    motion: tuple[FloatArray, FloatArray],
    step: float,
    motor: Sequence[float],
    added_mass: float = 0.0,
    ramp: Sequence[float] | None = None,
) -> FloatArray:
    """How the angles (n) answer to one more newton metre during each step (n - 1): an n x (n - 1)
    matrix, rad / N m.

    Linear about a motion: the one-step maps are differentiated by finite differences and multiplied
    up.
    """
    angles, rates = motion
    count = len(angles)
    small = 1e-6
    steps = count - 1
    maps = np.empty((steps, 2, 2))
    for i in range(steps):
        for column, (dq, dw) in enumerate(((small, 0.0), (0.0, small))):
            start = (angles[i] + dq, rates[i] + dw)
            rise = None if ramp is None else [ramp[i]]
            moved_angles, moved_rates = roll_out(
                pendulum,
                torques,
                start,
                step,
                2,
                motor=[motor[i]],
                ramp=rise,
                added_mass=added_mass,
            )
            maps[i, 0, column] = (moved_angles[1] - angles[i + 1]) / small
            maps[i, 1, column] = (moved_rates[1] - rates[i + 1]) / small
    push = np.array([0.5 * step * step, step]) / pendulum.total_inertia(added_mass)
    response = np.zeros((count, steps))
    state = np.zeros((2, steps))
    for i in range(steps):
        state[:, :i] = maps[i] @ state[:, :i]
        state[:, i] = push
        response[i + 1] = state[0]
    return response
