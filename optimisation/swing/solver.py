"""Solves a swing problem with SNOPT or IPOPT through Drake's MathematicalProgram, from one start or from many."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydrake.autodiffutils import ExtractValue, InitializeAutoDiff
from pydrake.solvers import IpoptSolver, MathematicalProgram, SnoptSolver, SolverOptions

from aerodima.optimisation.swing.solver_starts import random_start
from aerodima.optimisation.swing.transcription import (
    ACCELERATION,
    ANGLE,
    RATE,
    ROLL,
    ROLL_RATE,
    TORQUE,
    Block,
    Collocation,
    Problem,
)
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import SwingError

SolverName = Literal["snopt", "ipopt"]

FEASIBLE = 1e-5
"""Largest scaled violation of a solution."""
OPTIMALITY = 1e-5
"""Optimality tolerance of both solvers, scaled."""
_ITERATIONS = 500


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
class Solution:
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
    """Counts evaluations, remembers the best point and stops the solver at the deadline."""

    def __init__(self, deadline: float) -> None:
        self.deadline, self.evaluations, self.passed = deadline, 0, False

    def tick(self) -> None:
        self.evaluations += 1
        if time.perf_counter() > self.deadline:
            self.passed = True
            raise _OutOfTimeError


def solve(
    problem: Problem,
    start: FloatArray,
    *,
    solver: SolverName = "snopt",
    iterations: int = _ITERATIONS,
    wall_time: float = 60.0,
    progress: Callable[[int], None] | None = None,
) -> Solution:
    """One solve from one start.

    Args:
        problem: to be solved.
        start: scaled variables (layout.size,).
        solver: snopt or ipopt.
        iterations: limit of the solver's iterations.
        wall_time: s; the best iterate so far comes back when it is over.
        progress: told the number of evaluations.

    Raises:
        SwingError: the solver is not in this Drake.
    """
    chosen: Any = {"snopt": SnoptSolver, "ipopt": IpoptSolver}[solver]()
    if not (chosen.available() and chosen.enabled()):
        raise SwingError(f"solver {solver}: not available in this Drake; allowed: snopt, ipopt where they are built in")
    begun = time.perf_counter()
    clock = _Clock(begun + wall_time)
    last = [np.array(start)]
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(problem.layout.size, "x")
    _add_bounds(prog, x, problem)
    _add_linear(prog, x, problem)
    for number in range(len(problem.members)):
        for block in Collocation(problem, number).blocks():
            _add_block(prog, x, block, clock, last, progress)
    _add_cost(prog, x, problem)
    status, timed_out = -1, False
    options = SolverOptions()
    if solver == "snopt":
        for key, value in (
            ("Major iterations limit", iterations),
            ("Iterations limit", 100 * iterations),
            ("Superbasics limit", problem.layout.size),
        ):
            options.SetOption(chosen.solver_id(), key, value)
        options.SetOption(chosen.solver_id(), "Major feasibility tolerance", 0.1 * FEASIBLE)
        options.SetOption(chosen.solver_id(), "Major optimality tolerance", OPTIMALITY)
        options.SetOption(chosen.solver_id(), "Time limit", wall_time)
    else:
        options.SetOption(chosen.solver_id(), "max_iter", iterations)
        options.SetOption(chosen.solver_id(), "tol", OPTIMALITY)
        options.SetOption(chosen.solver_id(), "constr_viol_tol", 0.1 * FEASIBLE)
        options.SetOption(chosen.solver_id(), "max_wall_time", wall_time)
        options.SetOption(chosen.solver_id(), "hessian_approximation", "limited-memory")
    try:
        result = chosen.Solve(prog, np.array(start), options)
        found = np.asarray(result.GetSolution(x), dtype=float)
        status = int(getattr(result.get_solver_details(), "info", getattr(result.get_solver_details(), "status", 0)))
        good = bool(result.is_success())
    except (_OutOfTimeError, RuntimeError):
        if not clock.passed:
            raise
        found, good, timed_out = last[0], False, True
    if not np.all(np.isfinite(found)):
        found, good = last[0], False
    violations = violations_of(problem, found)
    return Solution(
        x=found,
        success=good and not violations,
        cost=cost_of(problem, found),
        parameter=float(found[-1] * problem.parameter_scale),
        violations=violations,
        solver=solver,
        status=status,
        evaluations=clock.evaluations,
        wall_time=time.perf_counter() - begun,
        timed_out=timed_out or time.perf_counter() - begun > wall_time,
    )


def multi_start(
    problem: Problem,
    seed: int,
    starts: int,
    *,
    solver: SolverName = "snopt",
    iterations: int = _ITERATIONS,
    wall_time: float = 60.0,
    done: Callable[[int, Solution], None] | None = None,
) -> list[Solution]:
    """Solutions from `starts` random starts of a seed, in their order; fewer when the wall time is over.

    Start k depends on seed and k alone, so more starts begin with the same ones.
    """
    deadline = time.perf_counter() + wall_time
    solutions: list[Solution] = []
    for number in range(starts):
        left = deadline - time.perf_counter()
        if left <= 0.0 and solutions:
            break
        start = random_start(problem, np.random.default_rng([seed, number]))
        solutions.append(solve(problem, start, solver=solver, iterations=iterations, wall_time=max(left, 0.0)))
        if done is not None:
            done(number, solutions[-1])
    return solutions


def best_of(solutions: list[Solution]) -> Solution:
    """The feasible solution of the lowest cost; without one, that with the smallest violation."""
    feasible = [solution for solution in solutions if not solution.violations]
    if feasible:
        return min(feasible, key=lambda solution: solution.cost)
    return min(solutions, key=lambda solution: solution.violations[0].scaled)


def cost_of(problem: Problem, x: FloatArray) -> float:
    """Value of the programme's cost."""
    total = float(_square_weights(problem) @ (x * x))
    if problem.objective in ("friction", "speed"):
        total -= float(x[-1])
    elif problem.objective == "roll":
        total += float(x[-1])
    return total


def violations_of(problem: Problem, x: FloatArray) -> tuple[Violation, ...]:
    """What x violates by more than `FEASIBLE`, one entry per kind of constraint, worst first."""
    worst: dict[str, Violation] = {}

    def note(name: str, unit: str, size: float, scaled: float) -> None:
        if scaled > FEASIBLE and (name not in worst or scaled > worst[name].scaled):
            worst[name] = Violation(name, unit, scaled * size, scaled)

    low, high = bounds_of(problem)
    names = variable_names(problem)
    for index in np.flatnonzero((x < low - FEASIBLE) | (x > high + FEASIBLE)):
        name, unit, size = names[index]
        note(name, unit, size, float(max(low[index] - x[index], x[index] - high[index])))
    for A, lower, upper, name, unit, size in linear_rows(problem):
        values = A @ x
        note(name, unit, size, float(max(np.max(lower - values), np.max(values - upper))))
    for number in range(len(problem.members)):
        for block in Collocation(problem, number).blocks():
            values, _ = block.function(x)
            amounts = np.maximum(block.lower - values, values - block.upper)
            for row in np.flatnonzero(amounts > FEASIBLE):
                name, unit, size = block.labels[row]
                note(name, unit, size, float(amounts[row]))
    return tuple(sorted(worst.values(), key=lambda violation: -violation.scaled))


def variable_names(problem: Problem) -> list[tuple[str, str, float]]:
    """Name, unit and scale of every variable."""
    layout = problem.layout
    names: list[tuple[str, str, float]] = []
    for joint in ("roll", "pitch")[: layout.joints]:
        kinds = (("angle", "rad", ANGLE), ("rate", "rad/s", RATE), ("acceleration", "rad/s2", ACCELERATION))
        for kind, unit, size in kinds:
            names += [(f"tail {joint} {kind}", unit, size)] * layout.knots
    for _ in range(layout.members):
        names += [("car roll", "rad", ROLL)] * layout.knots + [("car roll rate", "rad/s", ROLL_RATE)] * layout.knots
        for joint in ("roll", "pitch")[: layout.joints]:
            names += [(f"tail {joint} torque", "N m", TORQUE)] * layout.knots
    unit = {"friction": "1", "speed": "m/s"}.get(problem.objective, "rad")
    return [*names, (problem.objective, unit, problem.parameter_scale)]


def bounds_of(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of the scaled variables."""
    layout, limits = problem.layout, problem.limits
    low, high = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    waiting = problem.knots <= problem.wait + 1e-12
    for joint in range(layout.joints):
        angle, rate, acceleration = (layout.tail(joint, order) for order in range(3))
        low[angle], high[angle] = -limits.angles[joint] / ANGLE, limits.angles[joint] / ANGLE
        low[rate], high[rate] = -limits.tail_rate / RATE, limits.tail_rate / RATE
        held = np.arange(layout.size)[angle][waiting]
        low[held] = high[held] = problem.start[joint] / ANGLE
        still = [*np.arange(layout.size)[rate][waiting], np.arange(layout.size)[rate][-1]]
        low[still] = high[still] = 0.0
        resting = [*np.arange(layout.size)[acceleration][waiting][:-1], np.arange(layout.size)[acceleration][-1]]
        low[resting] = high[resting] = 0.0
    for number, member in enumerate(problem.members):
        roll, rate = layout.member(number, 0), layout.member(number, 1)
        first_roll, first_rate = member.profile.state_at(0.0)
        low[roll], high[roll] = -limits.roll_inwards / ROLL, limits.roll / ROLL
        low[rate], high[rate] = -10.0 / ROLL_RATE, 10.0 / ROLL_RATE
        low[roll.start] = high[roll.start] = first_roll / ROLL
        low[rate.start] = high[rate.start] = first_rate / ROLL_RATE
        high[roll.stop - 1] = min(high[roll.stop - 1], limits.end_roll / ROLL)
        low[rate.stop - 1], high[rate.stop - 1] = np.array([-1, 1]) * limits.end_roll_rate / ROLL_RATE
        for joint in range(layout.joints):
            torque = layout.member(number, 2 + joint)
            low[torque], high[torque] = -limits.torque / TORQUE, limits.torque / TORQUE
    if problem.objective in ("friction", "speed"):
        low[-1], high[-1] = np.array(problem.parameter_range) / problem.parameter_scale
    elif problem.objective == "roll":
        low[-1], high[-1] = 0.0, limits.roll / problem.parameter_scale
    else:
        low[-1] = high[-1] = 0.0
    return low, high


def linear_rows(problem: Problem) -> list[tuple[Any, FloatArray, FloatArray, str, str, float]]:
    """Linear constraints: matrix, bounds, name, unit and scale."""
    layout, h = problem.layout, np.diff(problem.knots)
    n, rows = len(h), []
    every, at = np.arange(layout.size), np.arange(n)
    for joint, name in enumerate(("roll", "pitch")[: layout.joints]):
        angle, rate, acceleration = (every[layout.tail(joint, order)] for order in range(3))
        A = np.zeros((n, layout.size))
        A[at, rate[1:]], A[at, rate[:-1]] = 1.0, -1.0
        A[at, acceleration[1:]] = A[at, acceleration[:-1]] = -h / 2 * ACCELERATION / RATE
        rows.append((A, np.zeros(n), np.zeros(n), f"tail {name} rate defect", "rad/s", RATE))
        A = np.zeros((n, layout.size))
        A[at, angle[1:]], A[at, angle[:-1]] = 1.0, -1.0
        A[at, rate[:-1]] = -h * RATE / ANGLE
        A[at, acceleration[:-1]], A[at, acceleration[1:]] = -(h**2) / 3 * ACCELERATION, -(h**2) / 6 * ACCELERATION
        rows.append((A, np.zeros(n), np.zeros(n), f"tail {name} angle defect", "rad", ANGLE))
        # The cubic between two knots on a stop may bulge beyond it: the middle keeps to the range too.
        A = np.zeros((n, layout.size))
        A[at, angle[1:]] = A[at, angle[:-1]] = 0.5
        A[at, rate[:-1]], A[at, rate[1:]] = h / 8 * RATE / ANGLE, -h / 8 * RATE / ANGLE
        most = np.full(n, problem.limits.angles[joint] / ANGLE)
        rows.append((A, -most, most, f"tail {name} angle between knots", "rad", ANGLE))
        for number in range(layout.members):
            torque = every[layout.member(number, 2 + joint)]
            A = np.zeros((n, layout.size))
            A[at, torque[1:]], A[at, torque[:-1]] = 1.0, -1.0
            most = problem.limits.torque_rate * h / TORQUE
            rows.append((A, -most, most, f"change of the tail {name} torque", "N m", TORQUE))
    if problem.objective == "roll":
        for number in range(layout.members):
            roll = every[layout.member(number, 0)]
            A = np.zeros((layout.knots, layout.size))
            A[np.arange(layout.knots), roll], A[:, -1] = 1.0, -problem.parameter_scale / ROLL
            rows.append(
                (A, np.full(layout.knots, -np.inf), np.zeros(layout.knots), "car roll below its peak", "rad", ROLL)
            )
    return rows


def _add_bounds(prog: MathematicalProgram, x: Any, problem: Problem) -> None:
    prog.AddBoundingBoxConstraint(*bounds_of(problem), x)


def _add_linear(prog: MathematicalProgram, x: Any, problem: Problem) -> None:
    for A, lower, upper, *_ in linear_rows(problem):
        used = np.flatnonzero(np.any(A != 0.0, axis=0))
        prog.AddLinearConstraint(A[:, used], lower, upper, x[used])


def _add_block(
    prog: MathematicalProgram,
    x: Any,
    block: Block,
    clock: _Clock,
    last: list[FloatArray],
    progress: Callable[[int], None] | None,
) -> None:
    rows, columns = (np.array(part) for part in zip(*block.pattern, strict=True))
    used, position = np.unique(columns, return_inverse=True)
    whole = len(used) == len(x)

    def function(values: Any) -> Any:
        clock.tick()
        if progress is not None:
            progress(clock.evaluations)
        active = values.dtype == object
        point = ExtractValue(values).ravel() if active else np.asarray(values)
        full = last[0].copy()
        full[used] = point
        if whole:
            last[0] = full
        value, jacobian = block.function(full)
        return InitializeAutoDiff(value, jacobian[:, used]).ravel() if active else value

    binding = prog.AddConstraint(function, block.lower, block.upper, x[used])
    binding.evaluator().SetGradientSparsityPattern(list(zip(rows.tolist(), position.tolist(), strict=True)))


def _add_cost(prog: MathematicalProgram, x: Any, problem: Problem) -> None:
    """The linear part as such, and all mean squares as one function with its own gradient.

    Drake would differentiate a quadratic cost as a dense one, which took a fifth of a solve.
    """
    if problem.objective in ("friction", "speed"):
        prog.AddLinearCost(-x[-1])
    elif problem.objective == "roll":
        prog.AddLinearCost(x[-1])
    weights = _square_weights(problem)
    used = np.flatnonzero(weights)
    chosen = weights[used]

    def squares(values: Any) -> Any:
        if values.dtype != object:
            return float(chosen @ (values * values))
        point = ExtractValue(values).ravel()
        return InitializeAutoDiff(np.array([chosen @ (point * point)]), (2.0 * chosen * point)[None, :]).ravel()[0]

    prog.AddCost(squares, x[used])


def _square_weights(problem: Problem) -> FloatArray:
    """Weight of the square of every variable in the cost."""
    layout = problem.layout
    weights = np.zeros(layout.size)
    for joint in range(layout.joints):
        weights[layout.tail(joint, 2)] = problem.smoothness / layout.knots
    for number in range(layout.members):
        weights[layout.member(number, 0)] = problem.margin / (layout.members * layout.knots)
        if problem.objective == "effort":
            for joint in range(layout.joints):
                weights[layout.member(number, 2 + joint)] = 1.0 / (layout.members * layout.knots)
    return weights
