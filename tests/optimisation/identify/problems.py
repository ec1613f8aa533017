"""Problems of tests, of a few unknowns."""

from aerodima.optimisation.identify.least_squares import Parameters, Problem


def problem_of(residual, *parameters, **options):
    return Problem(Parameters.of(parameters), residual, **options)
