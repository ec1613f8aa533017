"""Fits with constants of a rig that are known beforehand, but not exactly.

They are unknowns with a prior beside those of the fit. The residual is whitened by its noise, and
every constant adds a row (value - initial) / prior_std. The data then correct the constants as far
as they can, and the uncertainty that is left is in every interval; the budget has the shares.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from aerodima.optimisation.identify.active_bounds import RANK_TOLERANCE
from aerodima.optimisation.identify.fit_result import Channels, FitResult, make_result
from aerodima.optimisation.identify.gauss_newton import solve
from aerodima.optimisation.identify.huber import Loss, clip, huberised, spread
from aerodima.optimisation.identify.least_squares import Parameter, Parameters, Problem, Solution
from aerodima.optimisation.identify.noise import Noise
from aerodima.optimisation.identify.uncertainty import uncertainty
from aerodima.workbench.core.array_types import FloatArray

_NEGLIGIBLE = 0.03
"""Change of the whitened residual, for a standard deviation of a constant, below which the constant
is left as it is."""
_MAX_ITERATIONS = 4
"""Largest number of fits, each with the noise taken anew."""
_SETTLED = 0.1
"""Change of the logarithm of the noise's size below which it has settled."""
MAX_SHIFT_SIGMA = 3.5
"""Number of prior standard deviations beyond which the shift of a constant is reported."""
_MISFIT_PROBABILITY = 1e-4
"""Probability of a misfit below which it is reported."""
_MAX_FREEDOM = 50
"""Largest number of degrees of freedom of the data with which such a misfit is reported."""
_MIN_SHARE = 1e-3
"""Smallest share of a source that the budget names."""
MISFITS = ("the data want ", "noise and constants ")
"""Beginnings of the warnings of constants far from their prior, and of an unexplained residual."""
NoiseModel = Callable[[Solution], Noise]


@dataclass(frozen=True)
class UncertainRig:
    """The constants of a rig as unknowns of a fit.

    Attributes:
        constants: constants with their prior; those without one are free and become parameters of
            the result.
        problem: function that states the problem of the data's residual in some parameters, the
            constants among them.
        noise: function that makes the noise of the data's residual from a solution in all
            parameters.
        least_noise: function that makes the noise as if the model were right; the first fit uses
            it, since an error of the constants must not be taken for noise.
    """

    constants: Sequence[Parameter]
    problem: Callable[[Parameters], Problem]
    noise: NoiseModel
    least_noise: NoiseModel


def fit_constants(
    first: FitResult,
    parameters: Sequence[Parameter],
    rig: UncertainRig,
    channels: Channels,
    warnings: Sequence[str],
    loss: Loss,
) -> FitResult:
    """Go on from a fit with exact constants; `huber` bends the whitened residual beyond 1.345."""
    given = [p if p.fixed else p.starting_at(first[p.name].value) for p in parameters]
    problem, noise = _with_moving_constants(rig, given, loss)
    data = _unsolved(problem, problem.parameters.initial, np.empty(0))
    rows = len(data.residual)
    for _ in range(_MAX_ITERATIONS):
        whitening = Whitening.from_covariance(noise.covariance)
        solution = solve(_whitened(problem, whitening, loss), [data.x])
        data = _unsolved(problem, solution.x, whitening.undo(solution.jacobian[:rows]))
        previous = noise
        noise = rig.noise(_influence(data, loss))
        if abs(math.log(_size(noise) / _size(previous))) < _SETTLED:
            break
    ones = Noise(np.ones(len(solution.residual)), noise.degrees_of_freedom, noise.effective_samples)
    intervals = uncertainty(solution, ones)
    best = replace(solution.best, cost=0.5 * float(data.residual @ data.residual))
    shifts = problem.parameters.by_name(solution.x)
    deviations = problem.parameters.by_name(intervals.standard_deviation)
    known = {c.name: c.prior_std for c in rig.constants if c.has_prior}
    constants = {
        name: {"shift": shifts[name], "deviation": deviations[name], "known_to": prior}
        for name, prior in known.items()
        if name in shifts
    }
    result = make_result(
        replace(data, best=best), intervals, channels, first.facts, warnings, known
    )
    result = replace(result, attempts=first.attempts, constants=constants)
    result = _with_budget(result, solution, rows)
    found = [*result.warnings, *_misfit_warnings(result, solution, rows)]
    return replace(result, warnings=tuple(found))


def _with_moving_constants(
    rig: UncertainRig, given: list[Parameter], loss: Loss
) -> tuple[Problem, Noise]:
    """State the problem with constants without effect fixed; also return its least noise."""
    problem = rig.problem(Parameters.of([*given, *rig.constants]))
    x = problem.parameters.initial
    start = _unsolved(problem, x, problem.central_jacobian(x))
    noise = rig.least_noise(_influence(start, loss))
    sizes = [p.prior_std if p.has_prior else 1.0 for p in problem.parameters.free]
    whitened = Whitening.from_covariance(noise.covariance)(start.jacobian)
    effects = np.linalg.norm(whitened, axis=0) * sizes
    effect = problem.parameters.by_name(effects)
    kept = [replace(c, fixed=c.has_prior and effect[c.name] < _NEGLIGIBLE) for c in rig.constants]
    return rig.problem(Parameters.of([*given, *kept])), noise


@dataclass(frozen=True)
class Whitening:
    """Whitening of the data's residual by a product with `matrix` (m x m), or by element (m)."""

    matrix: FloatArray

    @classmethod
    def from_covariance(cls, covariance: FloatArray) -> Whitening:
        """Make the whitening for a covariance (m x m), singular or not, or its diagonal (m)."""
        if covariance.ndim == 1:
            return cls(1.0 / np.sqrt(np.maximum(covariance, 1e-300)))
        size = np.sqrt(np.diag(covariance))
        lower = np.linalg.cholesky(covariance / np.outer(size, size) + 1e-12 * np.eye(len(size)))
        return cls(np.linalg.inv(lower) / size)

    def __call__(self, rows: FloatArray) -> FloatArray:
        """Whiten a residual (m), or the columns of an array (m x n)."""
        if self.matrix.ndim == 2:
            return self.matrix @ rows
        return (rows.T * self.matrix).T

    def undo(self, rows: FloatArray) -> FloatArray:
        """Return the residual (m), or the columns (m x n), before it was whitened."""
        if self.matrix.ndim == 2:
            return np.linalg.solve(self.matrix, rows)
        return (rows.T / self.matrix).T


def _size(noise: Noise) -> float:
    S = noise.covariance
    return float(np.mean(S if S.ndim == 1 else np.diag(S)))


def _unsolved(problem: Problem, x: FloatArray, jacobian: FloatArray) -> Solution:
    """Make a solution that holds residual and Jacobian at x, without solving."""
    residual = problem.finite_residual(x)
    return Solution(problem, x, residual, jacobian, best=None, attempts=())  # type: ignore[arg-type]


def _influence(solution: Solution, loss: Loss) -> Solution:
    """Keep wild samples out of the noise: clip the residual as Huber's loss does, and divide it by
    the share within the limit, as in the covariance of that loss.
    """
    if loss == "squares":
        return solution
    clipped, within = clip(solution.residual, spread(solution.residual))
    # At least half of a residual about zero lies within the limit.
    return replace(solution, residual=clipped / max(within, 0.5))


def _whitened(problem: Problem, whitening: Whitening, loss: Loss) -> Problem:
    """State the whitened residual, then a row per constant with a prior."""
    free = problem.parameters.free
    priors = np.diag([1.0 / p.prior_std for p in free])[[p.has_prior for p in free]]
    data = replace(problem, residual=lambda x: whitening(problem.finite_residual(x)), jacobian=None)
    if loss == "huber":
        data = huberised(data, 1.0)

    def residual(x: FloatArray) -> FloatArray:
        return np.append(data.residual(x), priors @ x)

    def jacobian(x: FloatArray) -> FloatArray:
        return np.vstack([data.central_jacobian(x), priors])

    return replace(problem, residual=residual, jacobian=jacobian if loss == "huber" else None)


def _with_budget(result: FitResult, solution: Solution, rows: int) -> FitResult:
    """Give the result its budget, and the deviations that noise alone would give.

    Args:
        result: result of the fit.
        solution: solution of the whitened problem.
        rows: number of rows of the data; the others are priors.
    """
    parameters = solution.problem.parameters
    names = parameters.names
    fitted = [i for i, name in enumerate(names) if name not in result.constants]
    sources = ["noise", *result.constants]
    J = solution.jacobian * parameters.scales
    parts = np.square(np.linalg.pinv(J, RANK_TOLERANCE))
    split = np.column_stack([parts[:, :rows].sum(axis=1), parts[:, rows:]])
    shares = split / np.maximum(parts.sum(axis=1, keepdims=True), 1e-300)
    exact = np.linalg.norm(np.linalg.pinv(J[:rows, fitted], RANK_TOLERANCE), axis=1)
    estimates = {e.name: e for e in result.estimates}
    budget = {}
    for i, scaled in zip(fitted, exact.tolist(), strict=True):
        name = names[i]
        e = estimates[name]
        deviation = math.inf
        if e.identifiable:
            deviation = min(scaled * float(parameters.scales[i]), e.standard_deviation)
            pairs = zip(sources, shares[i].tolist(), strict=True)
            largest = sorted(pairs, key=lambda pair: -pair[1])
            budget[name] = {source: share for source, share in largest if share >= _MIN_SHARE}
        estimates[name] = replace(e, noise_deviation=deviation)
    return replace(result, estimates=tuple(estimates.values()), budget=budget)


def _misfit_warnings(result: FitResult, solution: Solution, rows: int) -> list[str]:
    """Warn of constants far from their prior, and of an unexplained residual."""
    warnings = []
    for name, constant in result.constants.items():
        shift = constant["shift"]
        prior = constant["known_to"]
        if abs(shift) > MAX_SHIFT_SIGMA * prior:
            warnings.append(
                f"{MISFITS[0]}{name} shifted by {shift:.3g}, {abs(shift) / prior:.1f} of its "
                f"standard deviations ({prior:.2g}): set it, or free it (--free {name})"
            )
    freedom = rows - len(result.free)
    power = float(solution.residual @ solution.residual)
    if 1 <= freedom <= _MAX_FREEDOM and chdtrc(freedom, power) <= _MISFIT_PROBABILITY:
        warnings.append(
            f"{MISFITS[1]}do not explain the data: what is left is {power / freedom:.3g} "
            "times what they allow; a constant is further off than its uncertainty says, or "
            "something else is wrong"
        )
    return warnings
