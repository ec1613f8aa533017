"""A fit stated as a `MathematicalProgram`, returned before it is solved.

Unknowns stand in their own units, bounded, with |residual|^2 / 2 as a cost. A user adds linear
constraints and linear or convex quadratic costs on `x`; `gauss_newton.solve` honours them in every
step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram

from aerodima.optimisation.identify.least_squares import Problem
from aerodima.workbench.core.array_types import ArrayPair, FloatArray
from aerodima.workbench.core.errors import FitError

_CONVEX = -1e-9
"""Eigenvalues of a quadratic cost above this part of the largest count as zero."""


@dataclass(frozen=True)
class LinearTerms:
    """Terms that a user added, for p unknowns in some units.

    The costs are |factor x|^2 / 2 + slope'x + constant, the constraints lower <= rows x <= upper.

    Attributes:
        factor: factor of the quadratic costs (q x p).
        slope: slope of the linear costs (p).
        constant: constant part of the costs.
        rows: coefficients of the constraints (k x p).
        lower: lower limits of the constraints (k).
        upper: upper limits of the constraints (k).
    """

    factor: FloatArray
    slope: FloatArray
    constant: float
    rows: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def present(self) -> bool:
        """True if there are any constraints or costs."""
        return bool(len(self.rows) or len(self.factor) or np.any(self.slope))

    def cost(self, x: FloatArray) -> float:
        """Compute the costs at x (p)."""
        quadratic = 0.5 * float(np.sum(np.square(self.factor @ x)))
        return quadratic + float(self.slope @ x) + self.constant

    def scaled(self, scales: FloatArray) -> LinearTerms:
        """Express the terms in unknowns / scales."""
        return replace(
            self,
            factor=self.factor * scales,
            slope=self.slope * scales,
            rows=self.rows * scales,
        )

    def about(self, x: FloatArray) -> LinearTerms:
        """Express the terms in the change from x; the constant is left out."""
        reached = self.rows @ x
        return replace(
            self,
            slope=self.slope + self.factor.T @ (self.factor @ x),
            constant=0.0,
            lower=self.lower - reached,
            upper=self.upper - reached,
        )


def as_program(problem: Problem | FitProgram) -> FitProgram:
    """State a problem as its program; a program is left as it is."""
    if isinstance(problem, FitProgram):
        return problem
    return FitProgram(problem)


class FitProgram:
    """A least-squares problem as a `MathematicalProgram`.

    Attributes:
        problem: least-squares problem that is stated.
        prog: Drake's program, to which costs and constraints may be added.
        x: decision variables of `prog`: the unknowns (p) in their units, in the order of
            `problem.parameters.names`.
    """

    def __init__(self, problem: Problem) -> None:
        parameters = problem.parameters
        prog: Any = MathematicalProgram()
        self.problem = problem
        self.prog = prog
        self.x = prog.NewContinuousVariables(len(parameters.free), "x")
        prog.AddBoundingBoxConstraint(parameters.lower, parameters.upper, self.x)
        prog.AddCost(self._half_square, vars=self.x, description="|residual|^2 / 2")
        prog.SetInitialGuess(self.x, parameters.initial)

    def __getitem__(self, name: str) -> Any:
        """Return the decision variable of an unknown."""
        return self.x[self.problem.parameters.names.index(name)]

    def _half_square(self, x: Any) -> Any:
        """Compute |residual|^2 / 2 at x (p), which holds numbers or AutoDiffXd."""
        if x.dtype == float:
            return 0.5 * float(np.sum(np.square(self.problem.finite_residual(x))))
        values = ExtractValue(x)[:, 0]
        r = self.problem.finite_residual(values)
        slope = r @ self.problem.forward_jacobian(values, r) @ ExtractGradient(x)
        return InitializeAutoDiff(np.array([0.5 * float(r @ r)]), slope[None, :])[0, 0]

    def linear_terms(self) -> LinearTerms:
        """Collect the terms that were added to the problem's own bounds and cost.

        Raises:
            FitError: a term is neither a linear constraint nor a linear or convex quadratic cost,
                or is in other variables.
        """
        prog = self.prog
        count = len(self.x)
        if prog.num_vars() != count:
            raise FitError(f"{self.problem.name}: added variables; only those of the fit")
        bounds = prog.bounding_box_constraints()[1:]
        constraints = [*bounds, *prog.linear_constraints(), *prog.linear_equality_constraints()]
        costs = [*prog.linear_costs(), *prog.quadratic_costs()]
        known = 2 + len(constraints) + len(costs)
        if len(prog.GetAllConstraints()) + len(prog.GetAllCosts()) != known:
            raise FitError(
                f"{self.problem.name}: added constraints must be linear, costs linear or quadratic"
            )
        hessian = np.zeros((count, count))
        for binding in prog.quadratic_costs():
            indices = prog.FindDecisionVariableIndices(binding.variables())
            hessian[np.ix_(indices, indices)] += binding.evaluator().Q()
        limits = [binding.evaluator() for binding in constraints]
        constant, slopes = self._at_origin(costs)
        reached, rows = self._at_origin(constraints)
        return LinearTerms(
            self._factor(hessian),
            np.sum(slopes, axis=0),
            float(np.sum(constant)),
            rows,
            np.concatenate([reached[:0], *(limit.lower_bound() for limit in limits)]),
            np.concatenate([reached[:0], *(limit.upper_bound() for limit in limits)]),
        )

    def _at_origin(self, bindings: list[Any]) -> ArrayPair:
        """Compute values (k) and gradients (k x p) of bindings where all unknowns are zero."""
        count = len(self.x)
        origin = InitializeAutoDiff(np.zeros(count))[:, 0]
        values = [np.zeros(0)]
        rows = [np.zeros((0, count))]
        for binding in bindings:
            value = self.prog.EvalBinding(binding, origin)
            values.append(ExtractValue(value)[:, 0])
            rows.append(ExtractGradient(value))
        return np.concatenate(values), np.concatenate(rows)

    def _factor(self, hessian: FloatArray) -> FloatArray:
        """Compute F (q x p) with F'F the Hessian; FitError for a cost that is not convex."""
        values, vectors = np.linalg.eigh(hessian)
        largest = float(np.max(np.abs(values)))
        if float(values[0]) < _CONVEX * largest:
            raise FitError(f"{self.problem.name}: an added cost is not convex")
        used = values > -_CONVEX * largest
        return np.sqrt(values[used])[:, None] * vectors[:, used].T
