"""Intervals of fits that stop at a bound: they hold their estimate, and the truth when it lies within the bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm, t

from aerodima.optimisation.fit.active_bounds import reach_inside
from aerodima.optimisation.fit.fit_parameters import Parameter, Parameters
from aerodima.optimisation.fit.fit_pipeline import FitResult, fit
from aerodima.optimisation.fit.fit_report import in_words
from aerodima.optimisation.fit.least_squares import Problem, Solution, solve_rollout
from aerodima.optimisation.fit.uncertainty import Noise, uncertainty


def fitted(y: np.ndarray, x: np.ndarray, low: float = -math.inf, high: float = math.inf) -> FitResult:
    """A line through points of unit noise, its slope within bounds."""
    seed = min(max(0.5, low), high)
    parameters = Parameters.of([Parameter("slope", "N/m", seed, low, high), Parameter("offset", "N", 0.0)])
    problem = Problem(parameters, lambda p: p[0] * x + p[1] - y)
    return fit(problem, solve_rollout, lambda solution: Noise(np.ones(len(x))))


def test_what_stopped_at_a_bound_is_one_sided_and_the_others_are_given_it() -> None:
    x = np.linspace(0.0, 10.0, 11)
    free, bound = fitted(2.0 * x + 1.0, x), fitted(2.0 * x + 1.0, x, high=1.9)
    slope = bound["slope"]
    # Deviations of the textbook: 1 / sqrt(sum (x - mean)^2) of the slope, 1 / sqrt(n) of the offset with it given.
    deviation = 1.0 / math.sqrt(110.0)
    beyond = 0.1 / deviation
    inside = norm.isf(0.05 * norm.sf(beyond)) - beyond
    assert (slope.value, slope.upper, slope.bound) == (1.9, 1.9, "upper")
    assert slope.lower == pytest.approx(1.9 - inside * deviation, rel=1e-6)
    # With the slope kept, the offset is that of the mean point: 1 + 5 x 0.1.
    offset = bound["offset"]
    assert offset.value == pytest.approx(1.5, rel=1e-6)
    given = 1.959964 / math.sqrt(11.0)
    assert offset.lower == pytest.approx(1.5 - given, rel=1e-5)  # a smaller slope means a larger offset only
    assert offset.upper == pytest.approx(1.5 + math.hypot(given, 5.0 * inside * deviation), rel=1e-5)
    assert bound.covariance[1][1] < free.covariance[1][1]
    assert any("slope stopped at its upper bound 1.9 N/m, 1 standard deviations" in w for w in bound.warnings)
    assert "the intervals of the others take slope to lie within bounds" in bound.warnings
    assert "one-sided: at its upper bound" in in_words(slope)
    assert not free["slope"].bound


@pytest.mark.parametrize("far", [0.3, 3.0, 300.0])
def test_intervals_hold_their_estimates_however_wrong_the_bound(far: float) -> None:
    x = np.linspace(0.0, 10.0, 11)
    deviation = 1.0 / math.sqrt(110.0)
    for low, high in ((-math.inf, 2.0 - far * deviation), (2.0 + far * deviation, math.inf)):
        result = fitted(2.0 * x + 1.0, x, low, high)
        for estimate in result.estimates:
            assert estimate.identifiable
            assert estimate.lower <= estimate.value <= estimate.upper
            assert estimate.standard_deviation > 0.0
            assert estimate.lower < estimate.upper


def test_intervals_hold_a_truth_near_the_bound_in_95_percent() -> None:
    """Two parameters that errors couple by 0.9; the truth of the first stands 0 to 3 deviations inside its bound."""
    rng = np.random.default_rng(4)
    root = np.linalg.cholesky(np.array([[1.0, 0.9], [0.9, 1.0]]))
    jacobian = np.linalg.inv(root)
    parameters = Parameters.of([Parameter("a", "1", 1.0, 0.0, scale=1.0), Parameter("b", "1", 0.0, scale=1.0)])
    held: dict[float, list[np.ndarray]] = {}
    stopped = []
    for inside in (0.0, 0.5, 1.0, 2.0, 3.0):
        truth = np.array([inside, 0.0])
        for error in rng.normal(size=(800, 2)):
            x = truth + root @ error
            if x[0] < 0.0:
                x = np.array([0.0, x[1] - 0.9 * x[0]])
            problem = Problem(parameters, lambda p: p, lambda p: jacobian)
            residual = jacobian @ (x - truth) - error
            solution = Solution(problem, x, residual, jacobian, None, ())  # type: ignore[arg-type]
            sure = uncertainty(solution, Noise(np.ones(2)))
            good = (sure.lower <= truth) & (truth <= sure.upper)
            held.setdefault(inside, []).append(good)
            assert np.all((sure.lower <= x) & (x <= sure.upper))
            if x[0] == 0.0:
                stopped.append(good)
    # 800 trials know a share of 95 % to 0.8 %.
    shares = {inside: np.mean(good, axis=0) for inside, good in held.items()}
    assert all(np.all(share > 0.93) for share in shares.values()), shares
    assert np.mean(held[3.0]) < 0.97
    assert len(stopped) > 500


@pytest.mark.parametrize("freedom", [3.0, 40.0, math.inf])
def test_the_reach_inside_is_that_of_the_tail_and_stays_finite_far_out(freedom: float) -> None:
    for beyond in (0.0, 1.0, 4.0):
        q = reach_inside(beyond, freedom)
        assert t.sf(beyond + q, freedom) == pytest.approx(0.05 * t.sf(beyond, freedom))
    near, far = reach_inside(33.0, freedom), reach_inside(34.0, freedom)  # on both sides of the smallest tail
    assert far == pytest.approx(near, rel=0.05)
    assert 0.0 < reach_inside(1e6, freedom) < math.inf
    assert reach_inside(0.0, math.inf) == pytest.approx(1.959964, rel=1e-6)


def test_a_bound_that_the_data_do_not_see_is_no_active_one() -> None:
    x = np.linspace(0.0, 10.0, 11)
    parameters = Parameters.of([Parameter("slope", "N/m", 0.5), Parameter("speed", "m/s", 0.0, 0.0, 1.0)])
    problem = Problem(parameters, lambda p: p[0] * x - 2.0 * x)
    result = fit(problem, solve_rollout, lambda solution: Noise(np.ones(len(x))))
    assert not result["speed"].identifiable
    assert not result["speed"].bound
    assert result["slope"].identifiable


def test_two_bounds_at_once() -> None:
    x = np.linspace(-1.0, 1.0, 21)
    parameters = Parameters.of(
        [Parameter("a", "1", 0.0, -1.0, 1.0), Parameter("b", "1", 0.0, -1.0, 1.0), Parameter("c", "1", 0.0, -9.0, 9.0)]
    )
    problem = Problem(parameters, lambda p: p[0] + p[1] * x + p[2] * x**2 - (2.0 - 3.0 * x + 0.5 * x**2))

    result = fit(problem, solve_rollout, lambda solution: Noise(np.full(21, 0.01)))
    assert (result["a"].bound, result["b"].bound, result["c"].bound) == ("upper", "lower", "")
    assert result["a"].lower < 1.0 == result["a"].upper
    assert result["b"].lower == -1.0 < result["b"].upper
    assert all(e.lower <= e.value <= e.upper for e in result.estimates)
