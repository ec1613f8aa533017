"""A swing of the pendulum over time, and how it answers to the torque of its motor."""

from collections.abc import Sequence

import numpy as np

from aerodima.workbench.core.array_types import ArrayPair, FloatArray, Pair
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.rig.pendulum import Motion, PendulumModel, Torque, equation_of_motion

MAX_RATE = 1e3
"""A simulated swing that turns faster than this has diverged, rad/s."""
_DIFFERENCE = 1e-6
"""Step of finite differences over angle (rad) and rate (rad/s)."""


def runge_kutta_step(
    motion: Motion, q: float, w: float, step: float, motor: float, rise: float
) -> Pair:
    """Returns angle and rate one step (s) later, by the classical Runge-Kutta method.

    Args:
        motion: acceleration as a function of angle, rate and motor torque.
        q, w: angle (rad) and rate (rad/s) at the beginning of the step.
        motor: mean torque during the step, N m.
        rise: change of that torque over the step, N m.
    """
    half = 0.5 * step
    a1 = motion(q, w, motor - 0.5 * rise)
    w2 = w + half * a1
    a2 = motion(q + half * w, w2, motor)
    w3 = w + half * a2
    a3 = motion(q + half * w2, w3, motor)
    w4 = w + step * a3
    a4 = motion(q + step * w3, w4, motor + 0.5 * rise)
    mean_rate = w + 2.0 * (w2 + w3) + w4
    mean_acceleration = a1 + 2.0 * (a2 + a3) + a4
    return q + step / 6.0 * mean_rate, w + step / 6.0 * mean_acceleration


def simulate_swing(
    pendulum: PendulumModel,
    torques: Sequence[Torque],
    start: Pair,
    step: float,
    count: int,
    *,
    motor: Sequence[float] | None = None,
    ramp: Sequence[float] | None = None,
    added_mass: float = 0.0,
) -> ArrayPair:
    """Simulates a swing; returns angles and rates (count each) at 0, step, 2 step, ... s.

    Args:
        pendulum: pendulum that swings.
        torques: torques of air, friction and a motor that reacts to the state.
        start: angle, rad, and rate, rad/s, at the beginning.
        step: length of a step, s.
        count: number of instants.
        motor: mean torque of the motor during each step (count - 1), N m.
        ramp: change of that torque over each step (count - 1), N m.
        added_mass: added mass of each part, kg.

    Raises:
        FitError: the inertia is not above zero, or the motion diverges.
    """
    motion = equation_of_motion(pendulum, torques, added_mass)
    none = [0.0] * (count - 1)
    angles = [start[0]]
    rates = [start[1]]
    for drive, rise, _ in zip(motor or none, ramp or none, none, strict=False):
        q, w = runge_kutta_step(motion, angles[-1], rates[-1], step, drive, rise)
        if not abs(w) < MAX_RATE:
            raise FitError(f"the simulated swing diverges after {len(angles) * step:.3g} s")
        angles.append(q)
        rates.append(w)
    return np.array(angles), np.array(rates)


def torque_response(
    pendulum: PendulumModel,
    torques: Sequence[Torque],
    motion: ArrayPair,
    step: float,
    motor: Sequence[float],
    added_mass: float = 0.0,
    ramp: Sequence[float] | None = None,
) -> FloatArray:
    """Differentiates the angles (n) by the torque during each step (n - 1): an n x (n - 1) matrix,
    rad / N m.

    The response is linearised about a motion: the one-step maps are differentiated by finite
    differences and multiplied up.
    """
    equation = equation_of_motion(pendulum, torques, added_mass)
    states = np.array(motion).T
    steps = len(states) - 1
    rises = ramp or [0.0] * steps
    push = np.array([0.5 * step * step, step]) / pendulum.total_inertia(added_mass)
    response = np.zeros((steps + 1, steps))
    state = np.zeros((2, steps))
    step_map = np.empty((2, 2))
    for i in range(steps):
        for column in (0, 1):
            q, w = states[i] + _DIFFERENCE * np.eye(2)[column]
            end = runge_kutta_step(equation, float(q), float(w), step, motor[i], rises[i])
            step_map[:, column] = (np.array(end) - states[i + 1]) / _DIFFERENCE
        state[:, :i] = step_map @ state[:, :i]
        state[:, i] = push
        response[i + 1] = state[0]
    return response
