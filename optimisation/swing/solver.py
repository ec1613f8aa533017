"""Solves a swing problem with SNOPT or IPOPT through Drake's MathematicalProgram, from one start or from many."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydrake.autodiffutils import ExtractValue, InitializeAutoDiff
from pydrake.solvers import IpoptSolver, MathematicalProgram, SnoptSolver, SolverOptions

from aerodima.optimisation.sweep.study_engine import RunEngine, SerialRunEngine, in_waves
from aerodima.optimisation.swing.swing_problem import SwingProblem, random_start
from aerodima.optimisation.swing.transcription import Block, Rows, bounds, constraints, cost
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import SwingError

SolverName = Literal["snopt", "ipopt"]

FEASIBLE = 1e-5
"""Largest scaled violation of a solution."""
OPTIMALITY = 1e-5
"""Optimality tolerance of both solvers, scaled."""
_ITERATIONS = 500
_OPTIONS: dict[str, dict[str, float | str]] = {
    "snopt": {"Major feasibility tolerance": 0.1 * FEASIBLE, "Major optimality tolerance": OPTIMALITY},
    "ipopt": {"tol": OPTIMALITY, "constr_viol_tol": 0.1 * FEASIBLE, "hessian_approximation": "limited-memory"},
}


@dataclass(frozen=True)
class Violation:
    """A constraint that is not kept: by how much in its unit, and in units of its scale."""

    name: str
    unit: str
    amount: float
    scaled: float

    def __str__(self) -> str:
        return f"{self.name} by {self.amount:.3g} {self.unit}"


@dataclass(frozen=True)
class SwingSolution:
    """What a solver came back with.

    Attributes:
        x: scaled variables.
        success: the solver says so, and no constraint is violated by more than `FEASIBLE`.
        cost: of the programme.
        parameter: friction factor, speed (m/s) or peak roll (rad), in its own unit.
        violations: worst first.
        solver, status, iterations (evaluations), wall_time (s), timed_out: how it went.
    """

    x: FloatArray
    success: bool
    cost: float
    parameter: float
    violations: tuple[Violation, ...]
    solver: str
    status: int
    evaluations: int
    wall_time: float
    timed_out: bool = False


class _OutOfTimeError(Exception):
    """The deadline has passed; raised inside the solver's callback, comes back wrapped by Drake."""


class _Clock:
    """Counts evaluations, remembers the last point and stops the solver at the deadline."""

    def __init__(self, start: FloatArray, wall_time: float) -> None:
        self.begun, self.evaluations, self.passed = time.perf_counter(), 0, False
        self.deadline, self.last = self.begun + wall_time, np.array(start)

    def tick(self) -> None:
        self.evaluations += 1
        if time.perf_counter() > self.deadline:
            self.passed = True
            raise _OutOfTimeError


def solve(
    problem: SwingProblem,
    start: FloatArray,
    *,
    solver: SolverName = "snopt",
    iterations: int = _ITERATIONS,
    wall_time: float = 60.0,
) -> SwingSolution:
    """One solve from one start.

    Args:
        problem: to be solved.
        start: scaled variables (layout.size,).
        solver: snopt or ipopt.
        iterations: limit of the solver's iterations.
        wall_time: s; the best iterate so far comes back when it is over.

    Raises:
        SwingError: the solver is not in this Drake.
    """
    chosen: Any = {"snopt": SnoptSolver, "ipopt": IpoptSolver}[solver]()
    if not (chosen.available() and chosen.enabled()):
        raise SwingError(f"solver {solver}: not available in this Drake; allowed: snopt, ipopt where they are built in")
    clock = _Clock(start, wall_time)
    prog, x = _programme(problem, clock)
    limits: dict[str, float] = {"max_iter": iterations, "max_wall_time": wall_time}
    if solver == "snopt":
        limits = {"Major iterations limit": iterations, "Iterations limit": 100 * iterations}
        limits |= {"Superbasics limit": problem.layout.size, "Time limit": wall_time}
    options = SolverOptions()
    for key, value in (_OPTIONS[solver] | limits).items():
        options.SetOption(chosen.solver_id(), key, value)
    status, good, found = -1, False, clock.last
    try:
        result = chosen.Solve(prog, np.array(start), options)
        found = np.asarray(result.GetSolution(x), dtype=float)
        status = int(getattr(result.get_solver_details(), "info", getattr(result.get_solver_details(), "status", 0)))
        good = bool(result.is_success())
    except (_OutOfTimeError, RuntimeError):
        if not clock.passed:
            raise
        found = clock.last
    if not np.all(np.isfinite(found)):
        found, good = clock.last, False
    violations = violations_of(problem, found)
    spent = time.perf_counter() - clock.begun
    return SwingSolution(
        x=found,
        success=good and not violations,
        cost=cost_of(problem, found),
        parameter=float(found[-1] * problem.parameter_scale),
        violations=violations,
        solver=solver,
        status=status,
        evaluations=clock.evaluations,
        wall_time=spent,
        timed_out=clock.passed or spent > wall_time,
    )


def multi_start(
    problem: SwingProblem,
    seed: int,
    starts: int,
    *,
    solver: SolverName = "snopt",
    iterations: int = _ITERATIONS,
    wall_time: float = 60.0,
    engine: RunEngine | None = None,
    done: Callable[[int, SwingSolution], None] | None = None,
) -> list[SwingSolution]:
    """Solutions from `starts` random starts of a seed, in their order; fewer when the wall time is over.

    Start k depends on seed and k alone, so more starts begin with the same ones.
    """
    deadline = time.perf_counter() + wall_time

    def begun() -> Iterator[tuple[SwingProblem, FloatArray, SolverName, int, float]]:
        for number in range(starts):
            left = deadline - time.perf_counter()
            if left <= 0.0 and number:
                return
            start = random_start(problem, np.random.default_rng([seed, number]))
            yield problem, start, solver, iterations, max(left, 0.0)

    solutions: list[SwingSolution] = []
    for solution in in_waves(engine or SerialRunEngine(), _solved, begun()):
        solutions.append(solution)
        if done is not None:
            done(len(solutions) - 1, solution)
    return solutions


def _solved(start: tuple[SwingProblem, FloatArray, SolverName, int, float]) -> SwingSolution:
    problem, x, solver, iterations, wall_time = start
    return solve(problem, x, solver=solver, iterations=iterations, wall_time=wall_time)


def best_of(solutions: list[SwingSolution]) -> SwingSolution:
    """The feasible solution of the lowest cost; without one, that with the smallest violation."""
    feasible = [solution for solution in solutions if not solution.violations]
    if feasible:
        return min(feasible, key=lambda solution: solution.cost)
    return min(solutions, key=lambda solution: solution.violations[0].scaled)


def cost_of(problem: SwingProblem, x: FloatArray) -> float:
    """Value of the programme's cost."""
    linear, squares = cost(problem)
    return float(squares @ (x * x)) + float(linear @ x)


def violations_of(problem: SwingProblem, x: FloatArray) -> tuple[Violation, ...]:
    """What x violates by more than `FEASIBLE`, one entry per kind of constraint, worst first."""
    worst: dict[str, Violation] = {}

    def note(rows: Rows, values: FloatArray) -> None:
        scaled = float(np.max(np.maximum(rows.lower / rows.size - values, values - rows.upper / rows.size)))
        if scaled > FEASIBLE and (rows.name not in worst or scaled > worst[rows.name].scaled):
            worst[rows.name] = Violation(rows.name, rows.unit, scaled * rows.size, scaled)

    for rows in bounds(problem):
        note(rows, x[rows.columns[:, 0]])
    for block in constraints(problem):
        for rows, (values, _) in zip(block.rows, block.values(x * problem.units), strict=True):
            note(rows, values / rows.size)
    return tuple(sorted(worst.values(), key=lambda violation: -violation.scaled))


def bounds_of(problem: SwingProblem) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of the scaled variables."""
    low, high = np.empty(problem.layout.size), np.empty(problem.layout.size)
    for rows in bounds(problem):
        low[rows.columns[:, 0]], high[rows.columns[:, 0]] = rows.lower / rows.size, rows.upper / rows.size
    return low, high


def _programme(problem: SwingProblem, clock: _Clock) -> tuple[MathematicalProgram, Any]:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(problem.layout.size, "x")
    prog.AddBoundingBoxConstraint(*bounds_of(problem), x)
    for block in constraints(problem):
        if block.linear:
            A = block.jacobian(np.zeros(len(x)))
            used = np.unique(block.pattern[1])
            prog.AddLinearConstraint(A[:, used], *block.bounds, x[used])
        else:
            _add_block(prog, x, block, clock)
    _add_cost(prog, x, problem)
    return prog, x


def _add_block(prog: MathematicalProgram, x: Any, block: Block, clock: _Clock) -> None:
    rows, columns = block.pattern
    used, position = np.unique(columns, return_inverse=True)
    lower, upper = block.bounds

    def function(values: Any) -> Any:
        clock.tick()
        active = values.dtype == object
        point = clock.last.copy()
        point[used] = ExtractValue(values).ravel() if active else np.asarray(values)
        if len(used) == len(x):
            clock.last = point
        value, entries = block.at(point)
        if not active:
            return value
        jacobian = np.zeros((len(lower), len(used)))
        jacobian[rows, position] = entries
        return InitializeAutoDiff(value, jacobian).ravel()

    binding = prog.AddConstraint(function, lower, upper, x[used])
    binding.evaluator().SetGradientSparsityPattern(list(zip(rows.tolist(), position.tolist(), strict=True)))


def _add_cost(prog: MathematicalProgram, x: Any, problem: SwingProblem) -> None:
    """The linear part as such, and all mean squares as one function with its own gradient.

    Drake would differentiate a quadratic cost as a dense one, which took a fifth of a solve.
    """
    linear, weights = cost(problem)
    if linear[-1]:
        prog.AddLinearCost(linear[-1] * x[-1])
    used = np.flatnonzero(weights)
    chosen = weights[used]

    def squares(values: Any) -> Any:
        if values.dtype != object:
            return float(chosen @ (values * values))
        point = ExtractValue(values).ravel()
        return InitializeAutoDiff(np.array([chosen @ (point * point)]), (2.0 * chosen * point)[None, :]).ravel()[0]

    prog.AddCost(squares, x[used])
