"""The pipeline of every fit: parameters, residual, solution, intervals, result.

`README.md` shows a fit of your own, and what was tried.
"""

from collections.abc import Callable, Sequence
from typing import Any

from aerodima.optimisation.identify.fit_program import FitProgram, as_program
from aerodima.optimisation.identify.fit_result import Channels, FitResult, make_result
from aerodima.optimisation.identify.gauss_newton import solve
from aerodima.optimisation.identify.huber import Loss, solve_huber
from aerodima.optimisation.identify.least_squares import Problem
from aerodima.optimisation.identify.uncertain_constants import (
    NoiseModel,
    UncertainRig,
    fit_constants,
)
from aerodima.optimisation.identify.uncertainty import uncertainty
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Facts


def fit(
    problem: Problem | FitProgram,
    noise: NoiseModel | Callable[..., Any],
    old_noise: NoiseModel | None = None,
    *,
    starts: Sequence[FloatArray] | None = None,
    channels: Channels | None = None,
    facts: Facts | None = None,
    warnings: Sequence[str] = (),
    loss: Loss = "squares",
    rig: UncertainRig | None = None,
) -> FitResult:
    """Solve a problem from all starts and estimate its intervals.

    Args:
        problem: problem with the constants of the rig at their initial values, or its `FitProgram`,
            with costs and constraints that were added.
        noise: function that makes the noise of the residual from the solution, see `uncertainty`.
        old_noise: noise of a call that has a solver in place of `noise`; deprecated, to be dropped
            in 0.5.
        starts: vectors of the unknowns to start from (p); the initial values by default.
        channels: rows of each channel in the residual, and the weight that they were divided by.
        facts: labels of the data, for reports.
        warnings: warnings about the data, kept before those of the fit.
        loss: loss function; with `huber` the fit goes on from the least-squares solution.
        rig: uncertain rig whose constants, if there are any, are unknowns in a further fit.

    Raises:
        FitError: no start could be solved, or the program has terms that the solver cannot honour.
    """
    make_noise: NoiseModel = old_noise or noise
    channels = channels or {}
    facts = dict(facts or {})
    program = as_program(problem)
    problem = program.problem
    if program.linear_terms().present:
        if loss != "squares" or rig is not None:
            raise FitError(f"{problem.name}: added terms need loss 'squares' and an exact rig")
        warnings = [*warnings, "the intervals do not know the added costs and constraints"]
    solution = influence = solve(program, starts)
    if loss == "huber":
        robust = solve_huber(problem, solution)
        solution, influence = robust.solution, robust.influence
        facts |= {"loss": loss, "outliers": robust.outliers}
    intervals = uncertainty(influence, make_noise(influence))
    result = make_result(solution, intervals, channels, facts, warnings)
    if rig is None or not rig.constants:
        return result
    return fit_constants(result, problem.parameters.all, rig, channels, warnings, loss)
