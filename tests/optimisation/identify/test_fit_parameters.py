from __future__ import annotations

import math

import numpy as np
import pytest

from aerodima.optimisation.identify.least_squares import Parameter, Parameters
from aerodima.workbench.errors import FitError


def test_bounds_that_exclude_the_seed_are_refused_with_name_value_and_bounds() -> None:
    with pytest.raises(FitError, match=r"'cd'.*seed 1\.3 1 lies outside its bounds 0 \.\. 1"):
        Parameter("cd", "1", 1.3, 0.0, 1.0)


def test_a_frozen_parameter_may_stand_outside_its_bounds_but_must_be_finite() -> None:
    assert Parameter("cd", "1", 1.3, 0.0, 1.0, frozen=True).seed == 1.3
    with pytest.raises(FitError, match=r"'cd'.*nan"):
        Parameter("cd", "1", math.nan)


@pytest.mark.parametrize(("lower", "upper"), [(1.0, 0.0), (math.nan, 1.0), (0.0, 0.0)])
def test_bounds_that_hold_no_value_are_refused(lower: float, upper: float) -> None:
    with pytest.raises(FitError, match="hold no value"):
        Parameter("cd", "1", 0.5, lower, upper)


def test_frozen_parameters_keep_their_place_among_the_values() -> None:
    parameters = Parameters.of(
        [Parameter("a", "1", 1.0), Parameter("b", "m", 2.0, frozen=True), Parameter("c", "1", 3.0)]
    )
    assert parameters.names == ("a", "c")
    assert parameters.values([10.0, 30.0]) == {"a": 10.0, "b": 2.0, "c": 30.0}


def test_two_of_a_name_and_nothing_free_are_refused() -> None:
    with pytest.raises(FitError, match="named twice: a"):
        Parameters.of([Parameter("a", "1", 1.0), Parameter("a", "1", 2.0)])
    with pytest.raises(FitError, match="nothing to fit"):
        Parameters.of([Parameter("a", "1", 1.0, frozen=True)])


def test_starts_are_the_seed_then_named_ones() -> None:
    parameters = Parameters.of([Parameter("a", "1", 1.0, 0.0, 2.0), Parameter("b", "m", 5.0)])
    assert [start.tolist() for start in parameters.starts([{"b": 7.0}])] == [[1.0, 5.0], [1.0, 7.0]]


def test_a_seed_of_an_unknown_name_lists_the_known_ones() -> None:
    parameters = Parameters.of([Parameter("a", "1", 1.0, 0.0, 2.0)])
    with pytest.raises(FitError, match="seed for b: the free parameters are a"):
        parameters.starts([{"b": 1.0}])
    with pytest.raises(FitError, match="outside its bounds"):
        parameters.starts([{"a": 3.0}])


def test_active_bounds_are_named_by_side() -> None:
    parameters = Parameters.of(
        [Parameter("a", "1", 1.0, 0.0, 2.0), Parameter("b", "1", 1.0, 0.0, 2.0)]
    )
    assert parameters.active(np.array([0.0, 1.0])) == {"a": "lower"}
    assert parameters.active(np.array([1.0, 2.0])) == {"b": "upper"}
