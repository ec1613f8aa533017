"""Bounded least squares in `MathematicalProgram`: the only two solvers that the fits use.

- `solve_algebraic`: residuals as slack variables with a quadratic cost, SNOPT, derivatives through AutoDiffXd. For
  residuals that are a formula.
- `solve_rollout`: Levenberg-Marquardt whose step is a bounded least-squares QP (Clarabel). For residuals that come out
  of a simulation, with a Jacobian by finite differences.

`solve_formula` tries the second before the first. All work on value / scale and on a residual that the caller has
divided by its weights. Which one fits where was measured (design section 12).
"""

from aerodima.optimisation.fit.least_squares.algebraic import solve_algebraic, solve_formula
from aerodima.optimisation.fit.least_squares.levenberg_marquardt import solve_rollout
from aerodima.optimisation.fit.least_squares.problem import Attempt, Problem, Solution, Solver, finite_residual, solve

__all__ = [
    "Attempt",
    "Problem",
    "Solution",
    "Solver",
    "finite_residual",
    "solve",
    "solve_algebraic",
    "solve_formula",
    "solve_rollout",
]
