"""Starts of the solver: smooth tail swings, drawn at random or sampled from a curve, with the roll of the profile."""

from __future__ import annotations

import numpy as np

from aerodima.optimisation.swing.transcription import ACCELERATION, ANGLE, RATE, ROLL, ROLL_RATE, TORQUE, Problem
from aerodima.workbench.config.array_types import FloatArray


def random_start(problem: Problem, generator: np.random.Generator) -> FloatArray:
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
        limit = problem.limits.angles[joint]
        end = (
            -np.sign(start or 1.0) * generator.uniform(0.3, 1.0) * limit if joint == 0 else generator.uniform(-0.5, 0.5)
        )
        travel = end - start
        motions.append((start + travel * shape, travel * slope, travel * curve))
    factor = generator.uniform(0.8, 1.1)
    return start_from(problem, motions, factor)


def start_from(
    problem: Problem, motions: list[tuple[FloatArray, FloatArray, FloatArray]], factor: float = 1.0
) -> FloatArray:
    """Scaled variables for tail motions at the knots.

    Args:
        problem: to be solved.
        motions: angle, rate and acceleration of each joint at the knots, (knots,).
        factor: of friction or speed on that of the profile.
    """
    layout, limits = problem.layout, problem.limits
    x = np.zeros(layout.size)
    for joint, motion in enumerate(motions):
        for order, (values, unit) in enumerate(zip(motion, (ANGLE, RATE, ACCELERATION), strict=True)):
            x[layout.tail(joint, order)] = values / unit
    for number, member in enumerate(problem.members):
        inputs = member.profile.at(problem.knots)
        roll = np.clip(np.interp(problem.knots, member.profile.time, member.profile.roll), -0.05, 0.5 * limits.roll)
        x[layout.member(number, 0)] = roll / ROLL
        x[layout.member(number, 1)] = np.gradient(roll, problem.knots) / ROLL_RATE
        angles, rates, accelerations = (np.column_stack([motion[order] for motion in motions]) for order in range(3))
        _, torque = problem.model.motion(roll, np.zeros_like(roll), (angles, rates, accelerations), inputs, member.car)
        for joint in range(layout.joints):
            x[layout.member(number, 2 + joint)] = np.clip(torque[:, joint], -limits.torque, limits.torque) / TORQUE
    if problem.objective == "friction":
        x[-1] = factor
    elif problem.objective == "speed":
        x[-1] = factor * problem.members[0].profile.speed / problem.parameter_scale
    elif problem.objective == "roll":
        x[-1] = 0.5 * limits.roll / problem.parameter_scale
    return x
