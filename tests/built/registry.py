"""Registries of what the rows of `models/published/statements.yaml` name: checks, runs, and which
of these are slow.
"""

CHECKS = {}
RUNS = {}
SLOW = set()


def check(function):
    """Registers what is found without a simulation under its own name."""
    CHECKS[function.__name__] = function
    return function


def run(function):
    """Registers what a few runs show under its own name."""
    RUNS[function.__name__] = function
    return function


def slow(function):
    """Registers what many runs show."""
    SLOW.add(function.__name__)
    return run(function)
