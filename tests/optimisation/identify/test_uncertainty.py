"""Intervals of fits: what is not determined, correlated noise, and parameters that stop at a
bound.
"""

import math

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt
from scipy.stats import norm, t

from aerodima.optimisation.identify.active_bounds import one_sided_quantile
from aerodima.optimisation.identify.fit_pipeline import fit
from aerodima.optimisation.identify.gauss_newton import solve
from aerodima.optimisation.identify.least_squares import (
    Parameter,
    Solution,
)
from aerodima.optimisation.identify.noise import (
    Noise,
    correlation_time,
    independent_noise,
    serial_noise,
)
from aerodima.optimisation.identify.uncertainty import uncertainty
from tests.optimisation.coverage import assert_held, draws
from tests.optimisation.identify.problems import problem_of


def line(y, t, *more):
    first = (Parameter("slope", "N/s", 1.0), Parameter("offset", "N", 0.0))
    return problem_of(lambda x: x[0] * t + x[1] - y, *first, *more)


def test_covariance_of_a_line_is_the_textbook_one():
    t = np.linspace(-1.0, 1.0, 11)
    solution = solve(line(2.0 * t + 0.3, t))
    sure = uncertainty(solution, Noise(np.full(11, 0.04)))
    # Var slope = sigma^2 / sum t^2, Var offset = sigma^2 / n
    assert np.diag(sure.covariance) == pytest.approx([0.04 / np.sum(t**2), 0.04 / 11.0], rel=1e-6)
    assert sure.upper[1] - solution.x[1] == pytest.approx(1.959964 * 0.2 / np.sqrt(11.0), rel=1e-5)


def test_errors_that_are_common_to_all_rows_do_not_average_out():
    t = np.linspace(-1.0, 1.0, 11)
    solution = solve(line(2.0 * t, t))
    sure = uncertainty(solution, Noise(np.full((11, 11), 0.25)))
    assert sure.standard_deviation == pytest.approx([0.0, 0.5], abs=1e-8)


@pytest.mark.parametrize("initial", [1.3, 0.0])
def test_a_parameter_without_effect_has_an_infinite_interval_and_is_named(initial):
    """Also where it stands at a bound, which is no active one then."""
    t = np.linspace(0.0, 1.0, 20)
    problem = line(3.0 * t, t, Parameter("cd", "1", initial, 0.0, 3.0))
    result = fit(problem, lambda s: independent_noise(s.residual, 3))
    assert not result["cd"].identifiable
    assert not result["cd"].bound
    assert (result["cd"].lower, result["cd"].upper) == (-np.inf, np.inf)
    assert result["slope"].identifiable
    assert result.unidentifiable == ("cd",)
    assert any("cd" in warning for warning in result.warnings)


def test_a_direction_that_is_not_determined_is_named_with_both_its_parameters():
    t = np.linspace(0.0, 1.0, 20)
    parameters = (Parameter(name, "1", 1.0) for name in "abc")
    problem = problem_of(lambda x: (x[0] + x[1]) * t + x[2] - 4.0 * t, *parameters)
    result = fit(problem, lambda s: independent_noise(s.residual, 3))
    assert [e.identifiable for e in result.estimates] == [False, False, True]
    (direction,) = result.unidentifiable
    assert direction in ("0.71 a - 0.71 b", "0.71 b - 0.71 a")


@pytest.mark.parametrize("known", [True, False])
def test_fewer_residuals_than_unknowns_leave_infinite_intervals(known):
    """Where the noise is not known either, no row is left to tell it."""
    parameters = (Parameter(name, "1", 0.5, 0.0, 1.0) for name in "abc")
    problem = problem_of(lambda p: np.array([p[0] + p[1] - 1.2, p[2] - 0.3]), *parameters)
    noise = Noise(np.full(2, 1e-4))
    result = fit(problem, lambda s: noise if known else independent_noise(s.residual, 3))
    assert [e.identifiable for e in result.estimates] == [False, False, known]
    assert [math.isinf(e.upper - e.lower) for e in result.estimates] == [True, True, not known]
    assert all(name in " ".join(result.unidentifiable) for name in ("a", "b", "c")[: 3 - known])


@pytest.mark.parametrize(("reach", "determined"), [(0.35, False), (0.01, True)])
def test_an_estimate_that_follows_an_open_angle_is_open_unless_the_angle_is_bound(
    reach, determined
):
    """At an angle of 0 its cosine has no slope: the linear theory sees nothing of it."""
    problem = problem_of(
        lambda p: p[:1] * np.cos(p[1]) - 1.0,
        Parameter("pull", "N", 1.0),
        Parameter("angle", "rad", 0.0, -reach, reach),
    )
    result = fit(problem, lambda _: Noise(np.array([1e-6])))
    assert not result["angle"].identifiable
    assert result["pull"].identifiable == determined


def test_filtered_white_noise_counts_as_far_fewer_samples():
    noise = np.random.default_rng(1).normal(size=40_000)
    assert correlation_time(noise) == pytest.approx(1.0, abs=0.1)
    filtered = sosfiltfilt(butter(6, 10.0, output="sos", fs=1000.0), noise)
    # Two passes leave white noise with the power spectrum 1 / (1 + (f / f_c)^12)^2; its integral
    # from 0 is B = f_c (pi / 12) / sin(pi / 12) (11 / 12) = 9.27 Hz, and the correlation time in
    # samples is f_s / (2 B). The first lobe of the ringing autocorrelation alone gives up to 1.18
    # times that (sine integral at pi over pi / 2).
    expected = 1000.0 / (2.0 * 9.27)
    assert 0.95 * expected <= correlation_time(filtered) <= 1.25 * expected


def test_first_order_noise_has_its_known_correlation_time():
    rho = 0.9
    x = lfilter([1.0], [1.0, -rho], np.random.default_rng(2).normal(size=100_000))
    assert correlation_time(x) == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.1)


def test_rounding_counts_as_white_and_only_what_is_left_by_its_correlation():
    t = np.arange(2000) * 0.001
    saw = (
        np.round(20.0 * t) - 20.0 * t
    )  # a slow passage through 40 steps: evenly spread, a period of 50 samples
    assert correlation_time(saw) > 5.0
    rounded = serial_noise(saw, [slice(None)], 2, rounding=1.0)
    assert rounded.effective_samples == pytest.approx(2000, rel=0.05)
    assert rounded.covariance[0] == pytest.approx(1.0 / 12.0, rel=0.05)
    slow = saw + 0.3 * np.sin(4.0 * t)  # the model's error
    noise = serial_noise(slow, [slice(None)], 2, rounding=1.0)
    assert noise.covariance[0] == pytest.approx(
        serial_noise(slow, [slice(None)], 2).covariance[0], rel=0.2
    )


@pytest.mark.parametrize("correlated", [False, True])
def test_unknowns_are_paid_for_out_of_the_effective_samples(correlated):
    """Residuals that rounding explains count singly, as in the textbook; others by their
    correlation.
    """
    residual = np.random.default_rng(1).normal(size=24)
    if correlated:
        residual = np.repeat(residual, 50)
    noise = serial_noise(residual, [slice(None)], 6, 0.0 if correlated else 10.0)
    if not correlated:
        assert noise.effective_samples == 24
        assert noise.covariance == pytest.approx(residual @ residual / (24 - 6))
    effective = noise.effective_samples
    assert noise.degrees_of_freedom == pytest.approx(effective - 6)
    # Each effective sample has the mean square of the residual, less what the unknowns took.
    power = np.mean(residual**2)
    assert noise.covariance[0] == pytest.approx(power * len(residual) / (effective - 6))


def test_channels_have_a_noise_of_their_own():
    residual = np.random.default_rng(1).normal(size=4000) * np.repeat([1.0, 5.0], 2000)
    noise = serial_noise(residual, [slice(0, 2000), slice(2000, 4000)], 2)
    assert noise.covariance[[0, -1]] == pytest.approx([1.0, 25.0], rel=0.2)


@draws(60, 600)
def test_intervals_of_filtered_data_hold_the_truth_in_95_percent(number):
    rng = np.random.default_rng(3)
    t = np.arange(4000) * 0.001
    sos = butter(6, 10.0, output="sos", fs=1000.0)
    A = np.column_stack([t, np.ones_like(t)])
    held = []
    naive = []
    for _ in range(number):
        y = A @ [0.7, 0.2] + sosfiltfilt(sos, rng.normal(size=len(t)))
        x = np.linalg.lstsq(A, y, rcond=None)[0]
        solution = Solution(line(y, t), x, A @ x - y, A, None, ())
        for noise, found in (
            (serial_noise(solution.residual, [slice(None)], 2), held),
            (independent_noise(solution.residual, 2), naive),
        ):
            sure = uncertainty(solution, noise)
            found.append((sure.lower <= [0.7, 0.2]) & (sure.upper >= [0.7, 0.2]))
    for good in np.transpose(held):
        assert_held(good)
    # Design section 11 quotes 23 % for intervals that take every sample as independent.
    assert np.mean(naive) < 0.35


@pytest.mark.parametrize("even", [0.0, 0.5, 2.0, 50.0])
def test_interval_of_a_rounded_reading_holds_95_percent(even):
    """One reading with a normal error of 1 and an evenly spread one within +-even."""
    solution = solve(problem_of(lambda x: x - 0.0, Parameter("x", "1", 0.0)))
    sure = uncertainty(
        solution, Noise(np.array([[1.0 + even**2 / 3.0]]), rounding=np.array([even]))
    )
    rng = np.random.default_rng(3)
    error = rng.normal(size=200_000) + even * rng.uniform(-1.0, 1.0, size=200_000)
    # 200 000 trials know 95 % to 0.05 %; below a share of 0.6 the sum is taken as normal.
    assert np.mean(np.abs(error) <= sure.upper[0]) == pytest.approx(0.95, abs=0.003)


def fitted(low=-math.inf, high=math.inf):
    """The line y = 2 x + 1 through eleven points of unit noise, its slope within bounds."""
    x = np.linspace(0.0, 10.0, 11)
    slope = Parameter("slope", "N/m", min(max(0.5, low), high), low, high)
    offset = Parameter("offset", "N", 0.0)
    problem = problem_of(lambda p: p[0] * x + p[1] - (2.0 * x + 1.0), slope, offset)
    return fit(problem, lambda solution: Noise(np.ones(11)))


def test_what_stopped_at_a_bound_is_one_sided_and_the_others_are_given_it():
    free = fitted()
    bound = fitted(high=1.9)
    slope = bound["slope"]
    # Deviations of the textbook: 1 / sqrt(sum (x - mean)^2) of the slope, 1 / sqrt(n) of the offset
    # with it given.
    deviation = 1.0 / math.sqrt(110.0)
    beyond = 0.1 / deviation
    inside = norm.isf(0.05 * norm.sf(beyond)) - beyond
    assert (slope.value, slope.upper, slope.bound) == (1.9, 1.9, "upper")
    assert slope.lower == pytest.approx(1.9 - inside * deviation, rel=1e-6)
    # With the slope kept, the offset is that of the mean point: 1 + 5 x 0.1.
    offset = bound["offset"]
    assert offset.value == pytest.approx(1.5, rel=1e-6)
    given = 1.959964 / math.sqrt(11.0)
    assert offset.lower == pytest.approx(
        1.5 - given, rel=1e-5
    )  # a smaller slope means a larger offset only
    assert offset.upper == pytest.approx(
        1.5 + math.hypot(given, 5.0 * inside * deviation), rel=1e-5
    )
    assert bound.covariance[1][1] < free.covariance[1][1]
    assert any("slope" in warning and "1.9 N/m" in warning for warning in bound.warnings)
    assert not free["slope"].bound


@pytest.mark.parametrize("far", [0.3, 3.0, 300.0])
def test_intervals_hold_their_estimates_however_wrong_the_bound(far):
    far /= math.sqrt(110.0)
    for limits in ((-math.inf, 2.0 - far), (2.0 + far, math.inf)):
        for estimate in fitted(*limits).estimates:
            assert estimate.identifiable
            assert estimate.lower <= estimate.value <= estimate.upper
            assert estimate.standard_deviation > 0.0
            assert estimate.lower < estimate.upper


@pytest.mark.parametrize("inside", [0.0, 0.5, 1.0, 2.0, 3.0])
@draws(150, 1500)
def test_intervals_hold_a_truth_near_the_bound_in_95_percent(number, inside):
    """Two parameters that errors couple by 0.9; the truth of the first stands so many deviations
    inside its bound.
    """
    rng = np.random.default_rng(4)
    root = np.linalg.cholesky(np.array([[1.0, 0.9], [0.9, 1.0]]))
    jacobian = np.linalg.inv(root)
    problem = problem_of(
        lambda p: p,
        Parameter("a", "1", 1.0, 0.0, scale=1.0),
        Parameter("b", "1", 0.0, scale=1.0),
        jacobian=lambda p: jacobian,
    )
    truth = np.array([inside, 0.0])
    held = []
    for error in rng.normal(size=(number, 2)):
        x = truth + root @ error
        if x[0] < 0.0:
            x = np.array([0.0, x[1] - 0.9 * x[0]])
        residual = jacobian @ (x - truth) - error
        solution = Solution(problem, x, residual, jacobian, None, ())
        sure = uncertainty(solution, Noise(np.ones(2)))
        held.append((sure.lower <= truth) & (truth <= sure.upper))
        assert np.all((sure.lower <= x) & (x <= sure.upper))
    for good in np.transpose(held):
        if inside > 2.0:
            assert_held(good)
        # Near its bound an interval may hold more than it promises, never less.
        assert np.mean(good) > 0.95 - 3.3 * math.sqrt(0.95 * 0.05 / number)


@pytest.mark.parametrize("freedom", [3.0, 40.0, math.inf])
def test_the_one_sided_quantile_is_that_of_the_tail_and_stays_finite_far_out(freedom):
    for beyond in (0.0, 1.0, 4.0):
        q = one_sided_quantile(beyond, freedom)
        assert t.sf(beyond + q, freedom) == pytest.approx(0.05 * t.sf(beyond, freedom))
    # On both sides of the smallest tail.
    near, far = (one_sided_quantile(beyond, freedom) for beyond in (33.0, 34.0))
    assert far == pytest.approx(near, rel=0.05)
    assert 0.0 < one_sided_quantile(1e6, freedom) < math.inf
    assert one_sided_quantile(0.0, math.inf) == pytest.approx(1.959964, rel=1e-6)


def test_two_bounds_at_once():
    x = np.linspace(-1.0, 1.0, 21)
    bounds = {"a": 1.0, "b": 1.0, "c": 9.0}
    parameters = (Parameter(name, "1", 0.0, -end, end) for name, end in bounds.items())
    # The minimum without bounds is 2 - 3 x + x^2 / 2.
    problem = problem_of(lambda p: np.polyval(p[::-1] - [0.5, -3.0, 2.0], x), *parameters)
    result = fit(problem, lambda solution: Noise(np.full(21, 0.01)))
    assert (result["a"].bound, result["b"].bound, result["c"].bound) == ("upper", "lower", "")
    assert result["a"].lower < 1.0 == result["a"].upper
    assert result["b"].lower == -1.0 < result["b"].upper
    assert all(e.lower <= e.value <= e.upper for e in result.estimates)
