"""Problems of tests, of a few unknowns."""

import numpy as np

from aerodima.optimisation.identify.fit_pipeline import fit
from aerodima.optimisation.identify.least_squares import Parameter, Parameters, Problem
from aerodima.optimisation.identify.noise import independent_noise


def problem_of(residual, *parameters, **options):
    return Problem(Parameters.of(parameters), residual, **options)


def fit_line(x, y, loss="squares", name="line"):
    """Fits slope and offset of a line through points (n)."""
    height = np.std(y)
    slope = Parameter("slope", "1", 0.0, scale=height / np.std(x))
    offset = Parameter("offset", "1", 0.0, scale=height)
    design = np.column_stack([x, np.ones_like(x)]) / height
    problem = problem_of(
        lambda p: design @ p - y / height, slope, offset, jacobian=lambda _: design, name=name
    )
    return fit(problem, lambda solution: independent_noise(solution.residual, 2), loss=loss)
