"""Parameters of a fit: bounds, fixed ones, starts, and what is refused."""

import math
from dataclasses import replace

import pytest

from aerodima.optimisation.identify.least_squares import Parameter, Parameters
from aerodima.workbench.core.errors import FitError
from tests.refusals import assert_refused

AB = Parameters.of([Parameter("a", "1", 1.0, 0.0, 2.0), Parameter("b", "m", 5.0, 0.0, 9.0)])


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Parameter("cd", "1", 1.3, 0.0, 1.0), ("cd", "1.3", "0", "1")),
        (lambda: Parameter("cd", "1", math.nan), ("cd", "nan")),
        (lambda: Parameter("cd", "1", 0.5, 1.0, 0.0), ("cd",)),
        (lambda: Parameter("cd", "1", 0.5, math.nan, 1.0), ("cd", "nan")),
        (lambda: Parameter("cd", "1", 0.0, 0.0, 0.0), ("cd",)),
        (lambda: Parameters.of([Parameter("a", "1", 1.0)] * 2), ("'a'",)),
        (lambda: Parameters.of([Parameter("a", "1", 1.0, fixed=True)]), ("free",)),
        (lambda: AB.starts([{"c": 1.0}]), ("c", "a, b")),
        (lambda: AB.starts([{"a": 3.0}]), ("'a'", "3")),
    ],
)
def test_impossible_parameters_are_refused(make, named):
    assert_refused(make, FitError, *named)


def test_fixed_parameters_keep_their_place_and_may_stand_outside_their_bounds():
    parameters = Parameters.of(
        [
            Parameter("a", "1", 1.0),
            Parameter("b", "m", 2.0, 0.0, 1.0, fixed=True),
            Parameter("c", "1", 3.0),
        ]
    )
    assert parameters.names == ("a", "c")
    assert parameters.values([10.0, 30.0]) == {"a": 10.0, "b": 2.0, "c": 30.0}


def test_the_old_name_of_the_initial_value_warns_and_is_the_same_number():
    with pytest.warns(DeprecationWarning, match="initial="):
        parameter = Parameter("a", "m", seed=2.0)
    with pytest.warns(DeprecationWarning, match="initial"):
        assert parameter.seed == 2.0
    assert replace(parameter, initial=3.0).initial == 3.0
