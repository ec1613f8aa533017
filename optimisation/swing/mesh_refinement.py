"""How far a collocated roll is from the same motion integrated finely, and finer meshes until it fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from aerodima.optimisation.swing.solver import Solution, solve
from aerodima.optimisation.swing.transcription import ACCELERATION, ANGLE, RATE, ROLL, Problem
from aerodima.workbench.config.array_types import FloatArray

MOST_KNOTS = 241
"""Finest mesh that is tried."""


def tail_at(problem: Problem, x: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angle, rate and acceleration of the tail joints at times, each (..., joints): exact between the knots."""
    knots, layout = problem.knots, problem.layout
    at = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 2)
    since, length = time - knots[at], (knots[1:] - knots[:-1])[at]
    columns: tuple[list[FloatArray], ...] = ([], [], [])
    for joint in range(layout.joints):
        units = (ANGLE, RATE, ACCELERATION)
        angle, rate, acceleration = (x[layout.tail(joint, order)] * units[order] for order in range(3))
        jerk = (acceleration[at + 1] - acceleration[at]) / length
        columns[2].append(acceleration[at] + jerk * since)
        columns[1].append(rate[at] + acceleration[at] * since + jerk * since**2 / 2)
        columns[0].append(angle[at] + rate[at] * since + acceleration[at] * since**2 / 2 + jerk * since**3 / 6)
    angles, rates, accelerations = (np.stack(column, axis=-1) for column in columns)
    return angles, rates, accelerations


def forward_roll(problem: Problem, solution: Solution, number: int, time: FloatArray) -> FloatArray:
    """Roll of a member at times, rad, integrated with a stiff method to 1e-6 under the tail motion of a solution."""
    member = problem.members[number]
    friction = solution.parameter * member.profile.friction if problem.objective == "friction" else None
    speed = solution.parameter if problem.objective == "speed" else None

    def slope(t: float, state: FloatArray) -> list[float]:
        tail: Any = tail_at(problem, solution.x, np.array(t))
        inputs = member.profile.at(np.array(t), friction, speed)
        acceleration, _ = problem.model.motion(np.array(state[0]), np.array(state[1]), tail, inputs, member.car)
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


def collocation_error(problem: Problem, solution: Solution) -> float:
    """Largest difference (rad) of collocated and integrated car roll at the knots, over all members."""
    worst = 0.0
    for number in range(len(problem.members)):
        collocated = solution.x[problem.layout.member(number, 0)] * ROLL
        worst = max(worst, float(np.max(np.abs(forward_roll(problem, solution, number, problem.knots) - collocated))))
    return worst


def refined(problem: Problem, x: FloatArray) -> tuple[Problem, FloatArray]:
    """The problem with a knot more in every interval, and the same motion on it."""
    knots = np.sort(np.concatenate([problem.knots, 0.5 * (problem.knots[1:] + problem.knots[:-1])]))
    finer = replace(problem, knots=knots)
    old, new = problem.layout, finer.layout
    y = np.zeros(new.size)
    tail = tail_at(problem, x, knots)
    for joint in range(new.joints):
        for order, unit in enumerate((ANGLE, RATE, ACCELERATION)):
            y[new.tail(joint, order)] = tail[order][:, joint] / unit
    for number in range(new.members):
        for part in range(2 + new.joints):
            y[new.member(number, part)] = np.interp(knots, problem.knots, x[old.member(number, part)])
    y[-1] = x[-1]
    return finer, y


def refine(
    problem: Problem,
    solution: Solution,
    bound: float,
    *,
    wall_time: float = 60.0,
    told: Callable[[int, float], None] | None = None,
    **options: Any,
) -> tuple[Problem, Solution, float]:
    """Doubles the mesh until the collocation error is below `bound` (rad) or `MOST_KNOTS` is reached.

    Returns:
        Problem, solution and error of the finest mesh that was solved.
    """
    error = collocation_error(problem, solution)
    while error > bound and 2 * len(problem.knots) - 1 <= MOST_KNOTS:
        if told is not None:
            told(len(problem.knots), error)
        finer, start = refined(problem, solution.x)
        better = solve(finer, start, wall_time=wall_time, **options)
        if not better.success:
            break
        problem, solution, error = finer, better, collocation_error(finer, better)
    return problem, solution, error
