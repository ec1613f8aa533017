"""The search for steering and tail as a nonlinear programme, solved from one start by quadratic programmes of Drake.

    maximise   mean course of the cars,  less SMOOTHNESS x mean square of the steps of the scaled rate
                                         and STEADINESS x mean square of the scaled step of the steering
    subject to every row of `TurnShooting` for every car, the tail's range at and between its knots (linear), bounds

Courses, rows and all slopes at a point come from one batch of turns. About it they are linear, a violation costs
`PENALTY` per scaled unit, and no variable goes further than the trust region: that is a MathematicalProgram. Its point
is driven, and the region grows or shrinks with what was promised and what came of it; a car that flips only shrinks it.
First levels last whole ticks of the driver in the end: they are rounded, fixed, and the rest is solved again.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from aerodima.optimisation.corner.turn_shooting import Found, TurnShooting
from aerodima.optimisation.corner.turn_variables import STEERING
from aerodima.workbench.config.array_types import FloatArray

COURSE = 0.5
"""Scale of the course, rad."""
SMOOTHNESS, STEADINESS = 3e-3, 1e-3
"""Weights that choose among turns of nearly the same course."""
PENALTY = 5.0
"""Of a scaled unit of violation."""
FEASIBLE = 1e-3
"""Largest scaled violation of a solution."""
FIRST_REGION, LARGEST_REGION, LEAST_REGION = 0.2, 0.5, 0.003
"""Scaled; the least is 0.02 rad/s of the tail, 0.02 degrees of steering, 0.6 ms."""
PROMISE = 1e-3
"""A programme that promises less has converged: 0.03 degrees of course."""
TAKEN, LITTLE, GOOD = 0.02, 0.2, 0.6
"""Share of what was promised from which a point is taken, below which the region shrinks, from which it grows."""
SHRINK, GROW = 0.5, 2.0
SETTLING = 8
"""Most iterations with first levels on ticks."""


@dataclass(frozen=True)
class JointSolution:
    """What a start came to.

    Attributes:
        x: scaled variables.
        course: of every car on the reduced model (members,), rad.
        violation: largest scaled one, and `worst` whose it is.
        converged: nothing better is promised, or within the least region; and nothing is violated by more than
            `FEASIBLE`. Before first levels went to ticks.
        evaluations: batches of turns; `wall_time` s.
    """

    x: FloatArray
    course: FloatArray
    violation: float
    worst: str
    converged: bool
    evaluations: int
    wall_time: float


class CornerProgramme:
    """The programme over some cars."""

    def __init__(self, shooting: TurnShooting) -> None:
        self._shooting = shooting
        self._sizes = np.array([row.size for row in shooting.rows])
        rows, members = shooting.rows, shooting.variables.members
        self._low, self._high = (
            np.tile([getattr(row, end) / row.size for row in rows], members) for end in ("lower", "upper")
        )

    def solve(self, start: FloatArray, iterations: int = 60) -> JointSolution:
        """The turn that is best near a start.

        Args:
            start: scaled variables (size,).
            iterations: most quadratic programmes.
        """
        begun, variables = time.perf_counter(), self._shooting.variables
        low, high = variables.bounds
        x, converged, spent = self._climb(np.clip(start, low, high), low, high, iterations)
        x = variables.on_ticks(x)
        fixed = variables.tail + STEERING * np.arange(variables.members) + 2
        low, high = low.copy(), high.copy()
        low[fixed] = high[fixed] = x[fixed]
        x, _, more = self._climb(x, low, high, SETTLING)
        found = self._shooting.at(x)
        violation, worst = self._violation(found)
        return JointSolution(
            x, found.course, violation, worst, converged, spent + more + 1, time.perf_counter() - begun
        )

    def cost(self, x: FloatArray, found: Found) -> tuple[float, FloatArray]:
        """Value and slopes (size,) at scaled variables, and what was found there."""
        weights = self._weights()
        slopes = 2.0 * weights @ x - np.mean(found.course_slopes, axis=0) / COURSE
        return float(x @ weights @ x - np.mean(found.course) / COURSE), slopes

    def constraint(self, found: Found) -> tuple[FloatArray, FloatArray]:
        """Scaled rows of all cars (members x rows,) and their slopes (members x rows, size)."""
        slopes = found.row_slopes / self._sizes[:, None]
        return (found.rows / self._sizes).ravel(), slopes.reshape(-1, slopes.shape[-1])

    def _climb(self, x: FloatArray, low: FloatArray, high: FloatArray, iterations: int) -> tuple[FloatArray, bool, int]:
        """The point, whether it is converged, and how many batches of turns it took."""
        found, region = self._shooting.at(x), FIRST_REGION
        for number in range(iterations):
            step, promised = self._step(x, found, np.maximum(low - x, -region), np.minimum(high - x, region))
            if promised < PROMISE or region < LEAST_REGION:
                return x, self._violation(found)[0] <= FEASIBLE, number + 1
            there = self._shooting.at(x + step)
            kept = (self._merit(x, found) - self._merit(x + step, there)) / promised
            if kept > TAKEN:
                x, found = x + step, there
            if kept > GOOD:
                region = min(GROW * region, LARGEST_REGION)
            elif kept < LITTLE:
                region *= SHRINK
        return x, False, iterations + 1

    def _step(self, x: FloatArray, found: Found, least: FloatArray, most: FloatArray) -> tuple[FloatArray, float]:
        """The step that is best where all is linear (size,), between bounds, and by how much it lowers the merit."""
        slopes = self.cost(x, found)[1]
        rows, row_slopes = self.constraint(found)
        prog: Any = MathematicalProgram()
        step, slack = prog.NewContinuousVariables(x.size, "step"), prog.NewContinuousVariables(rows.size, "violation")
        prog.AddBoundingBoxConstraint(least, most, step)
        prog.AddBoundingBoxConstraint(0.0, np.inf, slack)
        both, one = np.concatenate([step, slack]), np.eye(rows.size)
        prog.AddLinearConstraint(np.hstack([row_slopes, -one]), np.full(rows.size, -np.inf), self._high - rows, both)
        limited = np.isfinite(self._low)
        below = (np.hstack([row_slopes, one])[limited], (self._low - rows)[limited])
        prog.AddLinearConstraint(*below, np.full(np.count_nonzero(limited), np.inf), both)
        self._keep_in_range(prog, x, step)
        prog.AddQuadraticCost(2.0 * self._weights(), slopes, step, is_convex=True)
        prog.AddLinearCost(np.full(rows.size, PENALTY), slack)
        result = ClarabelSolver().Solve(prog)
        if not result.is_success():
            return np.zeros_like(x), 0.0
        moved = np.clip(result.GetSolution(step), least, most)
        beyond = self._beyond(rows + row_slopes @ moved)
        promised = PENALTY * (np.sum(self._beyond(rows)) - np.sum(beyond))
        return moved, float(promised - slopes @ moved - moved @ self._weights() @ moved)

    def _keep_in_range(self, prog: Any, x: FloatArray, step: Any) -> None:
        """The tail's roll at and between its knots."""
        variables = self._shooting.variables
        rates = slice(1, variables.tail)
        travel = variables.roll_rows * variables.units[rates]
        here = variables.start + travel @ x[rates]
        ends = [np.full(len(travel), side * variables.most_roll) - here for side in (-1.0, 1.0)]
        prog.AddLinearConstraint(travel, *ends, step[rates])

    def _weights(self) -> FloatArray:
        """Matrix of the quadratic part of the cost (size, size)."""
        variables = self._shooting.variables
        steps = np.diff(np.eye(variables.rates + 2)[:, 1:-1], axis=0)
        weights = np.zeros((variables.size, variables.size))
        weights[1 : variables.tail, 1 : variables.tail] = SMOOTHNESS * steps.T @ steps / len(steps)
        uneven = STEADINESS / variables.members * np.array([[1.0, -1.0], [-1.0, 1.0]])
        for angle in variables.tail + STEERING * np.arange(variables.members):
            weights[angle : angle + 2, angle : angle + 2] = uneven
        return weights

    def _merit(self, x: FloatArray, found: Found) -> float:
        return self.cost(x, found)[0] + PENALTY * float(np.sum(self._beyond(self.constraint(found)[0])))

    def _beyond(self, rows: FloatArray) -> FloatArray:
        """By how much scaled rows violate their limits."""
        return np.maximum(np.maximum(self._low - rows, rows - self._high), 0.0)

    def _violation(self, found: Found) -> tuple[float, str]:
        """Largest scaled violation of the rows, and its row."""
        beyond, rows = self._beyond(self.constraint(found)[0]), self._shooting.rows
        worst = int(np.argmax(beyond))
        row = rows[worst % len(rows)]
        return float(beyond[worst]), f"{row.name} by {beyond[worst] * row.size:.3g} {row.unit}"


def best_of(solutions: list[JointSolution]) -> JointSolution:
    """That of the largest mean course among those that keep everything; without one, the least violation."""
    kept = [one for one in solutions if one.violation <= FEASIBLE]
    if kept:
        return max(kept, key=lambda one: float(np.mean(one.course)))
    return min(solutions, key=lambda one: one.violation)
