"""How far a collocated roll is from the same motion integrated finely, and finer meshes until it fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from aerodima.optimisation.swing.reduced_model import motion
from aerodima.optimisation.swing.solver import SwingSolution, solve
from aerodima.optimisation.swing.swing_problem import ROLL, ReducedMember, SwingProblem
from aerodima.workbench.config.array_types import FloatArray

MOST_KNOTS = 241
"""Finest mesh that is tried."""


def tail_at(problem: SwingProblem, x: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angle, rate and acceleration of the tail joints at times, each (..., joints): exact between the knots."""
    knots = problem.knots
    at = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 2)
    since, length = (time - knots[at])[..., None], (knots[1:] - knots[:-1])[at][..., None]
    angles, rates, accelerations = (np.moveaxis(values, 0, -1) for values in problem.tail_motion(x))
    angle, rate, acceleration = angles[at], rates[at], accelerations[at]
    jerk = (accelerations[at + 1] - acceleration) / length
    return (
        angle + rate * since + acceleration * since**2 / 2 + jerk * since**3 / 6,
        rate + acceleration * since + jerk * since**2 / 2,
        acceleration + jerk * since,
    )


def forward_roll(problem: SwingProblem, solution: SwingSolution, member: ReducedMember, time: FloatArray) -> FloatArray:
    """Roll of a member at times, rad, integrated with a stiff method to 1e-6 under the tail motion of a solution."""

    def slope(t: float, state: FloatArray) -> list[float]:
        tail = tail_at(problem, solution.x, np.array(t))
        inputs = problem.turn(member, member.profile.curve(np.array(t)), solution.parameter)
        acceleration, _ = motion(np.array(state[0]), np.array(state[1]), tail, inputs, member.car)
        return [state[1], float(acceleration)]

    begin = member.profile.state_at(0.0)
    run = solve_ivp(
        slope, (0.0, time[-1]), begin, method="LSODA", t_eval=time, rtol=1e-5, atol=1e-6, max_step=0.05,
        events=_lost,
    )  # fmt: skip
    roll = np.full(len(time), np.inf)
    roll[: run.y.shape[1]] = run.y[0]
    return roll


def _lost(_time: float, state: FloatArray) -> float:
    return 1.5 - abs(state[0])


_lost.terminal = True  # type: ignore[attr-defined]


def collocation_error(problem: SwingProblem, solution: SwingSolution) -> float:
    """Largest difference (rad) of collocated and integrated car roll at the knots, over all members."""
    pairs = zip(problem.layout.cars, problem.members, strict=True)
    return max(
        float(np.max(np.abs(forward_roll(problem, solution, member, problem.knots) - solution.x[car.roll] * ROLL)))
        for car, member in pairs
    )


def refined(problem: SwingProblem, x: FloatArray) -> tuple[SwingProblem, FloatArray]:
    """The problem with a knot more in every interval, and the same motion on it."""
    knots = np.sort(np.concatenate([problem.knots, 0.5 * (problem.knots[1:] + problem.knots[:-1])]))
    finer = replace(problem, knots=knots)
    y = np.empty(finer.layout.size)
    y[:-1] = np.ravel([np.interp(knots, problem.knots, row) for row in x[:-1].reshape(-1, len(problem.knots))])
    y[-1] = x[-1]
    motions = np.stack(tail_at(problem, x, knots))
    for joint, tail in enumerate(finer.layout.tail):
        for place, values in zip(tail, motions[..., joint], strict=True):
            y[place] = values / finer.units[place]
    return finer, y


def refine(
    problem: SwingProblem,
    solution: SwingSolution,
    bound: float,
    *,
    wall_time: float = 60.0,
    progress: Callable[[int, float], None] | None = None,
    **options: Any,
) -> tuple[SwingProblem, SwingSolution, float]:
    """Doubles the mesh until the collocation error is below `bound` (rad) or `MOST_KNOTS` is reached.

    Returns:
        SwingProblem, solution and error of the finest mesh that was solved.
    """
    error = collocation_error(problem, solution)
    while error > bound and 2 * len(problem.knots) - 1 <= MOST_KNOTS:
        if progress is not None:
            progress(len(problem.knots), error)
        finer, start = refined(problem, solution.x)
        better = solve(finer, start, wall_time=wall_time, **options)
        if not better.success:
            break
        problem, solution, error = finer, better, collocation_error(finer, better)
    return problem, solution, error
