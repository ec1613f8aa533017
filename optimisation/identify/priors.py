"""Fits whose constants are known beforehand, but not exactly: each is an unknown with a prior, beside those of the fit.

The residual is whitened by its noise, and every constant adds a row (value - seed) / deviation. The data then correct
the constants as far as they can, and what stays open is in every interval; how much of it, is the budget.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from aerodima.optimisation.identify.fit_parameters import Parameter, Parameters
from aerodima.optimisation.identify.fit_pipeline import FitResult, NoiseModel, result_of
from aerodima.optimisation.identify.least_squares import Loss, Problem, Solution, huber, solve
from aerodima.optimisation.identify.least_squares_solvers import solve_rollout
from aerodima.optimisation.identify.residual_noise import Noise
from aerodima.optimisation.identify.uncertainty import uncertainty

_NEGLIGIBLE = 0.03
"""A constant whose standard deviation moves the whitened residual by less is left as it is."""
_ROUNDS, _SETTLED = 4, 0.1
_STRANGE = 3.5
"""Prior standard deviations beyond which the shift of a constant is told."""
_CHANCE = 1e-4
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class _Whitening:
    """Of the data's residual: times `matrix`, or by element; `back` undoes it."""

    matrix: np.ndarray

    @classmethod
    def of(cls, covariance: np.ndarray) -> _Whitening:
        if covariance.ndim == 1:
            return cls(1.0 / np.sqrt(np.maximum(covariance, 1e-300)))
        size = np.sqrt(np.diag(covariance))
        lower = np.linalg.cholesky(covariance / np.outer(size, size) + 1e-12 * np.eye(len(size)))
        return cls(np.linalg.inv(lower) / size)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        if self.matrix.ndim == 2:
            return self.matrix @ rows
        return self.matrix * rows if rows.ndim == 1 else self.matrix[:, None] * rows

    def back(self, rows: np.ndarray) -> np.ndarray:
        if self.matrix.ndim == 2:
            return np.linalg.solve(self.matrix, rows)
        return rows / self.matrix if rows.ndim == 1 else rows / self.matrix[:, None]


def fit_with_priors(
    make: Callable[[Parameters], Problem],
    parameters: Sequence[Parameter],
    constants: Sequence[Parameter],
    first: FitResult,
    noise: NoiseModel,
    *,
    least_noise: NoiseModel | None = None,
    channels: Mapping[str, tuple[slice, float]],
    warnings: Sequence[str] = (),
    loss: Loss = "squares",
) -> FitResult:
    """Goes on from a fit with exact constants.

    Args:
        make: the problem of the data's residual in some parameters, the constants among them.
        parameters: of the fit.
        constants: with their deviation; those with an infinite one are free and become parameters of the result.
        first: result of the fit with the constants at their seeds.
        noise: of the data's residual, from a solution in all parameters.
        least_noise: what it would be if the model were right: with it the constants are first let go, since an error of
            theirs must not be taken for noise. That of `noise` by default.
        channels, warnings: see `fit`.
        loss: `huber` bends the whitened residual beyond 1.345.

    Raises:
        FitError: no finite residual on the way.
    """
    start = {e.name: e.value for e in first.estimates}
    given = [p if p.frozen else replace(p, seed=min(max(start[p.name], p.lower), p.upper)) for p in parameters]
    problem = make(Parameters.of([*given, *constants]))
    x = problem.parameters.seed
    raw = _at(problem, x, problem.central_differences(x))
    found = (least_noise or noise)(raw)
    whiten = _Whitening.of(found.covariance)
    effect = np.linalg.norm(whiten(raw.jacobian), axis=0) * [
        p.deviation if _has_prior(p) else 1.0 for p in problem.parameters.free
    ]
    kept = [
        replace(c, frozen=effect[problem.parameters.names.index(c.name)] < _NEGLIGIBLE) if _has_prior(c) else c
        for c in constants
    ]
    problem = make(Parameters.of([*given, *kept]))
    raw = _at(problem, problem.parameters.seed, np.empty(0))
    for _ in range(_ROUNDS):
        whiten = _Whitening.of(found.covariance)
        solution = solve(_weighed(problem, whiten, loss), solve_rollout, [raw.x])
        rows = len(raw.residual)
        raw = _at(problem, solution.x, whiten.back(solution.jacobian[:rows]))
        before, found = found, noise(raw)
        if abs(math.log(_size(found) / _size(before))) < _SETTLED:
            break
    sure = uncertainty(
        solution, Noise(np.ones(len(solution.residual)), found.degrees_of_freedom, found.effective_samples)
    )
    best = replace(solution.best, cost=0.5 * float(raw.residual @ raw.residual))
    told = replace(raw, best=best, attempts=())
    result = result_of(told, sure, channels, first.facts, warnings)
    return _without_constants(result, first, solution, rows, kept)


def _has_prior(p: Parameter) -> bool:
    return math.isfinite(p.deviation)


def _size(noise: Noise) -> float:
    S = noise.covariance
    return float(np.mean(S) if S.ndim == 1 else np.mean(np.diag(S)))


def _at(problem: Problem, x: np.ndarray, jacobian: np.ndarray) -> Solution:
    """A solution that nobody looked for."""
    return Solution(problem, x, np.asarray(problem.residual(x), float), jacobian, best=None, attempts=())  # type: ignore[arg-type]


def _weighed(problem: Problem, whiten: _Whitening, loss: Loss) -> Problem:
    """The whitened residual, then a row per constant with a prior."""
    free = problem.parameters.free
    places = [i for i, p in enumerate(free) if _has_prior(p)]
    deviations = np.array([free[i].deviation for i in places])

    def residual(x: np.ndarray) -> np.ndarray:
        data = whiten(np.asarray(problem.residual(x), float))
        return np.concatenate([huber(data) if loss == "huber" else data, np.asarray(x, float)[places] / deviations])

    return replace(problem, residual=residual, jacobian=None)


def _without_constants(
    result: FitResult, first: FitResult, solution: Solution, rows: int, constants: Sequence[Parameter]
) -> FitResult:
    """The constants out of the estimates, into their own place; the budget; what is strange about them."""
    free = solution.problem.parameters.free
    known = {c.name for c in constants if _has_prior(c)}
    kept = [i for i, p in enumerate(free) if p.name not in known]
    scales = np.array([p.size for p in free])
    parts = np.square(np.linalg.pinv(solution.jacobian * scales))
    sources = ["noise", *(p.name for p in free if p.name in known)]
    shares = np.column_stack([parts[:, :rows].sum(axis=1), parts[:, rows:]]) / parts.sum(axis=1, keepdims=True)
    budget = {
        free[i].name: {
            source: float(share)
            for source, share in sorted(zip(sources, shares[i], strict=True), key=lambda pair: -pair[1])
            if share >= _LEAST_SHARE
        }
        for i in kept
        if result[free[i].name].identifiable
    }
    told = {
        e.name: {"shift": e.value, "deviation": e.standard_deviation, "known_to": p.deviation}
        for p in free
        if p.name in known
        for e in [result[p.name]]
    }
    names = {p.name for p in free} - known | {e.name for e in first.estimates if e.frozen}
    unidentifiable = tuple(text for text in result.unidentifiable if text.split(" ")[0] not in known)
    hidden = {f"the data do not determine {text}" for text in set(result.unidentifiable) - set(unidentifiable)}
    warnings = [text for text in result.warnings if text not in hidden and text.split(" ")[0] not in known]
    return replace(
        result,
        estimates=tuple(e for e in result.estimates if e.name in names),
        covariance=tuple(tuple(result.covariance[i][j] for j in kept) for i in kept),
        attempts=first.attempts,
        unidentifiable=unidentifiable,
        warnings=(*warnings, *_strange(told), *_misfit(solution, len(kept))),
        curves=first.curves,
        rig=first.rig,
        budget=budget,
        constants=told,
    )


def _strange(constants: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Constants that the data want elsewhere than the scenario has them."""
    return [
        f"the data want {name} shifted by {c['shift']:.3g}, {abs(c['shift']) / c['known_to']:.1f} of its standard "
        f"deviations ({c['known_to']:.2g}): set it, or free it (--free {name})"
        for name, c in constants.items()
        if abs(c["shift"]) > _STRANGE * c["known_to"]
    ]


def _misfit(solution: Solution, unknowns: int) -> list[str]:
    """Whether what is left is more than noise and constants explain."""
    priors = sum(_has_prior(p) for p in solution.problem.parameters.free)
    freedom = len(solution.residual) - priors - unknowns
    power = float(solution.residual @ solution.residual)
    if freedom < 1 or freedom > 50 or chdtrc(freedom, power) > _CHANCE:
        return []
    return [
        f"noise and constants do not explain the data: what is left is {power / freedom:.3g} times what they allow; a "
        "constant is further off than its uncertainty says, or something else is wrong"
    ]
