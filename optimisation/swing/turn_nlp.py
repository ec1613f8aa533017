"""Steering and tail of a turn as a nonlinear program (`MathematicalProgram`), which the user may
add to before it is solved.

    maximise    mean course of the cars
                less RATE_SMOOTHNESS_WEIGHT x mean square of the steps of the scaled rate
                and STEERING_SMOOTHNESS_WEIGHT x mean square of the scaled step of the steering
    subject to  every row of `TurnShooting` for every car, bounds,
                the tail's range at and between its knots (linear)

Courses, rows and all slopes at a point come from one batch of turns (`TurnShooting.at`), which cost
and constraints share. SNOPT solves; of the points that it visits the best one that keeps all
constraints is taken. First levels last whole ticks of the driver: after a few iterations they are
rounded and fixed, and the rest is solved again.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from aerodima.optimisation.swing.turn_shooting import STEERING_SIZE, Evaluation, TurnShooting
from aerodima.workbench.core.array_types import FloatArray

COURSE_SCALE = 0.5
"""Scale of the course, rad."""
RATE_SMOOTHNESS_WEIGHT = 3e-3
"""Weight that chooses among turns of nearly the same course."""
STEERING_SMOOTHNESS_WEIGHT = 1e-3
"""Weight that chooses among turns of nearly the same course."""
FEASIBILITY_TOL = 1e-3
"""Largest scaled violation of a solution."""
OPTIMALITY_TOL = 1e-2
"""Tolerance of the solver for scaled slopes; lifting wheels and saturated joints are kinks, where
it creeps."""
LINE_SEARCH_TOL = 0.99
"""Line search of the solver: an inexact one, since each of its points costs a batch of turns
(README.md)."""
ROWS_DESCRIPTION = "rows of the turns"
"""Description of the constraint on the rows of all cars."""
WARM_ITERATIONS = 10
"""Largest number of iterations before first levels are rounded to ticks of the driver."""


@dataclass(frozen=True)
class TurnSolution:
    """Solution from one start.

    Attributes:
        x: scaled variables.
        course: of every car on the reduced model (members,), rad.
        violation: largest of any constraint of the program, scaled, and `worst` whose it is.
        converged: the solver says so, and nothing is violated by more than `FEASIBILITY_TOL`.
        evaluations: batches of turns; `wall_time` s.
    """

    x: FloatArray
    course: FloatArray
    violation: float
    worst: str
    converged: bool
    evaluations: int
    wall_time: float


class TurnNlp:
    """The nonlinear program over some cars.

    Attributes:
        prog: Drake's program; costs and constraints that are added to it are kept by `solve`.
        x: its scaled variables (size,), in the order of `TurnVariables`.
        shooting: of the cars.
        evaluations: batches of turns so far.
    """

    def __init__(self, shooting: TurnShooting) -> None:
        self.shooting = shooting
        self.evaluations = 0
        self._last: tuple[bytes, Evaluation] | None = None
        self._best: tuple[float, FloatArray] | None = None
        self._sizes = np.array([row.size for row in shooting.rows])
        rows = shooting.rows
        variables = shooting.variables
        low = np.tile([row.lower / row.size for row in rows], variables.members)
        high = np.tile([row.upper / row.size for row in rows], variables.members)
        prog: Any = MathematicalProgram()
        x = prog.NewContinuousVariables(variables.size, "x")
        self.prog = prog
        self.x = x
        prog.AddVisualizationCallback(self._keep, x)
        prog.AddBoundingBoxConstraint(*variables.bounds, x)
        weights = 2.0 * self._weights()
        prog.AddQuadraticCost(weights, np.zeros(variables.size), x, is_convex=True)
        prog.AddCost(self._course_cost, x)
        prog.AddConstraint(self._scaled_rows, low, high, x, description=ROWS_DESCRIPTION)
        rates = slice(1, variables.tail)
        travel = variables.roll_rows * variables.units[rates]
        ends = np.outer([-variables.max_roll, variables.max_roll], np.ones(len(travel)))
        limits = prog.AddLinearConstraint(travel, *(ends - variables.start), x[rates])
        limits.evaluator().set_description("travel of the tail")

    def solve(self, start: FloatArray, iterations: int = 30) -> TurnSolution:
        """Solves for the best turn near a start.

        Args:
            start: scaled variables (size,).
            iterations: largest number of major iterations of the solver once first levels are on
                ticks.
        """
        begun = time.perf_counter()
        before = self.evaluations
        variables = self.shooting.variables
        low, high = variables.bounds
        x, _ = self._solve(np.clip(start, low, high), min(iterations, WARM_ITERATIONS))
        x = variables.on_ticks(np.clip(x, low, high))
        fixed = variables.tail + STEERING_SIZE * np.arange(variables.members) + 2
        binding = self.prog.AddBoundingBoxConstraint(x[fixed], x[fixed], self.x[fixed])
        try:
            x, converged = self._solve(x, iterations)
        finally:
            self.prog.RemoveConstraint(binding)
        evaluation = self.at(x)
        violation, worst = self._violation(x)
        spent = self.evaluations - before
        good = converged and violation <= FEASIBILITY_TOL
        wall_time = time.perf_counter() - begun
        return TurnSolution(x, evaluation.course, violation, worst, good, spent, wall_time)

    def at(self, x: FloatArray) -> Evaluation:
        """Evaluates courses, rows and slopes at scaled variables (size,); the last point is
        remembered.
        """
        key = np.ascontiguousarray(x, dtype=np.float64).tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, self.shooting.at(np.asarray(x, dtype=np.float64)))
            self.evaluations += 1
        return self._last[1]

    def _solve(self, start: FloatArray, iterations: int) -> tuple[FloatArray, bool]:
        """Returns the best point that was visited and keeps all constraints, else where the solver
        ended; whether it converged.
        """
        options = SolverOptions()
        solver = SnoptSolver.id()
        options.SetOption(solver, "Major iterations limit", iterations)
        options.SetOption(solver, "Major optimality tolerance", OPTIMALITY_TOL)
        options.SetOption(solver, "Major feasibility tolerance", 0.1 * FEASIBILITY_TOL)
        options.SetOption(solver, "Linesearch tolerance", LINE_SEARCH_TOL)
        self._best = None
        result = SnoptSolver().Solve(self.prog, start, options)
        x = result.GetSolution(self.x)
        self._keep(x)
        return x if self._best is None else self._best[1], bool(result.is_success())

    def _keep(self, x: FloatArray) -> None:
        """Remembers a point if it keeps all constraints and costs less than those before; called by
        the solver.
        """
        if not self.prog.CheckSatisfied(self.prog.GetAllConstraints(), x, FEASIBILITY_TOL):
            return
        cost = 0.0
        for binding in self.prog.GetAllCosts():
            cost += float(self.prog.EvalBinding(binding, x)[0])
        if self._best is None or cost < self._best[0]:
            self._best = (cost, x.copy())

    def _course_cost(self, x: np.ndarray) -> Any:
        value, gradient = _split(x)
        evaluation = self.at(value)
        cost = np.array([-np.mean(evaluation.course) / COURSE_SCALE])
        slopes = -np.mean(evaluation.course_slopes, axis=0)[None] / COURSE_SCALE
        return _joined(cost, slopes, gradient)[0]

    def _scaled_rows(self, x: np.ndarray) -> np.ndarray:
        value, gradient = _split(x)
        evaluation = self.at(value)
        rows = evaluation.rows / self._sizes
        slopes = evaluation.row_slopes / self._sizes[:, None]
        return _joined(rows.ravel(), slopes.reshape(-1, slopes.shape[-1]), gradient)

    def _weights(self) -> FloatArray:
        """Returns the matrix of the quadratic part of the cost (size, size)."""
        variables = self.shooting.variables
        steps = np.diff(np.eye(variables.rates + 2)[:, 1:-1], axis=0)
        weights = np.zeros((variables.size, variables.size))
        weights[1 : variables.tail, 1 : variables.tail] = (
            RATE_SMOOTHNESS_WEIGHT * steps.T @ steps / len(steps)
        )
        uneven = (
            STEERING_SMOOTHNESS_WEIGHT / variables.members * np.array([[1.0, -1.0], [-1.0, 1.0]])
        )
        for angle in variables.tail + STEERING_SIZE * np.arange(variables.members):
            weights[angle : angle + 2, angle : angle + 2] = uneven
        return weights

    def _violation(self, x: FloatArray) -> tuple[float, str]:
        """Returns the largest violation of any constraint at scaled variables, those that were
        added included, and whose it is.
        """
        largest = 0.0
        name = "nothing"
        for binding in self.prog.GetAllConstraints():
            constraint: Any = binding.evaluator()
            value = np.asarray(self.prog.EvalBinding(binding, x), dtype=float)
            below = constraint.lower_bound() - value
            beyond = np.maximum(below, value - constraint.upper_bound())
            index = int(np.argmax(beyond))
            violation = float(beyond[index])
            if violation <= largest:
                continue
            largest = violation
            description = constraint.get_description()
            name = f"{description or 'a constraint'}, entry {index}, by {violation:.3g}"
            if description == ROWS_DESCRIPTION:
                row = self.shooting.rows[index % len(self.shooting.rows)]
                name = f"{row.name} by {violation * row.size:.3g} {row.unit}"
        return largest, name


def best_of(solutions: list[TurnSolution]) -> TurnSolution:
    """Returns the solution of the largest mean course among those that keep all constraints;
    without one, that of the smallest violation.
    """
    kept = [one for one in solutions if one.violation <= FEASIBILITY_TOL]
    if kept:
        return max(kept, key=lambda one: float(np.mean(one.course)))
    return min(solutions, key=lambda one: one.violation)


def _split(x: np.ndarray) -> tuple[FloatArray, FloatArray | None]:
    """Returns values (size,) and, of AutoDiff scalars, slopes (size, n) of what the solver
    evaluates.
    """
    if x.dtype != object:
        return x, None
    return ExtractValue(x).ravel(), ExtractGradient(x)


def _joined(values: FloatArray, slopes: FloatArray, gradient: FloatArray | None) -> FloatArray:
    """Returns values (n,) as AutoDiff scalars by the chain rule; plain if no slopes are
    asked for.
    """
    if gradient is None or not gradient.size:
        return values
    return np.array(
        [AutoDiffXd(value, own) for value, own in zip(values, slopes @ gradient, strict=True)]
    )
