"""Steering and tail of a swerve as a nonlinear program (`MathematicalProgram`), which the user may
add to before it is solved.

    maximise    mean aim of the cars
    subject to  every limit of `SwerveShooting` for every car, bounds,
                the tail's range between its knots, levels in their order (linear)

Aims, limits and all slopes at a point come from one batch of swerves (`SwerveShooting.at`), which
cost and constraints share. SNOPT or IPOPT solves the program; the best visited point that keeps all
constraints is taken. Levels end at whole ticks of the driver: their ends are rounded and fixed
once, and the rest is solved again.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import IpoptSolver, MathematicalProgram, SnoptSolver, SolverOptions

from aerodima.optimisation.swerve.steering import TICK
from aerodima.optimisation.swing.swerve_shooting import (
    TIME_SCALE,
    Evaluation,
    SwerveShooting,
    between_knots,
)
from aerodima.workbench.car.reduced.swerves import LEVELS
from aerodima.workbench.core.array_types import FloatArray

FEASIBILITY_TOL = 1e-3
"""Largest scaled violation of a solution."""
OPTIMALITY_TOL = 1e-2
"""Tolerance of the solver for scaled slopes; lifting wheels and saturated joints are kinks, where
it creeps."""
LINE_SEARCH_TOL = 0.99
"""Tolerance of SNOPT's line search: a loose one, since each point costs a batch of swerves."""
ROWS_DESCRIPTION = "limits of the swerves"
"""Description of the constraint on the limits of all cars."""
Solver = Literal["snopt", "ipopt"]


@dataclass(frozen=True)
class SwerveSolution:
    """Solution from one start.

    Attributes:
        x: scaled variables.
        aims: aim of each car (members,).
        cost: cost of the program, including all costs that were added.
        violation: largest scaled violation of any constraint of the program.
        worst: name of the constraint with that violation, and its amount.
        evaluations: number of batches of swerves.
    """

    x: FloatArray
    aims: FloatArray
    cost: float
    violation: float
    worst: str
    evaluations: int


class SwerveNlp:
    """The nonlinear program over some cars.

    Attributes:
        prog: Drake's program; `solve` respects costs and constraints that are added to it.
        x: scaled variables of the program (size,), in the order of `SwerveVariables`.
        numbers: free numbers of the tail, by name, as expressions of `x`.
        shooting: shooting of the cars.
        evaluations: number of batches of swerves so far.

    Args:
        shooting: shooting of the cars.
        size: magnitude of a usual aim, which scales the cost.
    """

    def __init__(self, shooting: SwerveShooting, size: float) -> None:
        self.shooting = shooting
        self.evaluations = 0
        self._size = size
        self._last: tuple[bytes, Evaluation] | None = None
        self._best: tuple[float, FloatArray] | None = None
        variables = shooting.variables
        rows = shooting.row_limits
        low = np.tile([row.lower / row.size for row in rows], variables.members)
        high = np.tile([row.upper / row.size for row in rows], variables.members)
        prog: Any = MathematicalProgram()
        x = prog.NewContinuousVariables(variables.size, "x")
        self.prog = prog
        self.x = x
        self.numbers = shooting.free_numbers(x)
        prog.AddVisualizationCallback(self._keep, x)
        prog.AddBoundingBoxConstraint(*variables.bounds, x)
        prog.AddCost(self._aim_cost, x)
        prog.AddConstraint(self._rows, low, high, x, description=ROWS_DESCRIPTION)
        rolls = between_knots()[:, 1 - variables.motion :]
        ends = variables.max_roll * np.ones(len(rolls))
        travel = prog.AddLinearConstraint(rolls, -ends, ends, x[1 : variables.motion])
        travel.evaluator().set_description("range of the tail")
        for first in self._first_ends():
            order = prog.AddLinearConstraint(
                np.array([[-1.0, 1.0]]), [0.0], [np.inf], x[first : first + 2]
            )
            order.evaluator().set_description("order of the levels")

    def solve(
        self, start: FloatArray, iterations: int = 30, solver: Solver = "snopt"
    ) -> SwerveSolution:
        """Solves for the best swerve near a start.

        Args:
            start: scaled variables (size,).
            iterations: largest number of major iterations of the solver, both before and after the
                ends of levels are rounded to ticks.
            solver: solver of the program.
        """
        before = self.evaluations
        low, high = self.shooting.variables.bounds
        x = self._solve(np.clip(start, low, high), iterations, solver)
        ends = np.concatenate([[first, first + 1] for first in self._first_ends()])
        x = np.clip(x, low, high)
        x[ends] = TICK * np.rint(TIME_SCALE * x[ends] / TICK) / TIME_SCALE
        binding = self.prog.AddBoundingBoxConstraint(x[ends], x[ends], self.x[ends])
        try:
            x = self._solve(x, iterations, solver)
        finally:
            self.prog.RemoveConstraint(binding)
        violation, worst = self._violation(x)
        spent = self.evaluations - before
        return SwerveSolution(x, self.at(x).aims, self._cost(x), violation, worst, spent)

    def at(self, x: np.ndarray) -> Evaluation:
        """Evaluates aims, limits and slopes at scaled variables (size,), numbers or AutoDiff
        scalars; the last point is remembered.
        """
        point = ExtractValue(x).ravel() if x.dtype == object else x
        key = point.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, self.shooting.at(point))
            self.evaluations += 1
        return self._last[1]

    def _first_ends(self) -> range:
        """Returns the index of the variable of each car's end of the first level."""
        variables = self.shooting.variables
        return range(variables.tail + LEVELS, variables.size, variables.driver)

    def _solve(self, start: FloatArray, iterations: int, solver: Solver) -> FloatArray:
        """Returns the best visited point that keeps all constraints, else the one where the solver
        ended.
        """
        engine: SnoptSolver | IpoptSolver
        settings: dict[str, Any]
        if solver == "snopt":
            engine = SnoptSolver()
            settings = {
                "Major iterations limit": iterations,
                "Major optimality tolerance": OPTIMALITY_TOL,
                "Major feasibility tolerance": 0.1 * FEASIBILITY_TOL,
                "Linesearch tolerance": LINE_SEARCH_TOL,
            }
        else:
            engine = IpoptSolver()
            settings = {
                "max_iter": iterations,
                "tol": OPTIMALITY_TOL,
                "constr_viol_tol": 0.1 * FEASIBILITY_TOL,
            }
        options = SolverOptions()
        for name, value in settings.items():
            options.SetOption(engine.solver_id(), name, value)
        self._best = None
        self._keep(start)
        x = engine.Solve(self.prog, start, options).GetSolution(self.x)
        self._keep(x)
        return x if self._best is None else self._best[1]

    def _keep(self, x: FloatArray) -> None:
        """Remembers a point if it keeps all constraints and costs less than those before; the
        solver calls it, too.
        """
        if not self.prog.CheckSatisfied(self.prog.GetAllConstraints(), x, FEASIBILITY_TOL):
            return
        cost = self._cost(x)
        if self._best is None or cost < self._best[0]:
            self._best = (cost, x.copy())

    def _cost(self, x: FloatArray) -> float:
        """Returns the sum of all costs of the program."""
        costs = [self.prog.EvalBinding(binding, x)[0] for binding in self.prog.GetAllCosts()]
        return float(sum(costs))

    def _aim_cost(self, x: np.ndarray) -> Any:
        evaluation = self.at(x)
        cost = np.array([-np.mean(evaluation.aims) / self._size])
        slopes = -np.mean(evaluation.aim_slopes, axis=0)[None] / self._size
        return _joined(x, cost, slopes)[0]

    def _rows(self, x: np.ndarray) -> np.ndarray:
        evaluation = self.at(x)
        return _joined(x, evaluation.rows.ravel(), evaluation.row_slopes.reshape(-1, len(x)))

    def _violation(self, x: FloatArray) -> tuple[float, str]:
        """Returns the largest violation of any constraint at scaled variables, including those that
        were added, and the name of the constraint with its amount.
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
                limits = self.shooting.row_limits
                limit = limits[index % len(limits)]
                name = f"{limit.name} by {violation * limit.size:.3g} {limit.unit}"
        return largest, name


def _joined(x: np.ndarray, values: FloatArray, slopes: FloatArray) -> FloatArray:
    """Returns values (n,) as AutoDiff scalars by the chain rule, or as they are where the variables
    (size,) carry no gradients.
    """
    if x.dtype != object or not ExtractGradient(x).size:
        return values
    return np.ravel(InitializeAutoDiff(values, slopes @ ExtractGradient(x)))
