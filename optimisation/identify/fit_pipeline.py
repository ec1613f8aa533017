"""The pipeline of every fit: parameters -> data -> residual -> solve -> result with intervals and
warnings.

Constants of a rig that are known beforehand, but not exactly, are unknowns with a prior beside
those of the fit. The residual is whitened by its noise, and every constant adds a row (value -
seed) / deviation. The data then correct the constants as far as they can, and what stays open is in
every interval; the budget has the shares.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AliasChoices, Field
from scipy.special import chdtrc

from aerodima.optimisation.identify.least_squares import (
    Attempt,
    Loss,
    Parameter,
    Parameters,
    Problem,
    Solution,
    Solver,
    huber,
    solve,
    solve_huber,
)
from aerodima.optimisation.identify.least_squares_solvers import solve_rollout
from aerodima.optimisation.identify.uncertainty import Noise, Uncertainty, uncertainty
from aerodima.workbench.core.array_types import FloatArray

_NEGLIGIBLE = 0.03
"""A constant whose standard deviation moves the whitened residual by less is left as it is."""
_ROUNDS = 4
"""Most fits with the noise taken anew."""
_SETTLED = 0.1
"""Change of the logarithm of the noise's size below which it has settled."""
_STRANGE = 3.5
"""Prior standard deviations beyond which the shift of a constant is reported."""
_CHANCE = 1e-4
"""Chance of a misfit below which it is reported."""
_FEW = 50
"""Most degrees of freedom that the data leave where such a misfit is reported."""
_LEAST_SHARE = 1e-3
"""Smallest share of a source that the budget names."""
Channels = Mapping[str, tuple[slice, float]]
"""Name -> rows of a channel in the residual, and the weight that they were divided by."""
NoiseModel = Callable[[Solution], Noise]


@dataclass(frozen=True)
class Estimate:
    """One parameter after a fit.

    Attributes:
        name, unit: of the parameter.
        value: in `unit`.
        standard_deviation, lower, upper: with the 95 % interval, which holds the value; infinite
            when not identifiable, zero when frozen, one-sided at a bound (see `uncertainty`).
        identifiable: whether the data determine it.
        bound: `lower` or `upper` when the fit stopped there.
        frozen: kept its seed.
        noise_deviation: standard deviation that noise alone would give, with the rig's constants
            taken as exact; NaN in results of earlier versions.
    """

    name: str
    unit: str
    value: float
    standard_deviation: float
    lower: float
    upper: float
    identifiable: bool = True
    bound: str = ""
    frozen: bool = False
    noise_deviation: float = math.nan

    def holds(self, truth: float) -> bool:
        """Whether the interval holds a value."""
        return self.lower <= truth <= self.upper


@dataclass(frozen=True)
class FitResult:
    """What one fit found, ready for a report.

    Attributes:
        name: of the log or table that was fitted.
        estimates: of all parameters, the frozen ones included.
        covariance: of the free parameters, in the order of `free` (p x p).
        cost: |weighted residual|^2 / 2.
        residual_rms: root mean square of the residual per channel, in the channel's unit.
        success, status: of the solver.
        attempts: all starts that were tried: start, cost, success, status, iterations.
        unidentifiable: directions that the data do not determine.
        warnings: what a reader must know: active bounds, missing axes, undetermined directions.
        effective_samples: that the data count as.
        facts: labels of the data, such as tail, axis, angle and wind speed.
        rig: what of the rig differs from `models/`, as `section.key`.
        budget: per parameter the shares of the variance that noise and each uncertain constant
            have.
        constants: those that have a prior: shift from the scenario, deviation after the fit, and
            `known_to` before it.
        curves: for plots, by name; each a dictionary of equally long lists. Not in CSV and YAML.
    """

    name: str
    estimates: tuple[Estimate, ...]
    covariance: tuple[tuple[float, ...], ...]
    cost: float
    residual_rms: Mapping[str, float]
    success: bool
    status: str
    attempts: tuple[Mapping[str, Any], ...]
    unidentifiable: Annotated[
        tuple[str, ...], Field(validation_alias=AliasChoices("unidentifiable", "unseen"))
    ] = ()
    warnings: tuple[str, ...] = ()
    effective_samples: float = math.nan
    facts: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, Any] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    budget: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    constants: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; KeyError lists those there are."""
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise KeyError(
            f"{name!r}; estimated: {', '.join(estimate.name for estimate in self.estimates)}"
        )

    @property
    def free(self) -> tuple[Estimate, ...]:
        """The estimates that were not frozen."""
        return tuple(estimate for estimate in self.estimates if not estimate.frozen)

    @property
    def resnorm(self) -> float:
        """|weighted residual|^2, above zero: what the averages over several fits weigh by (eqs.
        4.29-4.31).
        """
        return 2.0 * max(self.cost, 1e-12)

    def row(self) -> dict[str, Any]:
        """One row for CSV: facts, then value, standard deviation and interval of each parameter."""
        row: dict[str, Any] = {"fit": self.name, **self.facts}
        for e in self.estimates:
            if e.unit in ("1", ""):
                suffix = ""
            else:
                suffix = "_" + unit_suffix(e.unit)
            name = e.name
            row[f"{name}{suffix}"] = e.value
            if e.frozen:
                continue
            row[f"{name}_std{suffix}"] = e.standard_deviation
            row[f"{name}_noise_std{suffix}"] = e.noise_deviation
            row[f"{name}_lower95{suffix}"] = e.lower
            row[f"{name}_upper95{suffix}"] = e.upper
            row[f"{name}_identifiable"] = e.identifiable
            row[f"{name}_bound"] = e.bound
        row |= {f"residual_rms_{channel}": value for channel, value in self.residual_rms.items()}
        row |= {
            "cost": self.cost,
            "effective_samples": self.effective_samples,
            "success": self.success,
        }
        return row | {"status": self.status, "warnings": "; ".join(self.warnings)}


def short_name(fit: str) -> str:
    """Name of a fit for a table or a figure, without folder and suffix of its log."""
    path = Path(fit)
    return path.stem if path.suffix in (".parquet", ".csv") else path.name


def unit_suffix(unit: str) -> str:
    """A unit as the end of a column name: `N m s/rad` becomes `n_m_s_per_rad`, `A` becomes `a`."""
    return unit.lower().replace("/", "_per_").replace(" ", "_").replace("^", "")


@dataclass(frozen=True)
class UncertainRig:
    """The constants of a rig as unknowns of a fit.

    Attributes:
        constants: with their deviation; those with an infinite one are free and become parameters
            of the result.
        problem: of the data's residual in some parameters, the constants among them.
        noise: of the data's residual, from a solution in all parameters.
        least_noise: what it would be if the model were right: with it the constants are first let
            go, since an error of theirs must not be taken for noise.
    """

    constants: Sequence[Parameter]
    problem: Callable[[Parameters], Problem]
    noise: NoiseModel
    least_noise: NoiseModel


def fit(
    problem: Problem,
    method: Solver,
    noise: NoiseModel,
    *,
    starts: Sequence[FloatArray] | None = None,
    channels: Channels | None = None,
    facts: Mapping[str, Any] | None = None,
    warnings: Sequence[str] = (),
    loss: Loss = "squares",
    rig: UncertainRig | None = None,
) -> FitResult:
    """Solves a problem from all starts and says how sure the answer is.

    Args:
        problem: with the constants of the rig at their seeds.
        noise: makes the noise of the residual from the solution, see `uncertainty`.
        channels: per channel where it stands in the residual and the weight that its residual was
            divided by.
        warnings: of the data, kept before those of the fit.
        loss: `huber` goes on from the least-squares solution with Huber's loss
            (`aerodima.optimisation.identify.least_squares`).
        rig: goes on from there with its constants, if there are any, as unknowns too.

    Raises:
        FitError: no start could be solved.
    """
    channels = channels or {}
    solution = solve(problem, method, starts)
    if loss == "squares":
        sure = uncertainty(solution, noise(solution))
        result = result_of(solution, sure, channels, facts or {}, warnings)
    else:
        robust = solve_huber(problem, method, solution)
        sure = uncertainty(robust.influence, noise(robust.influence))
        reported = {**(facts or {}), "loss": loss, "outliers": robust.beyond}
        result = result_of(robust.solution, sure, channels, reported, warnings)
    if rig is None or not rig.constants:
        return result
    return _with_constants(result, problem.parameters.all, rig, channels, warnings, loss)


def result_of(
    solution: Solution,
    sure: Uncertainty,
    channels: Channels,
    facts: Mapping[str, Any],
    warnings: Sequence[str],
    constants: Collection[str] = (),
) -> FitResult:
    """The result of a solution and its uncertainty; the parameters that are constants of the rig
    are left out.
    """
    parameters = solution.problem.parameters
    kept = [i for i, name in enumerate(parameters.names) if name not in constants]
    bounds = parameters.active(solution.x)
    columns = [solution.x, sure.standard_deviation, sure.lower, sure.upper, sure.identifiable]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    numbers = dict(zip(parameters.names, rows, strict=True))
    estimates = []
    for p in parameters.all:
        name = p.name
        if name in constants:
            continue
        if p.frozen:
            seed = p.seed
            estimates.append(
                Estimate(name, p.unit, seed, 0.0, seed, seed, frozen=True, noise_deviation=0.0)
            )
            continue
        value, sigma, low, high, identifiable = numbers[name]
        # A parameter that is not identifiable stays where it started, which may be a bound.
        bound = ""
        if identifiable:
            bound = bounds.get(name, "")
        estimates.append(
            Estimate(
                name, p.unit, value, sigma, low, high, identifiable, bound, noise_deviation=sigma
            )
        )
    rms = {
        name: float(np.sqrt(np.mean(np.square(solution.residual[where])))) * weight
        for name, (where, weight) in channels.items()
    }
    unidentifiable = tuple(
        text for text in sure.unidentifiable if text.split(" ")[0] not in constants
    )
    covariance = sure.covariance[np.ix_(kept, kept)].tolist()
    best = solution.best
    return FitResult(
        name=solution.problem.name,
        estimates=tuple(estimates),
        covariance=tuple(map(tuple, covariance)),
        cost=best.cost,
        residual_rms=rms,
        success=best.success,
        status=best.status,
        attempts=tuple(_attempt(parameters.names, attempt) for attempt in solution.attempts),
        unidentifiable=unidentifiable,
        warnings=(*warnings, *_warnings(estimates, unidentifiable, sure, solution)),
        effective_samples=sure.effective_samples,
        facts=dict(facts),
    )


def _attempt(names: Sequence[str], attempt: Attempt) -> dict[str, Any]:
    return {
        "start": dict(zip(names, attempt.start.tolist(), strict=True)),
        "found": dict(zip(names, attempt.x.tolist(), strict=True)),
        "cost": attempt.cost,
        "success": attempt.success,
        "status": attempt.status,
        "iterations": attempt.iterations,
    }


def _warnings(
    estimates: Sequence[Estimate],
    unidentifiable: Sequence[str],
    sure: Uncertainty,
    solution: Solution,
) -> list[str]:
    found = [f"the data do not determine {direction}" for direction in unidentifiable]
    at_bounds = [e for e in estimates if e.bound]
    beyond = dict(zip(solution.problem.parameters.names, sure.beyond.tolist(), strict=True))
    for e in at_bounds:
        unit = "" if e.unit == "1" else " " + e.unit
        bound = f"{e.bound} bound {e.value:.6g}{unit}"
        found.append(
            f"{e.name} stopped at its {bound}, {beyond[e.name]:.2g} standard deviations from what "
            "the data ask for"
        )
    determined = sum(e.identifiable and not e.frozen for e in estimates)
    if at_bounds and len(at_bounds) < determined:
        names = ", ".join(e.name for e in at_bounds)
        found.append(f"the intervals of the others take {names} to lie within bounds")
    if not solution.best.success:
        found.append(f"the solver did not finish: {solution.best.status}")
    return found


def _with_constants(
    first: FitResult,
    parameters: Sequence[Parameter],
    rig: UncertainRig,
    channels: Channels,
    warnings: Sequence[str],
    loss: Loss,
) -> FitResult:
    """Goes on from a fit with exact constants; `huber` bends the whitened residual beyond 1.345."""
    start = {e.name: e.value for e in first.estimates}
    given = []
    for p in parameters:
        if not p.frozen:
            p = replace(p, seed=min(max(start[p.name], p.lower), p.upper))
        given.append(p)
    problem = rig.problem(Parameters.of([*given, *rig.constants]))
    unknowns = problem.parameters
    x = unknowns.seed
    raw = _at(problem, x, problem.central_differences(x))
    found = rig.least_noise(raw)
    sizes = [p.deviation if _has_prior(p) else 1.0 for p in unknowns.free]
    whiten = _Whitening.of(found.covariance)
    effect = np.linalg.norm(whiten(raw.jacobian), axis=0) * sizes
    moving = dict(zip(unknowns.names, effect >= _NEGLIGIBLE, strict=True))
    kept = [replace(c, frozen=_has_prior(c) and not moving[c.name]) for c in rig.constants]
    problem = rig.problem(Parameters.of([*given, *kept]))
    raw = _at(problem, problem.parameters.seed, np.empty(0))
    for _ in range(_ROUNDS):
        whiten = _Whitening.of(found.covariance)
        solution = solve(_weighed(problem, whiten, loss), solve_rollout, [raw.x])
        rows = len(raw.residual)
        raw = _at(problem, solution.x, whiten.back(solution.jacobian[:rows]))
        before = found
        found = rig.noise(raw)
        if abs(math.log(_size(found) / _size(before))) < _SETTLED:
            break
    ones = Noise(np.ones(len(solution.residual)), found.degrees_of_freedom, found.effective_samples)
    best = replace(solution.best, cost=0.5 * float(raw.residual @ raw.residual))
    known = {c.name for c in rig.constants if _has_prior(c)}
    sure = uncertainty(solution, ones)
    result = result_of(replace(raw, best=best), sure, channels, first.facts, warnings, known)
    constants = {}
    free = problem.parameters.free
    for p, shift, deviation in zip(free, solution.x, sure.standard_deviation, strict=True):
        if p.name in known:
            constants[p.name] = {
                "shift": float(shift),
                "deviation": float(deviation),
                "known_to": p.deviation,
            }
    result = _with_shares(result, solution, rows, known)
    return replace(result, attempts=first.attempts, constants=constants)


@dataclass(frozen=True)
class _Whitening:
    """Whitens the residual of the data: times `matrix`, or by element; `back` undoes it."""

    matrix: FloatArray

    @classmethod
    def of(cls, covariance: FloatArray) -> _Whitening:
        if covariance.ndim == 1:
            return cls(1.0 / np.sqrt(np.maximum(covariance, 1e-300)))
        size = np.sqrt(np.diag(covariance))
        lower = np.linalg.cholesky(covariance / np.outer(size, size) + 1e-12 * np.eye(len(size)))
        return cls(np.linalg.inv(lower) / size)

    def __call__(self, rows: FloatArray) -> FloatArray:
        if self.matrix.ndim == 2:
            return self.matrix @ rows
        return (rows.T * self.matrix).T

    def back(self, rows: FloatArray) -> FloatArray:
        if self.matrix.ndim == 2:
            return np.linalg.solve(self.matrix, rows)
        return (rows.T / self.matrix).T


def _has_prior(p: Parameter) -> bool:
    return math.isfinite(p.deviation)


def _size(noise: Noise) -> float:
    S = noise.covariance
    return float(np.mean(S) if S.ndim == 1 else np.mean(np.diag(S)))


def _at(problem: Problem, x: FloatArray, jacobian: FloatArray) -> Solution:
    """Residual and Jacobian at x, without solving."""
    residual = np.asarray(problem.residual(x), float)
    return Solution(problem, x, residual, jacobian, best=None, attempts=())  # type: ignore[arg-type]


def _weighed(problem: Problem, whiten: _Whitening, loss: Loss) -> Problem:
    """The whitened residual, then a row per constant with a prior."""
    free = problem.parameters.free
    places = [i for i, p in enumerate(free) if _has_prior(p)]
    deviations = np.array([free[i].deviation for i in places])

    def residual(x: FloatArray) -> FloatArray:
        data = whiten(np.asarray(problem.residual(x), float))
        if loss == "huber":
            data = huber(data)
        priors = np.asarray(x, float)[places] / deviations
        return np.concatenate([data, priors])

    return replace(problem, residual=residual, jacobian=None)


def _with_shares(
    result: FitResult, solution: Solution, rows: int, known: Collection[str]
) -> FitResult:
    """The result with its budget, with what noise alone would give, and what is strange about the
    constants.

    Args:
        solution: of the whitened problem.
        rows: how many are data; the others are priors.
        known: names of the constants that have a prior.
    """
    free = solution.problem.parameters.free
    kept = [i for i, p in enumerate(free) if p.name not in known]
    priors = [p for p in free if p.name in known]
    scales = np.array([p.size for p in free])
    parts = np.square(np.linalg.pinv(solution.jacobian * scales))
    split = np.column_stack([parts[:, :rows].sum(axis=1), parts[:, rows:]])
    shares = split / parts.sum(axis=1, keepdims=True)
    exact = np.linalg.pinv(solution.jacobian[:rows, kept] * scales[kept])
    names = [free[i].name for i in kept]
    deviations = np.linalg.norm(exact, axis=1) * scales[kept]
    alone = dict(zip(names, deviations, strict=True))
    sources = ["noise", *(p.name for p in priors)]
    budget = {}
    for name, own in zip(names, shares[kept].tolist(), strict=True):
        if result[name].identifiable:
            pairs = sorted(zip(sources, own, strict=True), key=lambda pair: -pair[1])
            budget[name] = {source: share for source, share in pairs if share >= _LEAST_SHARE}
    shifts = solution.x[[i for i, p in enumerate(free) if p.name in known]]
    warnings = [
        f"the data want {p.name} shifted by {shift:.3g}, {abs(shift) / p.deviation:.1f} of its "
        "standard deviations "
        f"({p.deviation:.2g}): set it, or free it (--free {p.name})"
        for p, shift in zip(priors, shifts, strict=True)
        if abs(shift) > _STRANGE * p.deviation
    ]
    freedom = rows - len(kept)
    power = float(solution.residual @ solution.residual)
    if 1 <= freedom <= _FEW and chdtrc(freedom, power) <= _CHANCE:
        warnings.append(
            f"noise and constants do not explain the data: what is left is {power / freedom:.3g} "
            "times what they "
            "allow; a constant is further off than its uncertainty says, or something else is wrong"
        )
    estimates = []
    for e in result.estimates:
        if e.frozen:
            estimates.append(e)
            continue
        if e.identifiable:
            deviation = min(float(alone[e.name]), e.standard_deviation)
        else:
            deviation = math.inf
        estimates.append(replace(e, noise_deviation=deviation))
    warnings = [*result.warnings, *warnings]
    return replace(result, estimates=tuple(estimates), budget=budget, warnings=tuple(warnings))
